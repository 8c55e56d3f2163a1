"""What is understood of a file: its columns, units, rows and rate, and the command that imports it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.checks import PAIRS
from hil.exchange.columns import Table, open_table
from hil.exchange.headings import bracketed_text, names, unit_of
from hil.exchange.importer import understand
from hil.exchange.mending.rate import stated_rate
from hil.exchange.tables import is_time
from hil.exchange.wanted import DIMENSION, Column
from hil.printable import quoted

Array = NDArray[np.float64]

_SHOWN = 24  # columns in the table
_SET_POINT = re.compile(
    r"(?<![^\W_])(?:input|target|set(?:[ _-]?point)?|cmd|command(?:ed)?|desired|ref|reference|goal|demand|soll)"
    r"(?![^\W_])",
    re.IGNORECASE,
)
_TIMES = re.compile(r"(?<![^\W_])(?:time|timestamp|stamp|elapsed|uptime|received|zeit)(?![^\W_])", re.IGNORECASE)
_WORDS = {
    "torque": r"torque|tau|effort|moment|drehmoment|couple|load ?cell",
    "dtheta": r"angle|theta|dtheta|position|pos|deflection|rotation|phi|winkel|q|encoder",
}
_HEAD = ("column", "unit", "may be", "from", "to", "no number")


def look(
    source: Path, columns: Mapping[str, Column] | None = None, *, refused: bool = False, **chosen: Any
) -> list[str]:
    """Return lines of text: the columns of a file, what is understood of its rows, and the command that imports it.

    columns: those that the user names. refused: whether what is wrong is said already. chosen: topic, joint, rate and
    filters as for `understand`. Raises WrongUse if the file cannot be opened.
    """
    table = open_table(source, topic=chosen.get("topic"), joint=chosen.get("joint"), asked=_asked(columns))
    numbers = _numbers(table, [title for title in table.titles[:_SHOWN] if title])
    known = {title: values for title, values in numbers.items() if isinstance(values, np.ndarray)}
    may_be = {title: role for title, values in known.items() if (role := _role(title, values))}
    read = {role: Column(_short(table, title)) for title, role in reversed(may_be.items()) if role in DIMENSION}
    for pair in PAIRS:
        if any(one in (columns or {}) for one in pair):
            read.pop(pair[0], None)
    read |= {channel: one for channel, one in (columns or {}).items() if _can_be(table, channel, one)}
    rate = chosen.get("rate") or (None if "time" in read else stated_rate(table))
    rows = [
        _HEAD,
        *(
            _row(title, numbers[title], may_be.get(title, ""), "s" if title in table.stamps else "")
            for title in numbers
        ),
    ]
    lines = [f"{source}: {len(table.titles)} columns", *_aligned(rows)]
    if more := len(table.titles) - len(numbers):
        lines.append(f"and {more} more columns")
    unread = [one for title, one in numbers.items() if isinstance(one, WrongUse) and _named(title)]
    lines += [f"looks wrong: {one}" for one in unread if not refused]
    lines += _rows_of(source, read, rate, chosen, refused=refused)
    return [*lines, "to import it:", "  " + _command(source, read, rate, table, chosen)]


def _asked(columns: Mapping[str, Column] | None) -> set[str]:
    return {one.name for one in (columns or {}).values()}


def _numbers(table: Table, titles: Sequence[str]) -> dict[str, Array | WrongUse | None]:
    """Return the numbers in each column, (n,); the error of a column without them; None if its heading repeats."""
    once = [title for title in titles if table.titles.count(title) == 1]
    places = [table.titles.index(title) for title in once]
    with suppress(WrongUse):
        return dict.fromkeys(titles) | dict(zip(once, table.reader(places, [])[0], strict=True))
    found = dict[str, Array | WrongUse | None].fromkeys(titles)
    for title, place in zip(once, places, strict=True):
        try:
            found[title] = table.reader([place], [])[0][0]
        except WrongUse as error:
            found[title] = error
    return found


def _can_be(table: Table, channel: str, column: Column) -> bool:
    """Return whether the table has the column, and no heading says that it is something else than the channel."""
    with suppress(WrongUse):
        terms = table.terms(column.name)
        for one in terms if channel in DIMENSION else ():
            unit_of(table.titles[table.place(one.column)], DIMENSION[channel])
        return bool(terms)
    return ":" in column.name


def _role(title: str, values: Array) -> str:
    """Return the channel that a column (n,) may be, "" if its heading does not say, or its values do not change."""
    if not (np.nanmax(values, initial=-np.inf) > np.nanmin(values, initial=np.inf)):
        return ""
    if is_time(title) or (_TIMES.search(title) and (np.diff(values) > 0.0).all()):
        return "time"
    stated = [one for one in ("torque", "angle", "rate", "time") if _states(title, one)]
    found = [one for one in _WORDS if DIMENSION[one] in stated] or ([] if stated else _named(title))
    return "set-point" if found and _SET_POINT.search(title) else next(iter(found), "")


def _named(title: str) -> list[str]:
    """Return the channels that the words of a heading name."""
    return [
        channel
        for channel, words in _WORDS.items()
        if re.search(rf"(?<![^\W_])(?:{words})\d*(?![^\W_])", title, re.IGNORECASE)
    ]


def _states(title: str, dimension: str) -> bool:
    with suppress(WrongUse):
        return unit_of(title, dimension) is not None
    return False


def _short(table: Table, title: str) -> str:
    return next((one for one in names(title) if sum(one in names(other) for other in table.titles) == 1), title)


def _row(title: str, values: Array | WrongUse | None, may_be: str, unit: str) -> tuple[str, ...]:
    unit = unit or bracketed_text(title) or ""
    for dimension in ("time", "torque", "angle", "rate") if not unit else ():
        with suppress(WrongUse):
            unit = unit or unit_of(title, dimension) or ""
    good = values[np.isfinite(values)] if isinstance(values, np.ndarray) else np.empty(0)
    if not isinstance(values, np.ndarray) or not good.size:
        return title, unit, may_be, "no numbers", "", ""
    missing = len(values) - good.size
    return title, unit or "not stated", may_be, f"{good.min():.9g}", f"{good.max():.9g}", str(missing or "")


def _aligned(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def _rows_of(
    source: Path, columns: Mapping[str, Column], rate: float | None, chosen: Mapping[str, Any], *, refused: bool
) -> list[str]:
    """Return sentences about the rows that the columns give: their number, their rate, and what is mended or wrong."""
    try:
        _, _, found, said = understand(source, columns, **{**chosen, "rate": rate})
    except WrongUse as error:
        return [] if refused else [f"looks wrong: {error}"]
    time = found.channels["time"]
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
    lines = [f"rows: {len(time)} over {np.ptp(time):.6g} s, mostly {usual:.6g} s apart ({1.0 / usual:.5g} Hz)"]
    return lines + [f"mended: {one}" for one in found.mended] + ([said] if said else [])


def _command(
    source: Path, columns: Mapping[str, Column], rate: float | None, table: Table, chosen: Mapping[str, Any]
) -> str:
    """Return the command that imports the file, with capital letters for what the user must fill in."""
    words = ["hil import", quoted(source)]
    for channel in ("time", *(one for pair in PAIRS for one in (pair if pair[1] in columns else pair[:1])), *columns):
        option = "--" + channel.replace("_", "-")
        if channel in columns and option not in words:
            words += [option, quoted(columns[channel].name), *_unit(table, channel, columns[channel])]
        elif channel == "time" and channel not in columns:
            words += ["--rate", f"{rate:.9g}" if rate else "HZ"]
        elif channel in {"torque", "dtheta"} and not {*columns} & {*dict(PAIRS).items(), channel, dict(PAIRS)[channel]}:
            words += [option, "NAME"]
    words += [f"--{key} {quoted(chosen[key])}" for key in ("topic", "joint") if chosen.get(key)]
    words += ["--stand FILE"] if {"motor_torque", "motor_position"} & {*columns} else []
    name = source.with_suffix(".h5").name
    return " ".join([*words, "-o", quoted(name if name != source.name else f"{source.stem}-imported.h5")])


def _unit(table: Table, channel: str, column: Column) -> list[str]:
    option = channel.replace("motor_torque", "torque").replace("motor_position", "dtheta").replace("_", "-")
    unit = column.unit
    if channel in DIMENSION:
        with suppress(WrongUse):
            terms = [(one, table.titles[table.place(one.column)]) for one in table.terms(column.name)]
            stated = [one.unit or unit_of(title, DIMENSION[channel]) for one, title in terms]
            is_stamp = channel == "time" and {title for _, title in terms} <= {*table.stamps}
            unit = None if None not in stated or is_stamp else unit or "UNIT"
    scale = [] if column.scale == 1.0 else [f"--{option}-scale", f"{column.scale:.9g}"]
    return ([] if unit is None else [f"--{option}-unit", quoted(unit)]) + scale
