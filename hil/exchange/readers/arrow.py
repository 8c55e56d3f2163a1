"""Read Parquet, Feather and Arrow files with pyarrow: stamps, vectors and structs included."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from hil.errors import WrongUse
from hil.exchange.readers.columns import Columns, of_row, plain, titled

_PARQUET = b"PAR1"


def parquet(path: Path) -> ModuleType:
    """Return the module of pyarrow that reads and writes Parquet. path: the file, for messages. Raises WrongUse if
    pyarrow is not installed.
    """
    try:
        import pyarrow.parquet
    except ImportError:
        raise WrongUse(f"{path}: Parquet needs pyarrow: pip install 'hil[parquet]', or use CSV") from None
    found: ModuleType = pyarrow.parquet
    return found


def read(source: Path) -> Columns:
    """Return the columns of a file: "q[2]" in a column of lists, "wrench.z" in a column of structs."""
    module = parquet(source)
    with source.open("rb") as file:
        is_parquet = file.read(4) == _PARQUET
    if is_parquet:
        opened = module.ParquetFile(source)
        schema, load = opened.schema_arrow, lambda name: opened.read(columns=[name], use_threads=False).column(0)
        first = next(opened.iter_batches(batch_size=1, use_threads=False), None)
    else:
        import pyarrow.ipc

        table = pyarrow.ipc.open_file(source).read_all()
        schema, load = table.schema, table.column
        first = table.slice(0, 1)
    row = {} if first is None or not first.num_rows else first.to_pylist()[0]
    return {
        titled(path, _unit(field)): partial(_values, partial(load, field.name), path.removeprefix(field.name))
        for field in schema
        for path in _paths(field, row.get(field.name))
    }


def _unit(field: Any) -> dict[Any, Any]:
    from pyarrow import types

    return {"unit": "s"} if types.is_temporal(field.type) else field.metadata or {}


def _paths(field: Any, value: Any) -> Iterator[str]:
    from pyarrow import types

    nested = types.is_nested(field.type)
    yield from (path for path, _ in of_row(field.name, value)) if nested else [field.name]


def _values(load: Any, path: str) -> Any:
    """Return the values of a column (n,), or those at a path inside each of its values."""
    import pyarrow
    from pyarrow import types

    column = load()
    if path:
        return plain([dict(of_row("", value)).get(path.removeprefix(".")) for value in column.to_pylist()])
    if types.is_time(column.type):
        column = column.cast(pyarrow.int64()).cast(pyarrow.duration(column.type.unit))
    elif types.is_decimal(column.type):
        column = column.cast(pyarrow.float64())
    elif types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    return column.to_numpy()
