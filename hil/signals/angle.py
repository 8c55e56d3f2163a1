"""Detect faults of the readings of an angle: a far zero, jumps by a turn, single wrong readings, a frozen angle; and
single wrong readings of a torque.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ga.arrays import Array, Index, Mask
from hil.signals import constants as c


def difference(order: int) -> Array:
    """Return the weights (order + 1,) of the finite difference of an even order, scaled to 1 at the middle reading.

    The weighted sum is the reading less the value of the polynomial through its neighbours.
    """
    weights = np.poly(np.ones(order))
    return np.asarray(weights / weights[order // 2])


_CUBIC = difference(4)


def unwrapped(angle: Array, torque: Array) -> tuple[Array, int]:
    """Return the angle (n,), rad, without the jumps at the end of its encoder's range, and the number of these jumps.

    torque (n,): N m. If all steps are small after whole turns are subtracted, every large step is a jump by a turn.
    Otherwise a step is a jump only if all steps larger than a tenth of the largest are equal. The jump is certain only
    for a turn or half a turn, or if several jumps lead from one end of the readings to the other while the torque is
    continuous: behind a gear, the encoder's range can have any size.
    """
    steps = np.diff(angle)
    whole = np.round(steps / c.TURN)
    if whole.any() and np.ptp(angle) <= c.TURN and np.abs(steps - c.TURN * whole).max() <= c.LARGEST_STEP * c.TURN:
        return np.unwrap(angle, period=c.TURN), int(np.count_nonzero(whole))
    jumps = np.abs(steps) > c.BESIDE_JUMP * np.abs(steps).max(initial=0.0)
    size = _range_of(steps, jumps)
    turns = [turn for turn in (c.TURN, 0.5 * c.TURN) if abs(size - turn) < c.BESIDE_JUMP * turn]
    if turns:
        return np.unwrap(angle, period=turns[0]), int(np.count_nonzero(jumps))
    if not size or not _goes_round(angle, torque, jumps, size):
        return angle, 0
    return np.unwrap(angle, period=size), int(np.count_nonzero(jumps))


def _range_of(steps: Array, jumps: Mask) -> float:
    """Return the range of the encoder, rad, that explains all these jumps (n,) among the steps (n,) of an angle; 0 if
    none does.
    """
    if not jumps.any() or np.count_nonzero(jumps) > c.MANY * len(steps):
        return 0.0
    # the joint moved on during the jump, as it did before
    places = np.flatnonzero(jumps)
    before = np.where(places > 0, np.where(jumps[places - 1], 0.0, steps[places - 1]), 0.0)
    sizes = np.abs(steps[places] - before)
    size = float(np.median(sizes))
    return size if float(np.abs(sizes - size).max()) < c.BESIDE_JUMP * size else 0.0


def _goes_round(angle: Array, torque: Array, jumps: Mask, size: float) -> bool:
    """Return whether jumps of `size`, rad, occur at the end of the encoder's range.

    Such jumps lead from one end of the range to the other, while the torque does not jump.
    """
    usual = float(np.abs(np.diff(angle)[~jumps]).max(initial=0.0))
    low, high = float(angle.min()), float(angle.max())
    first = angle[:-1][jumps]
    at_ends = np.minimum(first - low, high - first) <= 2.0 * usual
    changes = np.abs(np.diff(torque))
    goes_on = float(np.median(changes[jumps])) <= c.TORQUE_STEP * float(np.median(changes)) + 1e-12 * float(
        np.ptp(torque)
    )
    return (
        int(np.count_nonzero(jumps)) >= c.REPEATED
        and high - low <= size + 2.0 * usual
        and bool(at_ends.all())
        and goes_on
    )


def spikes(time: Array, angle: Array) -> Mask:
    """Return which readings (n,) of an angle, rad, at times (n,), s, are single wrong readings.

    A single wrong reading is far from the cubic through the two readings on each side. In a sharp motion the
    neighbours' readings are far from their cubics too, but not in the pattern that a single wrong reading causes.
    """
    wrong = np.zeros(len(angle), dtype=bool)
    off, far = _far(time, angle)
    if not far.size:
        return wrong
    far = far[(far >= 2) & (far < len(off) - 2)]
    around = off[far[:, None] + np.arange(-2, 3)] - off[far, None] * _CUBIC / _CUBIC[2]
    far = far[np.abs(around).max(axis=1, initial=0.0) < c.BESIDE_JUMP * np.abs(off[far])]
    # stamps that jitter move every reading of a fast motion, and some of them alone
    first = np.clip(far - c.BURST // 2, 0, max(len(off) - c.BURST, 0))
    beside = np.abs(off[first[:, None] + np.arange(min(c.BURST, len(off)))])
    wrong[far[np.abs(off[far]) > c.WRONG_READING * c.SPREAD * np.median(beside, axis=1)] + 2] = True
    return wrong if np.count_nonzero(wrong) <= c.MANY * len(angle) else np.zeros_like(wrong)


def _far(time: Array, angle: Array) -> tuple[Array, Index]:
    """Return the distances (n - 4,) of the readings from the cubic through their neighbours, and which are far.

    The neighbours are assumed to be equally spaced, because only their stamps may be late. Beside lost replies, and if
    a row was read late, a correct reading lies on the cubic through its neighbours at their stamps, and is not far.
    """
    if len(angle) < 2 * len(_CUBIC):
        return np.zeros(0), np.zeros(0, dtype=np.int64)
    off = np.convolve(angle - angle.mean(), _CUBIC, mode="valid")
    least = float(np.abs(np.diff(angle))[np.diff(angle) != 0.0].min(initial=np.inf))
    limit = c.WRONG_READING * max(c.SPREAD * float(np.median(np.abs(off))), least)
    far = np.flatnonzero(np.abs(off) > limit)
    return off, far[~(np.abs(_off_in_time(time, angle, far + 2)) <= limit)]


def _off_in_time(time: Array, angle: Array, rows: Index) -> Array:
    """Return the distances (k,) of the readings in these rows (k,) from the cubic through two readings on each side, at
    their times (Lagrange); NaN or infinite where two of the times are equal.
    """
    beside = rows[:, None] + np.array([-2, -1, 1, 2])
    apart = time[beside] - time[rows, None]
    found = angle[rows].copy()
    with np.errstate(all="ignore"):
        for at in range(beside.shape[1]):
            others = np.delete(apart, at, axis=1)
            found -= angle[beside[:, at]] * np.prod(others / (others - apart[:, at, None]), axis=1)
    return found


def bursts(time: Array, angle: Array, torque: Array) -> Mask:
    """Return which readings (n,) of an angle, rad, lie in a short burst of wrong ones: random, held or displaced.

    time (n,): s. torque (n,): N m. In a burst the angle jumps away from the cubic through its neighbours, but the
    torque stays on its cubic. If the joint had really moved, the torque would have jumped too.
    """
    wrong = np.zeros(len(angle), dtype=bool)
    angle = unwrapped(angle, torque)[0] if len(angle) else angle
    off, far = _far(time, angle)
    groups = [part for part in np.split(far, np.flatnonzero(np.diff(far) > c.BURST) + 1) if part.size]
    rows = [slice(int(part[0]) + 1, int(part[-1]) + 4) for part in groups]
    for part in rows:
        wrong[part] = True
    if wrong.all() or not rows:
        return np.zeros_like(wrong)
    spread, slope = np.cov(angle[~wrong], torque[~wrong])[0]
    carried = np.convolve(torque - torque.mean(), _CUBIC, mode="valid") * (spread / slope if slope else np.inf)
    changes = np.concatenate([[0], np.flatnonzero(np.diff(angle)) + 1, [len(angle)]])  # a reading that is held joins
    for part in rows:
        near = slice(part.start - 1, part.stop - 3)
        # a motion that is read five times a period or more leaves its cubic by less than a third of its largest step
        jumps = 3.0 * np.abs(off[near]).max() > np.abs(np.diff(angle[part.start - 1 : part.stop + 1])).max()
        stays = 2.0 * np.linalg.norm(carried[near]) < np.linalg.norm(off[near])
        first = min(part.start, int(changes[np.searchsorted(changes, part.start + 1, "right") - 1]))
        last = max(part.stop, int(changes[np.searchsorted(changes, part.stop - 2, "right")]))
        wrong[first:last] = jumps and stays and last - first < c.BURST
    return wrong if np.count_nonzero(wrong) <= c.MANY * len(angle) else np.zeros_like(wrong)


def outliers(time: Array, torque: Array, angle: Array) -> Mask:
    """Return which readings (n,) of a torque, N m, are single wrong ones, such as -1 for a failed read, or lie in a
    burst of up to 5.

    time (n,): s. angle (n,): rad. A torque that repeats, as that of a slow sensor does, is one reading.
    """
    new = np.diff(torque, prepend=np.nan) != 0.0
    if np.count_nonzero(new) < 0.5 * len(new):
        return np.asarray(outliers(time[new], torque[new], angle[new])[np.cumsum(new) - 1])
    kept = np.arange(len(torque))
    while len(kept) > max(c.BURST, (1.0 - c.MANY) * len(torque)):
        found = _off_motion(time[kept], torque[kept], angle[kept])
        kept = kept[~found]  # without these, less is usual beside the others
        if not found.any():
            return ~np.isin(np.arange(len(torque)), kept)
    return np.zeros(len(torque), dtype=bool)


def _median(values: Array, width: int) -> Array:
    """Return the medians (n,) of values and their neighbours, `width` in all; beyond the ends, values go on as they
    came.
    """
    windows = sliding_window_view(np.pad(values, width // 2, mode="reflect", reflect_type="odd"), width)
    found = np.empty(len(values))
    for begin in range(0, len(values), c.TABLE_ROWS):  # a copy of all windows would need `width` times the memory
        part = slice(begin, begin + c.TABLE_ROWS)
        found[part] = np.partition(windows[part], width // 2, axis=1)[:, width // 2]
    return found


def _off_motion(time: Array, torque: Array, angle: Array) -> Mask:
    """Return which readings (n,) of a torque are far from the median of their neighbours, with and without the
    torque of a spring, a damper and friction.

    Far is more than usual for the readings beside it, and for those at the same deflection: a gap that the joint
    crosses in a few readings, or a stop, changes the torque at the same deflection again and again. A step, as of
    friction that reverses, is not far from the median.
    """
    width = 2 * len(_CUBIC) + 1
    usual = _median(torque, width)
    off = np.abs(torque - usual)
    with np.errstate(all="ignore"):  # beside equal stamps
        rate = np.gradient(angle, time)
    columns = np.stack([angle, rate, np.sign(rate), np.ones_like(angle)], axis=1)
    columns = np.nan_to_num(columns, posinf=0.0, neginf=0.0)
    part = np.flatnonzero(off <= np.quantile(off, c.MOST))[:: len(off) // c.ENOUGH + 1]
    values = np.linalg.lstsq(columns[part], torque[part], rcond=None)[0]
    rest = torque - columns @ values
    both = np.minimum(off, off := np.abs(rest - _median(rest, width)))
    # near a reversal, friction may have either direction, and more than its usual size
    moved = np.sign(np.diff(angle, prepend=angle[0]))
    before = len(_CUBIC) // 2
    near = sliding_window_view(np.pad(moved, (before, before + 1), mode="symmetric"), len(_CUBIC) + 1)
    both -= 2.0 * abs(values[2]) * np.ptp(near, axis=1)  # three readings before, and three after
    steps = np.abs(np.diff(rest, prepend=rest[0]))
    changes = np.abs(np.diff(torque))
    least = max(float(changes[changes > 0.0].min(initial=np.inf)), c.ACCURATE * float(np.ptp(usual)))
    is_far = both > c.WRONG_READING * max(c.SPREAD * float(np.median(off)), least)
    is_far[_CUBIC.size : -_CUBIC.size] &= time[width - 1 :] - time[: 1 - width] < 2.0 * width * np.median(np.diff(time))
    far = np.flatnonzero(is_far)
    # a wrong reading makes two steps, and has others beside it in a burst, but not at its deflection
    for order, share in ((np.arange(len(off)), 4.0 * c.MANY), (np.argsort(angle), 2.0 * c.MANY)):
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        first = np.clip(place[far] - c.BURST // 2, 0, len(off) - c.BURST)
        beside = order[first[:, None] + np.arange(c.BURST)]
        limits = [c.WRONG_READING * c.SPREAD * np.median(off[beside], axis=1)]
        limits += [c.TORQUE_STEP * np.quantile(one[beside], 1.0 - share, axis=1) for one in (off, steps)]
        far = far[both[far] > np.max(limits, axis=0)]
    return np.isin(np.arange(len(off)), far)


def far_zero(angle: Array) -> float:
    """Return the middle of an angle's range, rad, if the angle's zero is farther away than 1.5 times the range, else
    0.
    """
    low, high = float(angle.min()), float(angle.max())
    middle = 0.5 * (low + high)
    return middle if abs(middle) > c.FAR_ZERO * (high - low) else 0.0


def frozen(time: Array, angle: Array, torque: Array, shortest: float = c.FROZEN_TIME) -> Mask:
    """Return a mask (n,) of the samples in which an angle is constant while the torque covers a third of its range.

    time s, angle rad, torque N m. shortest: time that it lasts at least, s. In a pause, or while friction holds the
    joint, the torque covers less than that.
    """
    changes = np.flatnonzero(np.diff(angle) != 0.0) + 1
    if not changes.size:
        return np.zeros(len(angle), dtype=bool)
    edges = np.concatenate([[0], changes, [len(angle)]])
    lasted = time[edges[1:] - 1] - time[edges[:-1]]
    found = np.zeros(len(angle), dtype=bool)
    usual = float(lasted.sum() - lasted.max()) / (len(lasted) - 1)
    for at in np.flatnonzero(lasted > max(shortest, c.FROZEN_STEPS * usual)).tolist():
        rows = slice(int(edges[at]) + 1, int(edges[at + 1]))
        found[rows] = np.ptp(np.quantile(torque[rows], (1.0 - c.NEARLY_ALL, c.NEARLY_ALL))) > c.FROZEN_TORQUE * np.ptp(
            torque
        )
    return found
