"""Read Parquet, Feather and Arrow files with pyarrow: stamps, vectors and structs included."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

from hil.errors import WrongUse
from hil.exchange.nested import columns
from hil.exchange.readers.columns import Columns, loaded, titled

_PARQUET, _ARROW, _FEATHER = b"PAR1", b"ARROW1"[:4], b"FEA1"
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
    import pyarrow.ipc
    import pyarrow.parquet

    with source.open("rb") as file:
        magic = file.read(4)
    load: Callable[[list[str]], Any]
    if magic == _PARQUET:
        opened = pyarrow.parquet.ParquetFile(source)  # a data set would start threads, whose memory counts
        schema, load = opened.schema_arrow, partial(opened.read, use_threads=False)
    else:
        table = _arrow(source, magic)
        schema, load = table.schema, table.select
    nested = [one.name for one in schema if pyarrow.types.is_nested(one.type)]
    flat = {titled(one.name, _unit(one)): partial(_values, load, one.name) for one in schema if one.name not in nested}

    @cache
    def inner(rows: int | None) -> Columns:
        return loaded(columns(str(source), enumerate(load(nested).slice(0, rows).to_pylist())).values)

    names = inner(_LOOKED) if nested else {}
    return flat | {name: partial(lambda name: inner(None)[name](), name) for name in names}


def _arrow(source: Path, magic: bytes) -> Any:
    """Return the table in a file of Arrow, of Feather 1, or of a stream, of which the end may be missing."""
    import pyarrow.feather
    import pyarrow.ipc

    if magic == _FEATHER:
        return pyarrow.feather.read_table(source, use_threads=False)
    if magic == _ARROW:
        return pyarrow.ipc.open_file(source).read_all()
    return pyarrow.ipc.open_stream(source).read_all()


def _unit(field: Any) -> Mapping[Any, Any]:
    from pyarrow import types

    return {"unit": "s"} if types.is_temporal(field.type) else field.metadata or {}


def _values(load: Callable[[list[str]], Any], name: str) -> Any:
    """Return the values of a column (n,)."""
    import pyarrow
    from pyarrow import types

    column = load([name]).column(0)
    if types.is_time(column.type):
        column = column.cast(pyarrow.int64()).cast(pyarrow.duration(column.type.unit))
    elif types.is_decimal(column.type):
        column = column.cast(pyarrow.float64())
    elif types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    return column.to_numpy()
