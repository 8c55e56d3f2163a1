"""The tables in one file, TABLE:COLUMN: topics of a bag, sheets, groups of columns, rows with one text in a column."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.errors import WrongUse
from hil.exchange.columns import NoCommonRow, Table, UnequalLengths, has_topics, open_table
from hil.exchange.headings import listed, names, unit_of
from hil.exchange.readers import bags
from hil.exchange.row_filter import RowFilter
from hil.exchange.wanted import Column
from hil.printable import quoted
from hil.units import factor

Columns = Mapping[str, Column]

_ROWS = 10  # with a time, from which a column may have times
_RISING = 0.9  # share of the rows, in which times rise
_COMMON = 0.5  # of the shorter of two times, that one clock has in both
_TIME = re.compile(
    r"t\d?|time\d?|times|timestamps?|stamp|clock|date|datetime|zeit|temps|tempo|tiempo|tijd|czas|\u65f6\u95f4|\u6642\u9593",
    re.IGNORECASE,
)


class Side(NamedTuple):
    """One of the tables from which channels are read. name: of the table, for messages. where: the filters."""

    name: str
    table: Table
    columns: Columns
    where: Sequence[RowFilter]


def opened(
    source: Path, columns: Columns, where: Sequence[RowFilter], chosen: tuple[str | None, str | None], *, join: bool
) -> list[Side]:
    """Return the tables of a file from which the channels are read: one or two.

    chosen: topic and joint. join: whether a second file has some of the columns. Raises WrongUse for a table that the
    file does not have, and for more than two.
    """
    asked = set() if join else {column.name for column in columns.values()} | {one.column for one in where}
    keys = {channel: _split(one.name)[0] or chosen[0] for channel, one in columns.items()}
    if not has_topics(source) or not any(":" in one.name for one in columns.values()):
        table = open_table(source, topic=chosen[0], joint=chosen[1], asked=asked)
        return _of_labels(table, columns, where) if not join else [Side(source.name, table, columns, where)]
    if "time" not in columns and bags.is_bag(source):
        columns = {**columns, "time": Column("time")}
    topics = list(dict.fromkeys(key for channel, key in keys.items() if channel != "time"))
    plain = {channel: replace(one, name=_split(one.name)[1]) for channel, one in columns.items()}
    tables = {topic: _of_topic(source, topic, chosen[1], several=len(topics) > 1) for topic in topics}
    return _sides(
        source,
        {channel: key for channel, key in keys.items() if channel != "time"},
        plain,
        lambda key: (tables[key], [one for one in where if len(topics) == 1 or tables[key].has(one.column)]),
    )


def _of_topic(source: Path, topic: str | None, joint: str | None, *, several: bool) -> Table:
    with suppress(WrongUse):
        return open_table(source, topic=topic, joint=joint, several=several)
    return open_table(source, topic=topic, several=several)


def _split(name: str) -> tuple[str, str]:
    key, _, rest = name.partition(":")
    return (key, rest) if rest else ("", name)


def _sides(
    source: Path,
    keys: Mapping[str, str | None],
    columns: Columns,
    of: Callable[[str | None], tuple[Table, Sequence[RowFilter]]],
) -> list[Side]:
    """Return the tables by the key of each channel. of: returns the table of a key, and its filters."""
    wanted = list(dict.fromkeys(keys.values()))
    if len(wanted) > 2:
        raise WrongUse(f"{source}: the columns are of {len(wanted)} tables, {listed(list(map(str, wanted)))}: name two")
    found = []
    for key in wanted:
        table, filters = of(key)
        own = {channel: columns[channel] for channel in keys if keys[channel] == key}
        if (time := columns.get("time")) is not None:
            own["time"] = time if table.has(time.name) else replace(time, name=_time_of(table, time.name, table.titles))
        found.append(Side(str(key), table, own, filters))
    return found


def _time_of(table: Table, like: str, titles: Sequence[str]) -> str:
    """Return the name of the time among columns: the one whose name ends as `like` does, or the only time. Raises
    WrongUse.
    """
    last = _group(like)[1].lower()
    ends = [title for title in titles if last in {_group(one)[1].lower() for one in (title, *names(title))}]
    times = [title for title in titles if is_time(title)]
    for found in (ends, times):
        if len(found) == 1:
            return found[0]
    raise WrongUse(
        f"{table.source}: which column has the times of the second table is not clear, of {listed(titles)}: name it "
        f"with --join {quoted(table.source)} --join-time NAME"
    )


def is_time(title: str) -> bool:
    """Return whether a column has times, by its unit or its name."""
    with suppress(WrongUse):
        if unit_of(title, "time"):
            return True
    return any(_TIME.fullmatch(_group(one)[1].strip("_")) for one in (title, *names(title)))


def _group(title: str) -> tuple[str, str]:
    """Return the path of the group in which a column is, and its last name."""
    match = re.match(r"(.*)[/.](.+)", title)
    return (match[1], match[2]) if match else ("", title)


def _of_labels(table: Table, columns: Columns, where: Sequence[RowFilter]) -> list[Side]:
    """Return the tables whose rows have a text in one column, "tau:value"; or the table, with the names of its groups,
    "cell:torque" for "cell/torque".
    """
    filters, plain = dict[str, RowFilter](), dict(columns)
    for channel, one in columns.items():
        key, rest = _split(one.name)
        grouped = [f"{key}{mark}{rest}" for mark in "/." if key and table.has(f"{key}{mark}{rest}")]
        if table.has(one.name):
            continue
        if grouped:
            plain[channel] = replace(one, name=grouped[0])
        elif label := next((name for name, texts in table.labels().items() if (key or rest) in texts), None):
            if not key:
                raise WrongUse(
                    f"{table.source}: {rest!r} is no column, but a text in the column {label!r}: read a column of its "
                    f"rows, {rest}:COLUMN; it has {listed(table.titles)}"
                )
            filters[channel], plain[channel] = RowFilter(label, "==", key), replace(one, name=rest)
    if not filters:
        return [Side(table.source.name, table, plain, where)]
    keys = {
        channel: str(filters[channel].value) if channel in filters else "" for channel in columns if channel != "time"
    }
    by_key = {str(one.value): one for one in filters.values()}
    return _sides(table.source, keys, plain, lambda key: (table, [*where, *([by_key[key]] if key else [])]))


def by_rows(side: Side, error: UnequalLengths | NoCommonRow, time: str | None) -> list[Side]:
    """Return the two tables of columns of equal length, or of rows that stand in turn. time: of the second. Raises
    `error` if there are more.
    """
    table, columns = side.table, side.columns
    if isinstance(error, NoCommonRow):
        if "time" not in columns:
            raise error
        return _parted(side, error.second, time or columns["time"].name)
    lengths = error.lengths
    own = {
        channel: {lengths[table.titles[table.place(term.column)]] for term in table.terms(one.name)}
        for channel, one in columns.items()
    }
    counts = {max(one) for one in own.values()}
    if "time" not in columns or len(counts) != 2 or any(len(one) > 1 for one in own.values()):
        raise error
    second = [channel for channel, one in own.items() if one != own["time"]]
    if len(second) == len(columns) - 1:
        raise error
    group = _group(table.titles[table.place(table.terms(columns[second[0]].name)[0].column)])[0]
    first = table.titles[table.place(table.terms(columns["time"].name)[0].column)]
    near = [title for title in table.titles if _group(title)[0] == group and title != first]
    try:
        time = time or _time_of(table, columns["time"].name, near)
    except WrongUse:
        raise error from None
    return _parted(side, second, time)


def by_time(side: Side, time: str | None = None) -> list[Side]:
    """Return the two tables of a file in which each channel has the time of its group, or the one before it.

    time: of the second table; None: one that differs from the first where it has both; if there is none, return the one
    table.
    """
    table, columns = side.table, side.columns
    terms = {channel: table.terms(one.name) for channel, one in columns.items()}
    if time is None and len(terms.get("time", ())) != 1:
        return [side]
    first = table.place(terms.pop("time")[0].column)
    times = [at for at, title in enumerate(table.titles) if is_time(title)] if time is None else [table.place(time)]
    ordered = time is not None or bool(table.above)
    places = {channel: table.place(one[0].column) for channel, one in terms.items()}
    own = {channel: _own_time(table, at, first, times, ordered=ordered) for channel, at in places.items()}
    second = [channel for channel, place in own.items() if place != first]
    if time is not None:
        return _parted(side, second, time)
    found = {own[channel] for channel in second}
    if len(found) != 1 or len(second) == len(own) or not _are_two(side, first, place := found.pop()):
        return [side]
    return _parted(side, second, table.titles[place])


def _own_time(table: Table, place: int, first: int, times: Sequence[int], *, ordered: bool) -> int:
    """Return the place of the time that belongs to the column at `place`: one of `times`, or `first`. ordered: whether
    the columns of a table without groups stand behind their time.
    """
    groups = {at: _group(table.titles[at])[0] for at in (place, first, *times)}
    if groups[place] and groups[place] in {groups[at] for at in (first, *times)}:
        inside = [at for at in times if groups[at] == groups[place] != groups[first]]
        return inside[0] if len(inside) == 1 else first
    return max((at for at in (first, *times) if at < place), default=first) if ordered else first


def _are_two(side: Side, first: int, second: int) -> bool:
    """Return whether two columns hold times of one clock, but not the same."""
    titles = [side.table.titles[place] for place in (first, second)]
    try:
        units = [unit_of(title, "time") or side.columns["time"].unit or "s" for title in titles]
        read = side.table.read(titles, side.where)[0]
    except WrongUse:
        return False
    one, two = (values * factor("time", unit) for values, unit in zip(read, units, strict=True))
    if np.array_equal(one, two, equal_nan=True):
        return False
    ends = []
    for time in (one, two):
        known = time[np.isfinite(time)]
        if known.size < _ROWS or (np.diff(known) > 0.0).mean() < _RISING:
            return False
        ends.append((known[0], known[-1]))
    common = min(last for _, last in ends) - max(start for start, _ in ends)
    return bool(common > _COMMON * min(last - start for start, last in ends))


def _parted(side: Side, second: Sequence[str], time: str) -> list[Side]:
    others = {channel: one for channel, one in side.columns.items() if channel not in second}
    timed = {channel: side.columns[channel] for channel in second} | {"time": replace(side.columns["time"], name=time)}
    if len(others) == 1 or not second:
        raise WrongUse(f"{side.table.source}: all columns have one time: leave --join out")
    parts = [one | {"time": time} for one, time in ((others, side.columns["time"]), (timed, timed["time"]))]
    same = parts[0]["time"].name == time
    return [
        side._replace(columns=one, name=next(iter(one.values())).name if same else one["time"].name) for one in parts
    ]
