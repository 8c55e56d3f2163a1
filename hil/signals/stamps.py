"""Prepare the time stamps of a recording: spread repeated stamps, find pieces without gaps and rows of a block."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ga.arrays import Array, Index, Mask
from hil.signals import constants as c


def pieces(time: Array) -> list[slice]:
    """Return the pieces between the pauses in rising stamps (n,), s. A gap of a few lost rows is no pause, and no step
    of a coarse clock.
    """
    steps = np.diff(time)
    tick = c.APART * float(np.median(steps[steps > 0.0])) if (steps == 0.0).any() and steps.any() else 0.0
    usual = (
        float(np.median(time[c.PACE_ROWS :] - time[: -c.PACE_ROWS])) / c.PACE_ROWS
        if len(time) > c.PACE_ROWS
        else np.inf
    )
    ends = np.flatnonzero(steps > max(usual * max(c.APART, c.MANY * len(time)), tick)) + 1
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
    even, coarse = _before_rounding(time, near), (len(time) - len(starts)) > c.MANY * len(time)
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
    time = time[: c.ENOUGH]
    steps = np.diff(time)
    near = (
        c.SAME_PACKET * float(np.median(time[c.PACE_ROWS :] - time[: -c.PACE_ROWS])) / c.PACE_ROWS
        if len(time) > c.PACE_ROWS
        else 0.0
    )
    are_bursts = np.mean(steps <= near) > c.IN_PACKETS and np.mean((steps > 0.0) & (steps <= near)) > c.MANY
    return near if near and are_bursts else 0.0


def _before_rounding(time: Array, near: float) -> Array:
    """Return the stamps (n,), s, at an even pace, if the stamps differ from an even pace only by rounding or bursts;
    else unchanged.

    A sample taken 0.3 ms from its stamp, at a resolution of a millisecond, has a deflection that is up to 2 % wrong at
    10 Hz. near: the time, s, within which rows arrived together, at the end of the interval in which they were taken.
    """
    steps = np.diff(time)
    unit = max(_unit(time[: c.STAMPS]), _unit(time[-c.STAMPS :]))
    pace = float(time[-1] - time[0]) / max(len(time) - 1, 1)
    if near and unit <= pace:
        unit = c.PACKET_LATE * float(np.median(steps[steps > near]))
    repeat = bool((steps <= near).any())
    if unit * pace == 0.0 or len(time) < 2 * c.SHORTEST_PIECE or repeat is (unit <= pace):
        return time
    usual = np.inf if repeat else float(np.mean(steps[steps < 2.0 * np.median(steps)]))
    # no row is lost, or rows are
    for rows in (np.ones(len(steps)), np.maximum(1.0, np.round(steps / usual))):
        place = np.concatenate([[0.0], np.cumsum(rows)])
        slope, start = _narrowest_line(place, time - time[0]) if repeat else np.polyfit(place, time - time[0], 1)
        even = time[0] + start + slope * place
        # stamps that repeat leave room for a pause of a few rows, which the range of the rounding does not
        if float(np.abs(even - time).max()) < unit and (not repeat or float(np.ptp(even - time)) < c.UNIT_RANGE * unit):
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
    for unit in c.UNITS:
        apart = (time - time[0]) / unit
        if np.abs(apart - np.round(apart)).max() < c.ON_UNIT + digits / unit:
            return unit
    return 0.0


def stretches(time: Array, sound: Mask, step: float) -> tuple[Index, Mask]:
    """Return the first index of each piece of valid samples without gaps, and the samples (n,) that are in a long
    enough piece.

    sound (n,): which samples are valid. step: usual time between two samples, s.
    """
    places = np.flatnonzero(sound)
    breaks = np.flatnonzero((np.diff(places) > 1) & (np.diff(time[places]) > c.APART * step)) + 1
    parts = [part for part in np.split(places, breaks) if len(part) >= c.SHORTEST_PIECE]
    kept = np.zeros(len(time), dtype=bool)
    for part in parts:
        kept[part] = True
    return np.array([part[0] for part in parts], dtype=np.int64), kept


def starts_within(starts: Index, kept: Mask) -> tuple[int, ...]:
    """Return the starts of the pieces as indices into the samples in `kept`."""
    counted = np.unique(np.concatenate([[0], np.cumsum(kept)[starts] - kept[starts]]))
    return tuple(counted[counted < np.count_nonzero(kept)].tolist()) or (0,)


def within(row: Index, rows: tuple[int, int]) -> Mask:
    """Return which row numbers (n,) of a file are at least `rows[0]` and less than `rows[1]`."""
    return (row >= rows[0]) & (row < rows[1])
