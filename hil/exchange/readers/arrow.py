"""Read Parquet, Feather and Arrow files with pyarrow: stamps, vectors and structs included."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

from hil.errors import WrongUse
from hil.exchange.nested import columns
from hil.exchange.readers.columns import Columns, from_values, titled

_PARQUET = b"PAR1"
_LOOKED = 1000  # rows that show which values lie in a column


def parquet(path: Path) -> ModuleType:
    """Return the module of pyarrow that writes Parquet. path: the file, for messages. Raises WrongUse if pyarrow is not
    installed.
    """
    try:
        import pyarrow.parquet
    except ImportError:
        raise WrongUse(f"{path}: Parquet needs pyarrow: pip install 'hil[parquet]', or use CSV") from None
    found: ModuleType = pyarrow.parquet
    return found


def read(source: Path) -> Columns:
    """Return the columns of a file: "q[2]" in a column of lists, "wrench.z" in a column of structs."""
    from pyarrow import dataset, types

    with source.open("rb") as file:
        form = "parquet" if file.read(4) == _PARQUET else "ipc"
    table = dataset.dataset(source, format=form)
    nested = [one.name for one in table.schema if types.is_nested(one.type)]

    @cache
    def inner(rows: int | None) -> Columns:
        part = table.head(rows, columns=nested) if rows else table.to_table(nested)
        return from_values(columns(str(source), enumerate(part.to_pylist())).values)

    flat = {
        titled(one.name, {"unit": "s"} if types.is_temporal(one.type) else one.metadata): partial(
            _values, table, one.name
        )
        for one in table.schema
        if one.name not in nested
    }
    names = inner(_LOOKED) if nested else {}
    return flat | {name: partial(lambda name: inner(None)[name](), name) for name in names}


def _values(table: Any, name: str) -> Any:
    """Return the values of a column (n,)."""
    import pyarrow
    from pyarrow import types

    column = table.to_table([name], use_threads=False).column(0)
    if types.is_time(column.type):
        column = column.cast(pyarrow.int64()).cast(pyarrow.duration(column.type.unit))
    elif types.is_decimal(column.type):
        column = column.cast(pyarrow.float64())
    elif types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    return column.to_numpy()
