"""Read named columns from the table in a file, whatever its format."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse, meant
from hil.exchange import bags, headings, plotjuggler
from hil.exchange.readers import formats
from hil.exchange.readers.columns import numbers
from hil.exchange.row_filter import RowFilter
from hil.exchange.text import rows
from hil.printable import quoted
from hil.recording.input import bounded

_INDEXED = re.compile(r"[A-Za-z]+([\[._]?\d+\]?)(?=\s|$)")
Answer = TypeVar("Answer")
Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of any format.

    titles: headings. reader: function that reads columns by their indices. joins_topics: whether the table joins
    several topics, so that a row has empty cells for the topics that were not received at its time.
    lost: what could not be read, as sentences, after `read`.
    """

    source: Path
    titles: Sequence[str]
    reader: Callable[[Sequence[int], Sequence[tuple[int, RowFilter]]], tuple[Array, Rows]]
    joins_topics: bool = False
    lost: list[str] = field(default_factory=list)

    def has(self, name: str) -> bool:
        """Return whether a column has this name, with or without a unit."""
        return any(name == title or name in headings.names(title) for title in self.titles)

    def place(self, name: str) -> int:
        """Return the index of the column `name`; "tau" also finds "tau [mN m]". Raises WrongUse."""
        return place(self.source, self.titles, name)

    def _label(self, title: str) -> str | None:
        """Return the column with the name of the joint in an indexed one: "field.name0" beside "field.effort0"."""
        match = _INDEXED.search(title)
        label = "" if match is None else f"{title[: match.start()]}name{match[1]}"
        return label if label != title and label in self.titles else None

    def with_sum(self, title: str, factors: Sequence[tuple[int, float]]) -> Table:
        """Return the table with a further column `title`: the sum of columns, by index, with their factors."""

        def read(wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]) -> tuple[Array, Rows]:
            own = [at for at in wanted if at < len(self.titles)]
            found, places = self.reader([*own, *(at for at, _ in factors)], filters)
            total = sum(factor * values for (_, factor), values in zip(factors, found[len(own) :], strict=True))
            columns = iter(found[: len(own)])
            return np.stack([next(columns) if at < len(self.titles) else total for at in wanted]), places

        return replace(self, titles=[*self.titles, title], reader=read)

    def read(self, wanted: Sequence[str], where: Sequence[RowFilter]) -> tuple[Array, Rows]:
        """Return the columns `wanted`, (columns, n), of the rows that pass every filter, and the row numbers, (n,).

        wanted: names as `place` accepts them. where: the filters. Raises WrongUse if no row passes, and for an error in
        the file, with its row.
        """
        filters = [(self.place(one.column), one) for one in where]
        own = [self.place(name) for name in wanted]
        for title in (self.titles[at] for at in own):
            if (label := self._label(title)) and label not in {self.titles[at] for at, _ in filters}:
                raise WrongUse(
                    f"{self.source}: the joint of {title!r} is named in {label!r}, and the order of joints changes "
                    f"from start to start: read the rows of one joint with --where {quoted(f'{label}==JOINT')}"
                )
        table, places = self.reader(own, filters)
        if not len(places):
            what = "no row passes " + " and ".join(str(one) for one in where) if where else "it has no rows"
            raise WrongUse(f"{self.source}: {what}")
        return table, places


def open_table(
    source: Path, *, topic: str | None = None, joint: str | None = None, asked: Collection[str] = ()
) -> Table:
    """Return the table in a file: CSV, Parquet, MATLAB, a topic of a ROS 2 bag, or a CSV that PlotJuggler exported.

    topic, joint: select the columns of a ROS 2 bag (see `bags.columns`) or of a table of PlotJuggler. asked:
    names of columns, by which the line of headings of a text is found. Raises WrongUse.
    """
    if bags.is_bag(source):
        found = bags.columns(source, topic, joint)
        return _whole(source, _Columns(list(found), lambda names: [found[name] for name in names]))
    if (read := formats.columns(source, topic, joint)) is not None:
        return _whole(source, _Columns(*read))
    with formats.as_text(source, topic) as text:
        written, lost = _bounded_if_packed(text, partial(rows.titles, text, asked)), list[str]()
    if text != source:
        return Table(source, written, partial(_read_text, source, topic, asked, lost), lost=lost)
    titles = plotjuggler.renamed(source, written, topic, joint)
    reader = partial(_read_text, source, None, asked, lost)
    return Table(source, titles, reader, joins_topics=plotjuggler.TIME in written, lost=lost)


def _read_text(
    source: Path,
    sheet: str | None,
    asked: Collection[str],
    lost: list[str],
    wanted: Sequence[int],
    *filters: Sequence[tuple[int, RowFilter]],
) -> tuple[Array, Rows]:
    with formats.as_text(source, sheet) as text:
        read = _bounded_if_packed(text, partial(rows.read, text, asked, wanted, *filters))
    lost[:] = read.lost
    return read.numbers, read.places


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
    inside = re.match(r"(.+?)\[[:,\d]+\]", name)
    if inside and any(title.startswith(f"{inside[1]}.") for title in known):
        raise WrongUse(
            f"{source}: the values of {inside[1]!r} stand beside names, whose order changes from start to start, so "
            f"an index may read another joint: choose by name; it has {headings.listed(known)}"
        )
    raise WrongUse(f"{source} has no column {name!r}; {meant(name, known)}it has {headings.listed(known)}")


def _read_whole(
    source: Path, columns: _Columns, wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]
) -> tuple[Array, Rows]:
    known = columns.names
    needed = list(dict.fromkeys([*wanted, *(at for at, _ in filters)]))
    found = columns.read([known[at] for at in needed])
    read = dict(zip(needed, found, strict=True))
    lengths = {known[at]: len(values) for at, values in read.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise WrongUse(f"{source}: columns of unequal length ({listed}): name columns of one table")
    kept = np.ones(next(iter(lengths.values())), dtype=np.bool_)
    for at, one in filters:
        kept &= one.mask(
            np.asarray(read[at]).astype(str) if isinstance(one.value, str) else _numbers(source, known[at], read[at])
        )
    return np.stack([_numbers(source, known[at], read[at])[kept] for at in wanted]), np.flatnonzero(kept) + 1


def _numbers(source: Path, name: str, values: Any) -> Array:
    found = numbers(values)
    if found is None:
        raise WrongUse(f"{source}: column {name!r} does not hold numbers")
    return found


class _Columns(NamedTuple):
    """The columns of a binary file: their names, and a function that reads some of the columns."""

    names: list[str]
    read: Callable[[Sequence[str]], list[Any]]
