"""Read named columns from the table in a file: CSV, Parquet, MATLAB or a ROS 2 bag."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse, meant
from hil.exchange import bags, delimited, headings, matlab, plotjuggler
from hil.exchange.row_filter import RowFilter
from hil.recording.input import bounded, open_input

_LARGEST = 1 << 36  # bytes of a file

Answer = TypeVar("Answer")
Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of any format.

    titles: headings. reader: function that reads columns by their indices. joins_topics: whether the table joins
    several topics, so that a row has empty cells for the topics that were not received at its time.
    """

    source: Path
    titles: Sequence[str]
    reader: Callable[[Sequence[int], Sequence[tuple[int, RowFilter]]], tuple[Array, Rows]]
    joins_topics: bool = False

    def has(self, name: str) -> bool:
        """Return whether a column has this name, with or without a unit."""
        return any(name == title or name in headings.names(title) for title in self.titles)

    def place(self, name: str) -> int:
        """Return the index of the column `name`; "tau" also finds "tau [mN m]". Raises WrongUse."""
        return place(self.source, self.titles, name)

    def read(self, wanted: Sequence[str], where: Sequence[RowFilter]) -> tuple[Array, Rows]:
        """Return the columns `wanted`, (columns, n), of the rows that pass every filter, and the row numbers, (n,).

        wanted: names as `place` accepts them. where: the filters. Raises WrongUse if no row passes, and for an error in
        the file, with its row.
        """
        table, rows = self.reader(
            [self.place(name) for name in wanted], [(self.place(one.column), one) for one in where]
        )
        if not len(rows):
            what = "no row passes " + " and ".join(str(one) for one in where) if where else "it has no rows"
            raise WrongUse(f"{self.source}: {what}")
        return table, rows


def open_table(source: Path, *, topic: str | None = None, joint: str | None = None) -> Table:
    """Return the table in a file: CSV, Parquet, MATLAB, a topic of a ROS 2 bag, or a CSV that PlotJuggler exported.

    topic, joint: select the columns of a ROS 2 bag (see `bags.columns`) or of a table of PlotJuggler. Raises WrongUse.
    """
    if bags.is_bag(source):
        found = bags.columns(source, topic, joint)
        return _whole(source, _Columns(list(found), lambda names: [found[name] for name in names]))
    if source.suffix.lower() in {".h5", ".hdf5", ".part"}:
        raise WrongUse(f"{source} is HDF5 by its name: a recording of hil needs no import; save other HDF5 as CSV")
    if source.suffix.lower() in _FILES and topic is None and joint is None:
        return _whole(source, _columns(source))
    written = _bounded_if_packed(source, partial(delimited.titles, source))
    titles = plotjuggler.renamed(source, written, topic, joint)
    return Table(source, titles, partial(_read_text, source), joins_topics=plotjuggler.TIME in written)


def _read_text(source: Path, wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]) -> tuple[Array, Rows]:
    return _bounded_if_packed(source, partial(delimited.read, source, wanted, filters))


def _bounded_if_packed(source: Path, work: Callable[[], Answer]) -> Answer:
    """Return the answer of `work`; text that is not compressed takes memory in proportion to the file anyway."""
    return bounded(source, work) if source.suffix.lower() == ".gz" else work()


def _whole(source: Path, columns: _Columns) -> Table:
    return Table(source, columns.names, partial(_read_whole, source, columns))


def place(source: Path, known: Sequence[str], name: str) -> int:
    """Return the index of the column `name`; "tau" also finds "tau [mN m]". Raises WrongUse."""
    at = [index for index, title in enumerate(known) if title == name]
    at = at or [index for index, title in enumerate(known) if name in headings.names(title)]
    if len(at) > 1:
        raise WrongUse(f"{source} has {len(at)} columns named {name!r}: rename all but one")
    if at:
        return at[0]
    raise WrongUse(f"{source} has no column {name!r}; {meant(name, known)}it has {headings.listed(known)}")


def _read_whole(
    source: Path, columns: _Columns, wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]
) -> tuple[Array, Rows]:
    known = columns.names
    needed = list(dict.fromkeys([*wanted, *(at for at, _ in filters)]))
    found = columns.read([known[at] for at in needed])
    numbers = {at: _numbers(source, known[at], values) for at, values in zip(needed, found, strict=True)}
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
    """The columns of a binary file: their names, and a function that reads some of the columns."""

    names: list[str]
    read: Callable[[Sequence[str]], list[Any]]


def _columns(source: Path) -> _Columns:
    open_input(source, largest=_LARGEST).close()
    opened = partial(_FILES[source.suffix.lower()], source)
    return _Columns(
        bounded(source, lambda: opened().names), lambda names: bounded(source, lambda: opened().read(names))
    )


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


def _parquet(source: Path) -> _Columns:
    module = parquet(source)
    try:
        file = module.ParquetFile(source)
        names = list(file.schema_arrow.names)
    except (OSError, ValueError) as error:  # pyarrow's own errors are of these two
        raise WrongUse(f"{source} is not Parquet, or is cut off ({_first_line(error)})") from None

    def read(names: Sequence[str]) -> list[Any]:
        try:
            return [file.read(columns=[name]).column(name).to_numpy() for name in names]
        except (OSError, ValueError) as error:
            raise WrongUse(f"{source} is damaged ({_first_line(error)}): use another copy of the file") from None

    return _Columns(names, read)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0]


def _matlab(source: Path) -> _Columns:
    vectors = matlab.vectors(source)
    return _Columns(list(vectors), lambda names: [vectors[name] for name in names])


_FILES: Mapping[str, Callable[[Path], _Columns]] = {".parquet": _parquet, ".pq": _parquet, ".mat": _matlab}
