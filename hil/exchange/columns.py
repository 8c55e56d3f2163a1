"""Read named columns from the table in a file, whatever its format."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse, meant
from hil.exchange import bags, headings
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
Filters = Sequence[tuple[int, RowFilter]]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of any format.

    titles: headings. reader: function that reads columns by their indices. lost: what could not be read, as sentences,
    after `read`.
    """

    source: Path
    titles: Sequence[str]
    reader: Callable[[Sequence[int], Filters], tuple[Array, Rows]]
    lost: list[str] = field(default_factory=list)

    def has(self, name: str) -> bool:
        """Return whether a column has this name, with or without a unit."""
        return any(name == title or name in headings.names(title) for title in self.titles)

    def place(self, name: str) -> int:
        """Return the index of the column `name`; "tau" also finds "tau [mN m]". Raises WrongUse."""
        return place(self.source, self.titles, name)

    def read(self, wanted: Sequence[str], where: Sequence[RowFilter]) -> tuple[Array, Rows]:
        """Return the columns `wanted`, (columns, n), of the rows that pass every filter, and the row numbers, (n,).

        wanted: names of columns, with or without their units. where: the filters. Raises WrongUse if no row passes, and
        for an error in the file, with its row.
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

    def _label(self, title: str) -> str | None:
        """Return the column that names the joint of an indexed column: "field.name0" for "field.effort0"."""
        match = _INDEXED.search(title)
        label = "" if match is None else f"{title[: match.start()]}name{match[1]}"
        return label if label != title and label in self.titles else None


def open_table(
    source: Path, *, topic: str | None = None, joint: str | None = None, asked: Collection[str] = ()
) -> Table:
    """Return the table in a file.

    topic: a topic of a bag, or the sheet of a workbook. joint: a joint of a bag. asked: names of columns, which the
    line of headings in a text must contain. Raises WrongUse.
    """
    if bags.is_bag(source):
        found = bags.columns(source, topic, joint)
        return Table(
            source, list(found), partial(_read, source, list(found), lambda names: [found[one] for one in names])
        )
    kind = formats.kind_of(source)
    if joint is not None or (topic is not None and kind != formats.WORKBOOK):
        raise WrongUse(f"{source} is no bag and has no topics or joints: leave out --topic and --joint")
    if kind not in {formats.TEXT, formats.WORKBOOK}:
        titles, read = formats.columns(source, kind)
        return Table(source, titles, partial(_read, source, titles, read))
    titles, lost = _bounded_if_packed(source, partial(rows.titles, source, asked, topic)), list[str]()

    def read_text(wanted: Sequence[int], filters: Filters) -> tuple[Array, Rows]:
        found = _bounded_if_packed(source, partial(rows.read, source, asked, wanted, filters, sheet=topic))
        lost[:] = found.lost
        return found.numbers, found.places

    return Table(source, titles, read_text, lost)


def _bounded_if_packed(source: Path, work: Callable[[], Answer]) -> Answer:
    """Return the result of `work`, which reads `source`; its memory is limited if `source` is compressed."""
    return bounded(source, work) if source.suffix.lower() == ".gz" else work()


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
            f"{source}: the values of {inside[1]!r} belong to names, whose order changes from start to start, so "
            f"an index may read another joint: choose by name; it has {headings.listed(known)}"
        )
    raise WrongUse(f"{source} has no column {name!r}; {meant(name, known)}it has {headings.listed(known)}")


def _read(
    source: Path,
    known: Sequence[str],
    load: Callable[[Sequence[str]], list[Any]],
    wanted: Sequence[int],
    filters: Filters,
) -> tuple[Array, Rows]:
    """Return the columns `wanted` and the row numbers of a file that `load` reads as a whole."""
    needed = list(dict.fromkeys([*wanted, *(at for at, _ in filters)]))
    read = dict(zip(needed, load([known[at] for at in needed]), strict=True))
    lengths = {known[at]: len(values) for at, values in read.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise WrongUse(f"{source}: columns of unequal length ({listed}): name columns of one table")

    def as_numbers(at: int) -> Array:
        found = numbers(read[at])
        if found is None:
            raise WrongUse(f"{source}: column {known[at]!r} does not hold numbers")
        return found

    kept = np.ones(next(iter(lengths.values())), dtype=np.bool_)
    for at, one in filters:
        kept &= one.keeps(np.asarray(read[at]).astype(str) if isinstance(one.value, str) else as_numbers(at))
    return np.stack([as_numbers(at)[kept] for at in wanted]), np.flatnonzero(kept) + 1
