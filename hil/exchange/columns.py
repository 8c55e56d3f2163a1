"""Named columns of a table file: CSV, Parquet or MATLAB."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange import delimited, headings, matlab
from hil.exchange.row_filter import RowFilter
from hil.recording.input import open_input

_LARGEST = 1 << 36  # bytes of a file
_SHOWN = 40  # names in a message

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def titles(source: Path) -> list[str]:
    """Return the names of a file's columns, in order. Raises WrongUse for a file that cannot be read."""
    if source.suffix.lower() in _FILES:
        return _columns(source).names
    return delimited.titles(source)


def place(source: Path, known: Sequence[str], name: str) -> int:
    """Return the index of the column `name`; "tau" also finds "tau [mN m]". Raises WrongUse."""
    at = [index for index, title in enumerate(known) if title == name]
    at = at or [index for index, title in enumerate(known) if name in headings.names(title)]
    if len(at) > 1:
        raise WrongUse(f"{source} has {len(at)} columns named {name!r}: rename all but one")
    if at:
        return at[0]
    near = get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise WrongUse(f"{source} has no column {name!r}; {hint}it has {listed(known)}")


def listed(names: Sequence[str]) -> str:
    """Return names for a message, the first of many."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def read(source: Path, wanted: Sequence[str], where: Sequence[RowFilter]) -> tuple[Array, Rows]:
    """Return the columns `wanted`, (columns, n), of the rows that pass every filter, and their row numbers, (n,).

    wanted: names as `place` finds them. Raises WrongUse for an error in the file, with its row, and where no row is
    left.
    """
    known = titles(source)
    at = [place(source, known, name) for name in wanted]
    filters = [(place(source, known, one.column), one) for one in where]
    table, rows = (
        _read_whole(source, known, at, filters)
        if source.suffix.lower() in _FILES
        else delimited.read(source, at, filters)
    )
    if not len(rows):
        what = "no row passes " + " and ".join(str(one) for one in where) if where else "it has no rows"
        raise WrongUse(f"{source}: {what}")
    return table, rows


def _read_whole(
    source: Path, known: Sequence[str], wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]
) -> tuple[Array, Rows]:
    columns = _columns(source)
    numbers = {
        at: _numbers(source, known[at], columns.column(known[at])) for at in [*wanted, *(at for at, _ in filters)]
    }
    lengths = {known[at]: len(values) for at, values in numbers.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise WrongUse(f"{source}: columns of unequal length ({listed}): name columns of one table")
    kept = np.ones(next(iter(lengths.values())), dtype=np.bool_)
    for at, one in filters:
        kept &= one.mask(numbers[at])
    return np.stack([numbers[at][kept] for at in wanted]), np.flatnonzero(kept) + 1


def _numbers(source: Path, name: str, values: Any) -> Array:
    if np.asarray(values).dtype.kind not in "fiub":
        raise WrongUse(f"{source}: column {name!r} does not hold numbers")
    return np.asarray(values, dtype=np.float64)


class _Columns(NamedTuple):
    """The columns of a binary file: their names, and how one is read."""

    names: list[str]
    column: Callable[[str], Any]


def _columns(source: Path) -> _Columns:
    open_input(source, largest=_LARGEST).close()
    return _FILES[source.suffix.lower()](source)


def parquet(path: Path) -> ModuleType:
    """Return pyarrow's Parquet module, needed for `path`. Raises WrongUse where it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise WrongUse(f"{path}: Parquet needs pyarrow: pip install 'hil[parquet]', or use CSV") from None
    found: ModuleType = pyarrow.parquet
    return found


def _parquet(source: Path) -> _Columns:
    module = parquet(source)
    try:
        file = module.ParquetFile(source)
        names = list(file.schema_arrow.names)
    except (OSError, ValueError) as error:  # pyarrow's own errors are of these two
        raise WrongUse(f"{source} is not Parquet, or is cut off ({_first_line(error)})") from None

    def column(name: str) -> Any:
        try:
            return file.read(columns=[name]).column(name).to_numpy()
        except (OSError, ValueError) as error:
            raise WrongUse(f"{source}: column {name!r} is damaged ({_first_line(error)})") from None

    return _Columns(names, column)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0]


def _matlab(source: Path) -> _Columns:
    vectors = matlab.vectors(source)
    return _Columns(list(vectors), vectors.__getitem__)


_FILES: Mapping[str, Callable[[Path], _Columns]] = {".parquet": _parquet, ".pq": _parquet, ".mat": _matlab}
