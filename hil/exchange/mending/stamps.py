"""Stamps that begin anew, stand in another order, or lack their fraction of a second."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.exchange.mending import fractions

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_BITS = (15, 16, 24, 30, 31, 32)
_RARER_BITS = tuple(bits for bits in range(10, 40) if bits not in _BITS)
_TICKS = (1.0, 1e-3, 1e-6, 1e-9, 1e-7)  # s, that a counter counts
_CLOCKS = (86400.0, 43200.0, 3600.0, 60.0, 1.0)  # s, after which a clock begins anew
_FALLING = 0.9  # share of all steps that lead back, from which the newest row is the first
_NEAR = 20.0  # usual steps, within which a counter reaches its end and begins anew
_DAMAGED = 0.01  # share of the rows that may have no time, or a wrong one
_MOVED = 0.02  # share of the rows, by which one may be out of place
_FEW = 64  # rows, by which one may always be
_ALONE = 3  # rows at most that have a wrong stamp side by side
_PIECE = 64  # rows at least, on average, before the stamps go back once more
_PAUSE = 0.1  # of all rows: a longer gap than any that identification passes over
_DENSE = 0.7  # of the usual step, below which two records overlap


def in_order(
    source: Path, channels: dict[str, Array], rows: Rows, unit: float, *, one_clock: bool
) -> tuple[dict[str, Array], Rows, list[str]]:
    """Return the channels and the numbers of their rows in the order of time, and sentences about what was mended.

    unit: unit of the stamps, s. one_clock: whether to refuse stamps that go back. Raises WrongUse for times that are
    missing in many rows, or that go back again and again.
    """
    known, said = np.isfinite(channels["time"]), list[str]()
    count, bad = len(known), np.flatnonzero(~known)
    if bad.size > _DAMAGED * count:
        raise WrongUse(
            f"{source}, row {rows[bad[0]]}: the time is not a number, in {bad.size} of {count} rows: delete these "
            "rows, or fill in their times; a gap does no harm"
        )
    if bad.size:
        said.append(f"{bad.size} of {count} rows have no time and are left out")
    steps = np.diff(channels["time"][known])
    if np.count_nonzero(steps < 0.0) > _FALLING * np.count_nonzero(steps):
        said.append(
            "the times fall, so the newest row is the first: the rows are turned round. If the column counts "
            "down instead, write --time '-NAME'"
        )
        channels, rows = {name: values[::-1] for name, values in channels.items()}, rows[::-1]
        known = known[::-1]
    time, span = _unwrapped(channels["time"][known], unit)
    if span:
        said.append(f"the time begins anew after {span:.7g} s, the range of its counter, and is continued")
    order = _order(time)
    wrong = _astray(time[order])
    if 0 < np.count_nonzero(wrong) <= _DAMAGED * count:
        said.append(f"{np.count_nonzero(wrong)} of {count} rows have a wrong time and are left out")
        order = order[~wrong]
    if moved := np.count_nonzero(np.diff(order) < 0):
        said.append(f"rows are out of order, in {moved} places of {count}; they are sorted by their times")
    time, spread = fractions.spread(source, time[order])
    time, pieces = _continued(source, time, rows[known][order])
    if pieces and one_clock:
        raise WrongUse(f"{source}: {pieces}. No second file can be joined to such times: choose one part with --where")
    said += [one for one in (spread, pieces) if one]
    if not said:
        return channels, rows, []
    return {name: values[known][order] for name, values in channels.items()} | {"time": time}, rows[known][order], said


def _unwrapped(time: Array, unit: float) -> tuple[Array, float]:
    """Return stamps (n,), s, that continue where a counter wrapped around, and the counter's range, s; 0 without a
    wrap.

    unit: unit of the column, s. A counter with a number of bits, a clock, or a counter that begins anew more than once
    after the same time, is recognised if every step back leads from the end of its range to the beginning.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0.0)
    if not back.size or not (steps > 0.0).any():
        return time, 0.0
    usual = float(np.median(steps[steps > 0.0]))
    ticks = tuple(dict.fromkeys((unit, *_TICKS)))
    spans = [2.0**bits * tick for tick in ticks for bits in _BITS]
    # a counter that starts from zero begins anew for a further run too, after any time
    rarer = [*_CLOCKS, *(2.0**bits * tick for tick in ticks for bits in _RARER_BITS)]
    rarer += [float(np.median(-steps[back])) + usual] if back.size > 1 else []
    for span in [*spans, *rarer]:
        back = np.flatnonzero(steps < -0.5 * span)
        near = min(_NEAR * usual, 0.01 * span)
        low = -0.5 * span if time.min() < 0.0 else 0.0
        at_ends = (low + span - time[back] <= near) & (time[back + 1] - low <= near)
        is_clock = span in spans or time[0] - low > near
        if back.size and at_ends.all() and is_clock and time.max() <= low + span + near:
            turns = np.cumsum((steps < -0.5 * span).astype(np.int64) - (steps > span - near))
            return time + span * np.concatenate([[0], turns]), span
    return time, 0.0


def _order(time: Array) -> Rows:
    """Return the order (n,) in which the stamps (n,), s, rise, if the rows were only written out of order; otherwise
    the present order.

    Rows that two threads wrote out of order fill gaps when they are sorted. Where a clock was set back, or a second run
    begins, sorted rows would be denser than elsewhere.
    """
    rising = np.argsort(time, kind="stable")
    places = np.arange(len(time))
    shifts = np.abs(rising - places)
    if not shifts.any() or shifts.max() > max(min(_FEW, len(time) // 8), _MOVED * len(time)):
        return places
    steps = np.diff(time[rising])
    disturbed = np.maximum.accumulate(rising)[:-1] > places[:-1]  # steps within a run of rows out of place
    outside = steps[~disturbed] if np.count_nonzero(~disturbed) > np.count_nonzero(disturbed) else steps
    usual = float(np.mean(np.minimum(outside, _NEAR * np.median(outside))))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], disturbed, [False]]).astype(np.int8)))
    dense = [float(steps[a:b].mean()) < _DENSE * usual for a, b in edges.reshape(-1, 2)]
    small = np.count_nonzero(steps < 0.5 * (1.0 - _DENSE) * usual) > 0.5 * len(steps)
    return places if any(dense) or small else rising


def _astray(time: Array) -> NDArray[np.bool_]:
    """Return which stamps (n,), s, are single wrong stamps: 0, or far ahead, between rows whose stamps rise."""
    low = time < np.maximum.accumulate(time)
    high = time > np.minimum.accumulate(time[::-1])[::-1]
    wrong = min(low, high, key=np.count_nonzero)
    run = np.convolve(wrong, np.ones(_ALONE + 1), "valid") if len(wrong) > _ALONE else np.ones(1)
    return wrong if run.max() <= _ALONE else np.zeros_like(wrong)


def _continued(source: Path, time: Array, rows: Rows) -> tuple[Array, str]:
    """Return stamps (n,), s, with a pause in place of each step back, and a sentence about these steps; "" without any.

    rows (n,): the numbers of the rows. Raises WrongUse if the stamps go back so often that they are no time.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0.0)
    if not back.size:
        return time, ""
    at = int(back[0])
    if back.size * _PIECE > len(time):
        raise WrongUse(
            f"{source}, row {rows[at + 1]}: the time goes backwards by {-steps[at]:.6g} s, as in {back.size} of "
            f"{len(time)} rows: it is no time: name another column"
        )
    pause = _PAUSE * len(time) * float(np.median(steps[steps > 0.0]))
    later = np.zeros(len(time))
    later[back + 1] = pause - steps[back]
    again = time[at + 1] - time[0] < 0.02 * np.ptp(time[: at + 1]) + 1e-9
    cause = "to where it began: a further run begins there" if again else "because the clock was set"
    return time + np.cumsum(later), (
        f"the time goes back by {-steps[at]:.6g} s in row {rows[at + 1]}, {cause}"
        f"{f', and again in {back.size - 1} other rows' if back.size > 1 else ''}. The rows from there on are read as "
        f"after a pause of {pause:.3g} s; if they are of another joint or setting, choose one part with --where"
    )
