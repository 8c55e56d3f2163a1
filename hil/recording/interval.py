"""The rows between two times: of a table, by the clock of its file, or of a recording, by its time, s."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil import units
from hil.errors import WrongUse

Array = NDArray[np.float64]

_DAY = 86_400.0  # s


class Part(NamedTuple):
    """The rows of a recording from one time to another, both included. None: no bound.

    A bound is a number, s, a quantity of pint, or a text such as "2 min".
    """

    path: Path
    first: Any = None
    last: Any = None


Given = Path | Part
"""A recording that is to be read, all of it or a part."""


def path_of(given: Given) -> Path:
    """Return the file of a recording."""
    return given.path if isinstance(given, Part) else given


def between(given: Sequence[Given], first: Any, last: Any) -> list[Given]:
    """Return the part of each recording between two times, None: no bound. Raises WrongUse if one is a part already."""
    if first is None and last is None:
        return list(given)
    for one in given:
        if isinstance(one, Part):
            raise WrongUse(
                f"{one.path} was loaded between two times already: leave out --from and --to, or name the file instead"
            )
    return [Part(path_of(one), first, last) for one in given]


def named(path: Path, window: tuple[float, float] | None) -> str:
    """Return the name of a recording, with the times of its first and last row, s, if only a part of it was read."""
    return f"{path}" if window is None else f"{path} from {window[0]:.6g} to {window[1]:.6g} s"


def rows_between(source: Path, time: Array, unit: float, first: Any, last: Any) -> NDArray[np.bool_]:
    """Return which rows (n,) are from `first` to `last`, both included; None: no bound.

    time (n,): as in the file, s. unit: the unit, in s, of a bound that states none. A bound is a number, or a text: a
    time as the file has it ("12.5", "2 min"), a date and time, or a time of day. Raises WrongUse, with the times of the
    file, if no row is left.
    """
    known = time[np.isfinite(time)]
    if not known.size:
        raise WrongUse(f"{source}: no row has a time, so none is between --from and --to: leave both out")
    spanned = f"its times are from {_written(known.min(), unit)} to {_written(known.max(), unit)}"
    start, end = (
        None if bound is None else _bound(option, bound, known, unit, spanned)
        for option, bound in (("--from", first), ("--to", last))
    )
    if start is not None and end is not None and start > end:
        raise WrongUse(
            f"{source}: --from {_written(start, unit)} is after --to {_written(end, unit)}, and {spanned}: give the "
            "earlier time first"
        )
    kept = (time >= (-np.inf if start is None else start)) & (time <= (np.inf if end is None else end))
    if not kept.any():
        raise WrongUse(
            f"{source}: no row is between --from and --to, because {spanned}: give times as the file has them"
        )
    return kept


def _bound(option: str, bound: Any, known: Array, unit: float, spanned: str) -> float:
    """Return a bound, s. option: its option, for messages. known: times of the rows, s. spanned: words for them. Raises
    WrongUse.
    """
    if not isinstance(bound, str):
        return _number(option, bound, unit, spanned)
    if (found := seconds(bound)) is None:
        try:
            number, dimension = units.quantity(bound, "time")
        except WrongUse as error:
            raise WrongUse(
                f"{option}: {error}; or a date and time such as '2024-05-01 12:30:00', or a time of day; {spanned}"
            ) from None
        return number * (unit if dimension is None else 1.0)
    if 0.0 <= found < _DAY:  # a time of day: that nearest to the middle of the file
        middle = 0.5 * float(known.min() + known.max())
        found += _DAY * round((middle - found) / _DAY)
    return found


def _number(option: str, bound: Any, unit: float, spanned: str) -> float:
    if hasattr(bound, "magnitude"):
        try:
            bound = bound.to("s").magnitude / unit
        except Exception as error:  # noqa: BLE001 - a unit of the caller's own registry
            raise WrongUse(f"{option}: {bound} is no time ({error}): give s; {spanned}") from None
    try:
        number = math.nan if isinstance(bound, bool | bytes) else float(bound)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise WrongUse(f"{option}: {bound!r} is no time: give a number in s, or a text such as '2 min'; {spanned}")
    return number * unit


def seconds(value: Any) -> float | None:
    """Return a date with a time of day, or a time of day alone (ISO 8601), in s; None if the value is neither."""
    if isinstance(value, time):
        value = datetime.combine(date(1970, 1, 1), value)
    if isinstance(value, str):
        value = _parsed(value.strip()) if ":" in value else None
    if not isinstance(value, datetime):
        return None
    return (value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp()


def _parsed(text: str) -> datetime | None:
    for written in (text, f"1970-01-01 {text}"):
        try:
            return datetime.fromisoformat(written)
        except ValueError:
            continue
    return None


def _written(time: float, unit: float) -> str:
    if time > _DAY * 365.0:
        return str(datetime.fromtimestamp(time, UTC).replace(tzinfo=None))
    known = (one for one in units.COMMON["time"] if units.factor("time", one) == unit)
    return f"{time / unit:.9g} {name}" if (name := next(known, "")) else f"{time:.9g} s"
