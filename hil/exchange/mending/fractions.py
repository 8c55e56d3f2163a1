"""Stamps without their fraction of a second: spread evenly where the number of rows in each second is steady."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.signals.constants import PACE_ROWS

Array = NDArray[np.float64]

_LEAST = 4  # rows of one stamp, from which a fraction is missing
_COARSE = 0.5  # s between two stamps, from which identification does not spread the rows
_STEADY = 0.02  # share of the rows in a second, by which their number may vary
_WHOLE = 3  # seconds that have all their rows, from which their number is known
_NEXT = 10.0  # steps, within which most stamps follow the one before
_ON_GRID = 1e-3  # of the step between stamps, within which all are multiples of it
_PART = 0.1  # of the step between stamps, that their fraction spans at least
_USUAL = 0.95  # share of the rows in which a fraction rises within its second
_FRACTIONS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}  # in a second


class WholeSeconds(WrongUse):
    """The stamps lack their fraction of a second, and the number of rows in a second varies."""


def spread(source: Path, time: Array) -> tuple[Array, str]:
    """Return rising stamps (n,), s, with the rows of one stamp at even times up to the next, and a sentence about it;
    "" for stamps that have their fraction.

    The first rows, and those after a pause, end with their second; the last rows begin with it. Raises WrongUse if the
    number of rows in a second varies, because the times between rows are then unknown.
    """
    starts = np.flatnonzero(np.diff(time, prepend=-np.inf))
    counts, steps = np.diff(starts, append=len(time)), np.diff(time[starts])
    usual = float(np.median(counts))
    if usual < _LEAST or not steps.size or (steps < 0.0).any():
        return time, ""
    step = float(steps.min())
    on_grid = np.median(steps) < _NEXT * step and np.abs(steps / step - np.round(steps / step)).max() < _ON_GRID
    if not on_grid or (step < _COARSE and usual <= PACE_ROWS):
        return time, ""
    after, before = (np.append(*one) > 1.5 * step for one in ((steps, [np.inf]), (np.inf, steps)))
    whole = counts[~(after | before)]
    usual = float(np.median(whole)) if whole.size else usual
    most = max(1.5, _STEADY * usual)
    kind = "whole seconds" if abs(step - 1.0) < _ON_GRID else f"multiples of {step:.6g} s"
    if whole.size < _WHOLE or np.abs(whole - usual).max() > most or counts.max() > usual + most:
        raise WholeSeconds(
            f"{source}: the times are {kind}, and {counts.min()} to {counts.max()} rows share one, so the time between "
            "rows is unknown, and with it Bc. Export the times with all digits, name a column with "
            "the fraction too, such as --time 's + ms', or state the rate of even rows, --rate 500"
        )
    said = f"the times are {kind}: the {usual:.0f} rows of each are spread evenly, which only an even rate makes right"
    return _line(time[starts], starts, counts) if not (after[:-1].any()) else _within(time, starts, step, usual), said


def _line(stamps: Array, starts: NDArray[np.int64], counts: NDArray[np.int64]) -> Array:
    """Return the times of all rows on one line through the first row of each stamp, or within each if no line fits."""
    rows = np.arange(counts.sum(), dtype=np.float64)
    slope, offset = np.polyfit(starts[1:].astype(np.float64), stamps[1:], 1)
    if np.abs(offset + slope * starts[1:] - stamps[1:]).max() <= slope:
        return np.asarray(offset + slope * rows)
    usual = float(np.median(counts[1:-1]))
    return _within(np.repeat(stamps, counts), starts, float(np.diff(stamps).min()), usual)


def _within(time: Array, starts: NDArray[np.int64], step: float, usual: float) -> Array:
    """Return the times of all rows, spread within the step, s, of their stamp. usual: rows in a whole one."""
    counts = np.diff(starts, append=len(time))
    place = np.arange(len(time)) - np.repeat(starts, counts)
    apart = np.diff(time[starts], prepend=-np.inf) > 1.5 * step
    is_end = apart & (counts < usual - max(1.5, _STEADY * usual))  # what a pause or the start left of a step
    is_begin = ~is_end & (counts < usual - max(1.5, _STEADY * usual))
    each = np.where(is_end | is_begin, step / usual, step / counts)
    first = np.where(is_end, step - counts * each, 0.0)
    return np.asarray(time + np.repeat(first, counts) + np.repeat(each, counts) * place)


def fraction(time: Array, columns: Iterable[tuple[str, Callable[[], Array]]]) -> tuple[str, str] | None:
    """Return the name and the unit of the column that holds the fraction of the stamps (n,), s; None without one.

    columns: names, and functions that read a column (n,); a column that cannot be read raises WrongUse.
    """
    for name, read in columns:
        try:
            values = read()
        except WrongUse:
            continue
        same = np.diff(time) == 0.0
        if len(values) != len(time) or not np.isfinite(values).all() or values.min() < 0.0 or same.all():
            continue
        rises = np.diff(values) > 0.0
        unit = next((unit for unit, most in _FRACTIONS.items() if 0.5 * most < values.max() < most), None)
        if unit and rises[same].mean() > _USUAL and rises[~same].mean() < 1.0 - _USUAL:
            return name, unit
    return None


def check_sum(source: Path, parts: Sequence[tuple[str, Array]]) -> None:
    """Raise WrongUse for a sum of times (n,), s, in which one is no fraction of another: both count the same time."""
    resolved = sorted(((_step(values), name, values) for name, values in parts), key=lambda one: -one[0])
    for (step, name, _), (_, finer, values) in pairwise(resolved):
        good = values[np.isfinite(values)]
        if good.size and np.ptp(good) > 1.01 * step:
            raise WrongUse(
                f"{source}: {finer!r} passes {step:.6g} s, the step of {name!r}, so it is no fraction of it, and their "
                f"sum no time: name {finer!r} alone with --time"
            )
        if good.size and np.isfinite(step) and np.ptp(good) < _PART * step:
            raise WrongUse(
                f"{source}: {finer!r} spans {np.ptp(good):.3g} s of the {step:.6g} s from one {name!r} to the next, so "
                "Bc would be wrong: leave its factor out where the heading states the unit, or correct the unit"
            )


def _step(values: Array) -> float:
    levels = np.unique(values[np.isfinite(values)])
    return float(np.diff(levels).min()) if len(levels) > 1 else np.inf
