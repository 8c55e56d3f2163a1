"""Find the readings of a sensor slower than the ticks, whose readings repeat or are joined by straight lines.

Only the sensor's own readings are used, each at the time of its conversion. A reading that repeats was converted
between the first tick that shows it and the previous tick. If the sensor keeps its own pace, a line through many such
times gives the times to a small fraction of a tick; otherwise the middle of the two ticks is used. Where lines join the
readings, the corner between two lines is a reading, with its time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ga.arrays import Array, Index, Mask
from ga.model.trajectory import Motion
from hil.signals import constants as c
from hil.signals.deflection_noise import smallest_step

Kind = Literal["held", "joined"]
Channel = Literal["torque", "deflection"]


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """The readings of a sensor: their conversion times (m,), s, and values (m,), in the order of time.

    row (m,): the sample that holds each reading. unsure: the range, s, of the unknown age that all readings have in
    common. drifts: the largest change of this age from the first to the last reading, in either direction, s.
    """

    row: Index
    time: Array
    value: Array
    unsure: float = 0.0
    drifts: float = 0.0

    @property
    def step(self) -> float:
        """The usual time between two readings, s."""
        return float(np.median(np.diff(self.time)))


@dataclass(frozen=True, slots=True)
class Slower:
    """A channel whose sensor is slower than the ticks.

    step: the usual time between its readings, s. tick: the usual time between ticks, s. unsure: the range, s, of the
    unknown age that its readings have in common. drifts: the largest change of this age, s.
    """

    channel: Channel
    kind: Kind
    step: float
    tick: float
    unsure: float
    drifts: float = 0.0


def kind_of(time: Array, values: Array) -> Kind | None:
    """Return what a channel (n,) at time (n,), s, shows between the readings of a sensor slower than the ticks.

    "held": the last reading repeats. "joined": straight lines between the readings. None: the sensor is not slower.
    """
    if len(values) < c.FEWEST_READINGS or np.ptp(values) == 0.0:
        return None
    count = smallest_step(values)
    if _is_held(values, count):
        return "held"
    # a clock that rounds bends a smooth motion here and there
    return (
        "joined" if _is_joined(time, values, count) and len(_corners(time, values).row) >= c.FEWEST_READINGS else None
    )


def slower(
    torque: Kind | None, own: Readings | None, dtheta: Kind | None, angle: Readings, stamps: Array
) -> tuple[Slower, ...]:
    """Return the channels whose sensor is slower than the rows at `stamps` (n,), s.

    torque, dtheta: kinds of the channels. own, angle: the sensors' own readings.
    """
    found, step = [], float(np.median(np.diff(stamps))) if torque or dtheta else np.nan
    if torque is not None and own is not None:
        found.append(Slower("torque", torque, own.step, step, own.unsure, own.drifts))
    if dtheta is not None:
        found.append(Slower("deflection", dtheta, angle.step, step, angle.unsure, angle.drifts))
    return tuple(found)


def readings(time: Array, values: Array, kind: Kind) -> Readings:
    """Return the sensor's own readings (m,) of a channel of this kind, fewer than the channel's samples (n,)."""
    return _held(time, values) if kind == "held" else _corners(time, values)


def stamped(time: Array, values: Array) -> Readings:
    """Return the readings of a channel (n,) that another device stamps. time (n,): its stamps, s; NaN without one."""
    row = np.flatnonzero(np.isfinite(time) & (np.diff(time, prepend=np.nan) != 0.0))
    return Readings(row, time[row], values[row])


def noise_beside_any_shape(own: Readings, motion: Motion) -> float:
    """Return the standard deviation, N m, of the part of the readings (m,) that no torque of the motion (n,) explains.

    Between two readings the joint may move far, so the distance from a smooth curve through the readings is not their
    noise. 0 for too few readings.
    """
    inside = (own.time >= motion.time.min(initial=np.inf)) & (own.time <= motion.time.max(initial=-np.inf))
    time = own.time[inside]
    if min(len(time), len(motion)) < c.FEWEST_READINGS:
        return 0.0
    few = slice(None, None, -(-len(time) // c.PACE_READINGS))
    at = motion.at(time[few])
    shapes = _shapes(at)
    seen = own.value[inside][few][np.searchsorted(time[few], at.time)]
    left = seen - shapes @ np.linalg.lstsq(shapes, seen, rcond=None)[0]
    free = max(len(left) - shapes.shape[1], 1)
    return float(c.SPREAD * np.median(np.abs(left)) * np.sqrt(len(left) / free))


def _shapes(motion: Motion) -> Array:
    """Return the possible components of a torque (n, k), each of about size one.

    The components are a line that bends at several deflections, friction that grows with the deflection, damping that
    grows with the rate, branches that relax, and an inertia.
    """
    scale, fastest = float(np.ptp(motion.dtheta)) or 1.0, float(np.max(np.abs(motion.dtheta_dot))) or 1.0
    x, v = (motion.dtheta - motion.dtheta.min()) / scale, motion.dtheta_dot / fastest
    a, sign = motion.dtheta_ddot / fastest, np.sign(motion.dtheta_dot)
    many = min(c.BENDS, len(x) // c.READINGS_A_BEND)
    places = np.unique(np.quantile(x, np.arange(1, many + 1) / (many + 1.0)))
    size, (whole, rows) = float(np.max(np.abs(a))) or 1.0, motion.whole
    slow = np.geomspace(motion.step, c.SLOWEST_BRANCH * float(np.ptp(motion.time)), c.BRANCHES)
    relaxing = [whole.lagged(whole.dtheta_dot, constant)[rows] / fastest for constant in slow]
    shapes = [np.ones_like(x), x, v, a / size, v * np.abs(v), sign, x * sign, *relaxing]
    return np.stack([*shapes, *np.maximum(x[:, None] - places, 0.0).T], axis=1)


def _is_held(values: Array, count: float) -> bool:
    """Return whether values (n,) repeat where the motion is so fast that a fast sensor would change at each tick.

    count: the smallest step of the values.
    """
    changes = np.flatnonzero(np.diff(values)) + 1
    if len(changes) < c.FEWEST_READINGS:
        return False
    reach = max(2, 2 * int(np.median(np.diff(changes))))
    if len(values) <= 2 * reach:
        return False
    moved = np.abs(values[2 * reach :] - values[: -2 * reach]) / (2.0 * reach)
    repeats = (values[reach:-reach] == values[reach - 1 : -reach - 1])[moved > c.COUNTS_A_TICK * count]
    return len(repeats) >= c.FEWEST_READINGS and bool(np.mean(repeats) > c.HELD) and _is_paced(np.diff(changes))


def _is_paced(ticks: Index) -> bool:
    """Return whether readings come at an even pace. ticks (m,): the number of ticks that each reading lasts.

    A reading at an even pace lasts one of two neighbouring numbers of ticks. Repeats caused by a median filter have no
    even pace.
    """
    usual = np.minimum(ticks, 3.0 * (np.median(ticks) + 2.0))  # counts that repeat at rest last longer
    pace, part = float(usual.mean()), float(usual.mean()) % 1.0
    return bool(np.var(usual) < part * (1.0 - part) + (c.UNEVEN_PACE * pace) ** 2 + c.CHANCE_PACE)


def _held(time: Array, values: Array) -> Readings:
    row = np.flatnonzero(np.diff(values)) + 1
    before, shown = time[row - 1], time[row]
    row = row[(certain := shown - before <= c.MISSING * float(np.median(np.diff(time))))]
    before, shown = before[certain], shown[certain]
    at, unsure, drifts = _converted(before, shown)
    return Readings(row, at, values[row], unsure, drifts)


def _converted(before: Array, shown: Array) -> tuple[Array, float, float]:
    """Return when readings were converted (m,), s, between the times `before` and `shown` (m,), s.

    Two more results are the range of the error that these times have in common, s, and the largest change of that error
    from the first to the last reading, s.
    """
    middle = 0.5 * (before + shown)
    even, unsure, drifts = _even(_numbered(np.diff(middle)), before, shown)
    if np.mean(np.abs(even - middle) <= c.OFF_PACE * (shown - before)) < c.NEARLY_ALL:
        return middle, 0.0, 0.0
    return np.clip(even, before, shown), unsure, drifts


def _numbered(steps: Array) -> Array:
    """Return the number (m + 1,) of each reading, counted from the first; missing readings are counted too.

    steps (m,): the times between successive readings, s.
    """
    usual = float(np.mean(steps[steps < c.MISSING * np.median(steps)]))
    for _ in range(2):  # steps of two and three ticks have a mean of neither
        counts = np.maximum(np.round(steps / usual), 1.0)
        usual = float(steps.sum() / counts.sum())
    return np.concatenate([[0.0], np.cumsum(counts)])


def _even(number: Array, before: Array, shown: Array) -> tuple[Array, float, float]:
    """Return conversion times (m,), s, at a constant period, each between `before` and `shown` (m,), s.

    number (m,): the index of each reading. before: the last time at which a reading was not shown yet; shown: the first
    time at which it was. Of all periods that fit, the one in the middle is chosen. Also returned, in s: the range of
    the common shift of all times, and the largest shift over the whole recording that another period would make.
    """
    from scipy.optimize import linprog

    few = slice(None, None, max(1, len(number) // c.PACE_READINGS))
    scale, start = float(np.ptp(number)) or 1.0, float(before[0])
    line = np.stack([np.ones(len(number)), (number - number.mean()) / scale], axis=1)
    inside, ends = np.concatenate([line[few], -line[few]]), np.concatenate([shown[few], -before[few]])
    ends = (ends - np.repeat([start, -start], len(line[few]))) * 1e3  # in ms, which suit the solver's tolerances
    best = linprog([0.0, 0.0, -1.0], np.column_stack([inside, np.ones(len(inside))]), ends, bounds=(None, None)).x
    loose = ends - min(float(best[2]), 0.0) + c.ROUNDED_MS
    ranges = (
        [linprog(sign * part, inside, loose, bounds=(None, None)).fun * sign for sign in (1.0, -1.0)]
        for part in np.eye(2)
    )
    (low, high), (shortest, longest) = ranges
    drifts = max(longest - best[1], best[1] - shortest, 0.0)
    return line @ best[:2] / 1e3 + start, abs(float(high - low)) / 1e3, float(drifts) / 1e3


def _bends(time: Array, values: Array) -> Array:
    """Return the distance (n,) of the next sample from the line through this and the previous one; infinite at the
    ends.
    """
    steps = np.diff(time)
    bends = np.abs(np.diff(np.diff(values) / steps)) * np.minimum(steps[1:], steps[:-1])
    return np.concatenate([[np.inf], bends, [np.inf]])


def _tolerance(values: Array, bends: Array, count: float) -> float:
    """Return the largest distance from a line at which three samples (n,) are still collinear.

    bends (n,): the distances from lines. count: the smallest step of the values. A program that writes seven digits
    rounds larger values by more than a count.
    """
    fine = max(c.STRAIGHT * count, 1e-6 * float(np.median(np.abs(np.diff(values)))))
    rough = max(fine, c.ROUGH * float(np.quantile(bends[1:-1], c.NEARLY_ALL)))
    return rough if float(np.mean((bends > fine) & (bends <= rough))) > c.SMALL_PART else fine


def _is_joined(time: Array, values: Array, count: float) -> bool:
    """Return whether the channel consists of straight lines of a few samples each, also where it bends sharply. count:
    the smallest step of the values.
    """
    if (np.diff(time) <= 0.0).any():
        return False
    bends = _bends(time, values)
    tolerance = _tolerance(values, bends, count)
    bent = bends[1:-1][bends[1:-1] > tolerance]  # of lines of ten samples hardly one in ten is
    most = float(np.quantile(bent, c.MOST)) if bent.size else 0.0
    if count >= c.SMALL_COUNT * most:  # rounding to counts alone makes lines
        return False
    by_chance = c.SMALL_BENDS * tolerance / most
    # where it comes to rest by a few counts a tick, any motion is a line
    fast = np.abs(np.diff(values)) > max(tolerance, c.CLEAR_CORNER * count)
    moves = np.concatenate([[False], fast[1:] & fast[:-1], [False]])
    on = (bends <= tolerance) & moves
    runs = _runs(on)
    if len(runs) < c.FEWEST_READINGS:
        return False
    usual = int(np.median(runs[:, 1] - runs[:, 0]))
    # between lines of four samples there is but a corner; a smooth motion is straight where it turns the other way
    if usual > 2 and not _mostly(_largest_near(on, c.CORNER // 2)[moves & ~on]):
        return False
    reach = 2 * usual
    # a smooth motion hardly bends beside a sample where it does not
    sharp = _largest_near(np.where(np.isfinite(bends), bends, 0.0), reach) > c.SHARP * tolerance
    least = max(c.ON_LINES, c.BEYOND_CHANCE * by_chance)
    return least <= float(np.mean(on & sharp)) and float(np.mean(on)) <= c.NEARLY_ALL and _mostly(sharp[on])


def _largest_near(values: NDArray[Any], reach: int) -> NDArray[Any]:
    """Return the largest (n,) of each value and its `reach` neighbours on each side (faster than to import scipy)."""
    around = np.pad(values, reach, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(around, 2 * reach + 1).max(axis=1))


def _mostly(where: Mask) -> bool:
    return not len(where) or bool(np.mean(where) > 0.5)


def _runs(on: Mask) -> Index:
    """Return the first and last sample (k, 2) of each line. on (n,): which samples lie on the line between their
    neighbours.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(np.int8)))
    return np.stack([edges[::2] - 1, edges[1::2]], axis=1)


def _with_short_ones(lines: Index) -> Index:
    """Return all lines (k, 2): the given ones, and the lines of only two samples between them.

    lines: the first and the last sample of each line of three or more samples.
    """
    left = lines[1:, 0] - lines[:-1, 1] - 1
    pairs = np.where((left > 0) & (left % 2 == 0) & (left <= 2 * c.SHORT_LINES), left // 2, 0)
    within = np.arange(pairs.sum()) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    first = np.repeat(lines[:-1, 1] + 1, pairs) + 2 * within
    found = np.concatenate([lines, np.stack([first, first + 1], axis=1)])
    return found[np.argsort(found[:, 0], kind="stable")]


def _corners(time: Array, values: Array) -> Readings:
    count = smallest_step(values)
    bends = _bends(time, values)
    first, last = _with_short_ones(_runs(bends <= _tolerance(values, bends, count))).T
    slope = (values[last] - values[first]) / (time[last] - time[first])
    bend = np.diff(slope)
    # two lines meet between the last sample of one and the first of the next, which may be the same
    meets = (first[1:] - last[:-1] <= 1) & (np.abs(bend) * float(np.median(np.diff(time))) > c.CLEAR_CORNER * count)
    apart = values[first[1:]] - slope[1:] * time[first[1:]] - (values[last[:-1]] - slope[:-1] * time[last[:-1]])
    at = -np.divide(apart, bend, out=np.zeros_like(apart), where=meets)
    near = 0.1 * float(np.median(np.diff(time)))
    meets &= (at >= time[last[:-1]] - near) & (at <= time[first[1:]] + near)
    value = values[last[:-1]] + slope[:-1] * (at - time[last[:-1]])
    return Readings(last[:-1][meets], at[meets], value[meets])
