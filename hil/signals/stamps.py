"""Prepare the time stamps of a recording: spread repeated stamps, find pieces without gaps and rows of a block."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.signals.constants import ENOUGH, MANY

Array = NDArray[np.float64]

_UNITS = sorted([10.0**-k for k in range(2, 7)] + [2.0**-k for k in range(6, 20)], reverse=True)
# s, to which stamps are often rounded: decimals, and what numbers of single precision can hold
_ROWS = 20  # over which the usual pace is taken: more than a burst has
_BURST = 0.2  # of a usual step, below which two rows were stamped together
_LATE = 1.2  # times between two bursts, by which the rows of one are stamped too late at most
_IN_BURSTS = 0.3  # share of such steps from which rows arrived in bursts: samples at random times have 0.18
_ON_UNIT = 0.01  # of a unit, within which a stamp is a multiple of it
_FULL = 1.05  # of a unit: the range of stamps that were all cut off alike, but for what a fitted pace is off
_LOOKED = 1000  # stamps at either end that show whether they are
APART = 4.0
"""Median steps between two samples, above which they belong to two pieces."""
_SHORTEST = 8  # samples of a stretch, below which nothing is interpolated on it


def pieces(time: Array) -> list[slice]:
    """Return the pieces between the pauses in rising stamps (n,), s. A gap of a few lost rows is no pause."""
    steps = np.diff(time)
    usual = float(np.median(time[_ROWS:] - time[:-_ROWS])) / _ROWS if len(time) > _ROWS else np.inf
    ends = np.flatnonzero(steps > usual * max(APART, MANY * len(time))) + 1
    return [slice(a, b) for a, b in pairwise([0, *ends.tolist(), len(time)])]


def mean_step(time: Array) -> float:
    """Return the mean time, s, between two samples with rising stamps (n,), s, without the pauses."""
    parts = [time[part] for part in pieces(time)]
    return float(sum(part[-1] - part[0] for part in parts)) / max(len(time) - len(parts), 1)


def spread_stamps(time: Array) -> tuple[Array, bool]:
    """Return the stamps (n,), s, with repeats and bursts spread evenly up to the next stamp, and whether many stamps
    were spread.

    A clock that ticks every 15.6 ms gives several rows one stamp. The order of the rows is known, and their spacing is
    even within the loop's jitter. The rows of the last stamp before a pause continue at the rate of the rows before.
    """
    parts = pieces(time)
    if len(parts) > 1:
        found = [spread_stamps(time[part]) for part in parts]
        return np.concatenate([one for one, _ in found]), any(coarse for _, coarse in found)
    if len(time) < 2:
        return time, False
    near = _together(time)
    starts = np.flatnonzero(np.concatenate(([True], np.diff(time) > near)))
    even, coarse = _before_rounding(time, near), (len(time) - len(starts)) > MANY * len(time)
    if even is not time or len(starts) == len(time):
        return even, coarse
    rows = np.arange(len(time), dtype=np.float64)
    last, before = starts[-1], starts[max(0, len(starts) - 50)]
    pace = (time[last] - time[before]) / max(last - before, 1)
    anchors = np.append(starts.astype(np.float64), len(time))
    at_anchors = np.append(time[starts], time[last] + pace * (len(time) - last))
    return np.interp(rows, anchors, at_anchors), coarse


def _together(time: Array) -> float:
    """Return the time, s, below which successive rows were stamped together; 0 unless many rows arrived in bursts.

    A packet brings several rows, which a computer stamps one after the other. Jitter of a loop seldom brings samples so
    close.
    """
    time = time[:ENOUGH]
    steps = np.diff(time)
    near = _BURST * float(np.median(time[_ROWS:] - time[:-_ROWS])) / _ROWS if len(time) > _ROWS else 0.0
    are_bursts = np.mean(steps <= near) > _IN_BURSTS and np.mean((steps > 0.0) & (steps <= near)) > MANY
    return near if near and are_bursts else 0.0


def _before_rounding(time: Array, near: float) -> Array:
    """Return the stamps (n,), s, at an even pace, if the stamps differ from an even pace only by rounding or bursts;
    else unchanged.

    A sample taken 0.3 ms from its stamp, at a resolution of a millisecond, has a deflection that is up to 2 % wrong at
    10 Hz. near: the time, s, within which rows arrived together, at the end of the interval in which they were taken.
    """
    steps = np.diff(time)
    unit = max(_unit(time[:_LOOKED]), _unit(time[-_LOOKED:]))
    pace = float(time[-1] - time[0]) / max(len(time) - 1, 1)
    if near and unit <= pace:
        unit = _LATE * float(np.median(steps[steps > near]))
    repeat = bool((steps <= near).any())
    if unit == 0.0 or len(time) < 2 * _SHORTEST or repeat is (unit <= pace):
        return time
    usual = np.inf if repeat else float(np.mean(steps[steps < 2.0 * np.median(steps)]))
    # no row is lost, or rows are
    for rows in (np.ones(len(steps)), np.maximum(1.0, np.round(steps / usual))):
        place = np.concatenate([[0.0], np.cumsum(rows)])
        slope, start = _narrowest_line(place, time - time[0]) if repeat else np.polyfit(place, time - time[0], 1)
        even = time[0] + start + slope * place
        # stamps that repeat leave room for a pause of a few rows, which the range of the rounding does not
        if float(np.abs(even - time).max()) < unit and (not repeat or float(np.ptp(even - time)) < _FULL * unit):
            return np.asarray(even)
    return time


def _narrowest_line(place: Array, time: Array) -> tuple[float, float]:
    """Return slope and start of the line whose largest distance from the stamps (n,), s, is the smallest.

    place (n,): the index of each stamp. Stamps that end in half a unit are rounded up in long runs and down in long
    runs, which tilts the line of least squares.
    """
    from scipy.optimize import minimize_scalar

    slope = float(np.polyfit(place, time, 1)[0])
    reach = float(np.ptp(time - slope * place)) / float(place[-1])
    # in units of what there is to gain: the search stops at 1e-5 of its variable
    found = minimize_scalar(
        lambda change: float(np.ptp(time - (slope + change * reach) * place)) / reach, bounds=(-1, 1), method="bounded"
    )
    slope += float(found.x) * reach
    left = time - slope * place
    return slope, 0.5 * float(left.min() + left.max())


def _unit(time: Array) -> float:
    """Return the unit, s, of which all stamps (n,) are multiples; 0 if there is no such unit."""
    digits = 4.0 * float(np.spacing(np.abs(time).max()))
    for unit in _UNITS:
        apart = (time - time[0]) / unit
        if np.abs(apart - np.round(apart)).max() < _ON_UNIT + digits / unit:
            return unit
    return 0.0


def stretches(time: Array, sound: NDArray[np.bool_], step: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the first index of each piece of valid samples without gaps, and the samples (n,) that are in a long
    enough piece.

    sound (n,): which samples are valid. step: usual time between two samples, s.
    """
    places = np.flatnonzero(sound)
    breaks = np.flatnonzero((np.diff(places) > 1) & (np.diff(time[places]) > APART * step)) + 1
    parts = [part for part in np.split(places, breaks) if len(part) >= _SHORTEST]
    kept = np.zeros(len(time), dtype=bool)
    for part in parts:
        kept[part] = True
    return np.array([part[0] for part in parts], dtype=np.int64), kept


def starts_within(starts: NDArray[np.int64], kept: NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the starts of the pieces as indices into the samples in `kept`."""
    counted = np.unique(np.concatenate([[0], np.cumsum(kept)[starts] - kept[starts]]))
    return tuple(counted[counted < np.count_nonzero(kept)].tolist()) or (0,)


def within(row: NDArray[np.int64], rows: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which rows (n,) of a file lie between the two numbers in `rows`, the first included."""
    return (row >= rows[0]) & (row < rows[1])
