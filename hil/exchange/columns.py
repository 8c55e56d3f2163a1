"""Read named columns from the table in a file, whatever its format."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse, meant
from hil.exchange import headings
from hil.exchange.expression import Term, terms
from hil.exchange.readers import bags, formats
from hil.exchange.readers.columns import numbers
from hil.exchange.row_filter import RowFilter
from hil.exchange.text import rows
from hil.printable import quoted
from hil.recording.input import bounded

_SIGNED = re.compile(r"[^\W\d]\w*(?:[-+/]\w+)+")  # a name that is a sum, if no column has it
_TEXTS = 64  # at most in a column that names the rows
_MOST = 1000  # columns whose headings may have units, or signs in their names
_INDEXED = re.compile(r"[A-Za-z]+([\[._]?\d+\]?)(?=\s|$)")
Answer = TypeVar("Answer")
Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Filters = Sequence[tuple[int, RowFilter]]


class UnequalLengths(WrongUse):
    """The columns that are read do not have one length: they are of two tables. lengths: by heading."""

    def __init__(self, message: str, lengths: Mapping[str, int]) -> None:
        super().__init__(message)
        self.lengths = lengths


class NoCommonRow(WrongUse):
    """Torque and deflection stand in different rows. second: the channels in the rows of the deflection."""

    def __init__(self, message: str, second: Sequence[str]) -> None:
        super().__init__(message)
        self.second = second


@dataclass(frozen=True, slots=True)
class Table:
    """A table of any format.

    titles: headings. reader: function that reads columns by their indices. lost: what could not be read, as sentences,
    after `read`. above: the lines of a text above its rows. labels: function that returns the texts in columns that
    hold a few texts again and again. stamps: headings of the columns whose texts were dates or times of day, after
    `read`: they are in s.
    """

    source: Path
    titles: Sequence[str]
    reader: Callable[[Sequence[int], Filters], tuple[Array, Rows]]
    lost: list[str] = field(default_factory=list)
    above: Sequence[str] = ()
    labels: Callable[[], Mapping[str, Collection[str]]] = dict
    stamps: Collection[str] = ()

    def topics(self) -> str:
        """Return the topics of the bag that holds the table, in words for a message; "" for another file."""
        return bags.topics(self.source) if bags.is_bag(self.source) else ""

    def has(self, name: str) -> bool:
        """Return whether a column has this name, with or without a unit."""
        return name in self.titles or any(name in headings.names(title) for title in self.titles[:_MOST])

    def place(self, name: str) -> int:
        """Return the index of the column `name`; "tau" also finds "tau [mN m]". Raises WrongUse."""
        return place(self.source, self.titles, name)

    def terms(self, text: str) -> list[Term]:
        """Return the columns of a sum with their factors. Raises WrongUse."""
        known = {name for title in self.titles[:_MOST] for name in (title, *headings.names(title))}
        signed = [name for name in known if _SIGNED.fullmatch(name)]
        if _SIGNED.fullmatch(text) and not any(map(self.has, [text, *re.split("[-+/]", text)])):
            self.place(text)  # a path that is not there, rather than a sum of columns that are not
        return terms(text, self.place, self.has, signed)

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
    source: Path,
    *,
    topic: str | None = None,
    joint: str | None = None,
    asked: Collection[str] = (),
    several: bool = False,
) -> Table:
    """Return the table in a file.

    topic: a topic of a bag, or the sheet of a workbook. joint: a joint of a bag. asked: names of columns, which the
    line of headings in a text must contain. several: whether further topics are read, with one zero of the time. Raises
    WrongUse.
    """
    if bags.is_bag(source):
        found, missing = bags.columns(source, topic, joint, several=several)
        stamps = set[str]()
        loader = partial(_read, (source, list(found)), lambda names: [found[one] for one in names], stamps)
        return Table(source, list(found), loader, missing, stamps=stamps)
    kind = formats.kind_of(source)
    if joint is not None or (topic is not None and kind != formats.WORKBOOK):
        raise WrongUse(f"{source} is no bag and has no topics or joints: leave out --topic and --joint")
    if kind not in {formats.TEXT, formats.WORKBOOK}:
        titles, read = formats.columns(source, kind)
        stamps = set[str]()
        loader = partial(_read, (source, titles), read, stamps)
        return Table(source, titles, loader, labels=partial(_labels, titles, read), stamps=stamps)
    form, lost = _bounded_if_packed(source, partial(rows.form, source, asked, topic)), list[str]()
    labels = partial(_bounded_if_packed, source, partial(rows.labels, source, form, asked, topic))

    def read_text(wanted: Sequence[int], filters: Filters) -> tuple[Array, Rows]:
        found = _bounded_if_packed(source, partial(rows.read, source, form, asked, wanted, filters, sheet=topic))
        lost[:] = found.lost
        return found.numbers, found.places

    return Table(source, form.names, read_text, lost, form.top, labels)


def has_topics(source: Path) -> bool:
    """Return whether a file is a bag or a workbook, whose tables are chosen by name."""
    return bags.is_bag(source) or formats.kind_of(source) == formats.WORKBOOK


def _labels(titles: Sequence[str], load: Callable[[Sequence[str]], list[Any]]) -> Mapping[str, Collection[str]]:
    found = {}
    for title in titles[:_MOST]:
        with suppress(WrongUse):
            values = np.asarray(load([title])[0])
            texts = set(values.astype(str).tolist()) if values.dtype.kind in "UO" else set()
            if 0 < len(texts) <= min(_TEXTS, len(values) // 2):
                found[title] = texts
    return found


def _bounded_if_packed(source: Path, work: Callable[[], Answer]) -> Answer:
    """Return the result of `work`, which reads `source`; its memory is limited if `source` is compressed."""
    return bounded(source, work) if source.suffix.lower() == ".gz" else work()


def place(source: Path, known: Sequence[str], name: str) -> int:
    """Return the index of the column `name`; "tau" also finds "tau [mN m]". Raises WrongUse."""
    at = [index for index, title in enumerate(known) if title == name]
    at = at or [index for index, title in enumerate(known[:_MOST]) if name in headings.names(title)]
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
    named: tuple[Path, Sequence[str]],
    load: Callable[[Sequence[str]], list[Any]],
    stamps: set[str],
    wanted: Sequence[int],
    filters: Filters,
) -> tuple[Array, Rows]:
    """Return the columns `wanted` and the row numbers of a file that `load` reads as a whole. stamps: gets the headings
    of texts that are dates or times.
    """
    (source, known), needed = named, list(dict.fromkeys([*wanted, *(at for at, _ in filters)]))
    read = dict(zip(needed, load([known[at] for at in needed]), strict=True))
    lengths = {known[at]: len(values) for at, values in read.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise UnequalLengths(
            f"{source}: columns of unequal length ({listed}), so they are of several tables: name columns of one, or "
            f"of two, and the time of the second: --join {quoted(source)} --join-time NAME",
            lengths,
        )

    def as_numbers(at: int) -> Array:
        found, is_stamp = numbers(read[at])
        stamps.update([known[at]] if is_stamp else [])
        if found is None:
            raise WrongUse(f"{source}: column {known[at]!r} does not hold numbers")
        return found

    kept = np.ones(next(iter(lengths.values())), dtype=np.bool_)
    for at, one in filters:
        kept &= one.keeps(np.asarray(read[at]).astype(str) if isinstance(one.value, str) else as_numbers(at))
    return np.stack([as_numbers(at)[kept] for at in wanted]), np.flatnonzero(kept) + 1
