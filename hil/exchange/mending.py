"""Mend a table: stamps that begin anew or stand in another order, and numbers that were logged without their sign, in
two's complement or with a sign bit.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_BITS = (16, 24, 32)
_TICKS = (1.0, 1e-3, 1e-6, 1e-9)  # s, that a counter counts
_DAY = 86400.0  # s
_NEAR = 20.0  # usual steps, within which a counter reaches its end and begins anew
_DAMAGED = 0.01  # share of the rows that may have no time, or a wrong one
_MOVED = 0.02  # share of the rows, by which one may be out of place
_FEW = 64  # rows, by which one may always be
_ALONE = 3  # rows at most that have a wrong stamp side by side
_PIECE = 64  # rows at least, on average, before the stamps go back once more
_PAUSE = 0.1  # of all rows: a longer gap than any that identification passes over
_DENSE = 0.7  # of the usual step, below which two records overlap
_LEAST = 128.0  # counts, below which the largest number has no sign bit
_SMOOTHER = 0.9  # of the sum of all steps, that a decoded column has at most
_EXPLAINED = 0.25  # of the torque that the deflection does not explain, that is left once both are decoded
_ON_GRID = 0.05  # of a count, within which a number is a whole number of them
_ROWS = 20_000  # that are looked at


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
    time, pieces = _continued(source, time[order], rows[known][order])
    if pieces and one_clock:
        raise WrongUse(f"{source}: {pieces}. No second file can be joined to such times: choose one part with --where")
    said += [pieces] if pieces else []
    if not said:
        return channels, rows, []
    return {name: values[known][order] for name, values in channels.items()} | {"time": time}, rows[known][order], said


def _unwrapped(time: Array, unit: float) -> tuple[Array, float]:
    """Return stamps (n,), s, that continue where a counter wrapped around, and the counter's range, s; 0 without a
    wrap.

    unit: unit of the column, s. A counter of 16, 24 or 32 bits, or a time of day, is recognised if every step back
    leads from the end of its range to the beginning.
    """
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    for span in [2.0**bits * tick for tick in dict.fromkeys((unit, *_TICKS)) for bits in _BITS] + [_DAY]:
        back = np.flatnonzero(steps < -0.5 * span)
        near = min(_NEAR * usual, 0.01 * span)
        low = -0.5 * span if time.min() < 0.0 else 0.0
        at_ends = (low + span - time[back] <= near) & (time[back + 1] - low <= near)
        # a counter that starts from zero begins anew for a second run too, after any time
        is_day = span != _DAY or time[0] - low > near
        if back.size and at_ends.all() and is_day and time.max() <= low + span + near:
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


def decoded(values: Array, code: str) -> Array:
    """Return the numbers (n,) with their sign.

    code: "wrap=65536" for two's complement of 16 bits, or an encoder that begins anew at 65536; "sign=1024" for a sign
    bit of value 1024 above the magnitude; "none" for numbers with a sign. Raises WrongUse for any other code.
    """
    if code == "none":
        return values
    match = re.fullmatch(r"(wrap|sign)=(\d+\.?\d*)", code)
    if match is None or not (size := float(match[2])) > 0.0:
        raise WrongUse(
            f"{code!r} is no code of numbers: write wrap=65536 for 16 bits in two's complement, sign=1024 for a sign "
            "bit above 10 bits, or none"
        )
    if match[1] == "sign":
        return np.where(values >= size, size - values, values)
    return (values + 0.5 * size) % size - 0.5 * size


def size_of(code: str) -> float:
    """Return the number in a code, in the units of its column."""
    return float(code.partition("=")[2])


def recognised(torque: Array, dtheta: Array) -> tuple[str, str]:
    """Return the codes of torque and deflection (n,), in the units of their columns; "none" for a column with its sign.

    A code is recognised if the column has no negative number and is smoother when decoded, and if deflection and rate
    then explain most of the torque that they do not explain without decoding.
    """
    good = np.isfinite(torque) & np.isfinite(dtheta)
    pairs = list(product(["none", *_possible(torque[good])], ["none", *_possible(dtheta[good])]))
    if len(pairs) == 1:
        return pairs[0]
    left = [_unexplained(decoded(torque[good], one), decoded(dtheta[good], other)) for one, other in pairs]
    best = int(np.argmin(left))
    return pairs[best] if left[best] < _EXPLAINED * left[0] else pairs[0]


def _possible(values: Array) -> Iterator[str]:
    """Yield the codes that make a column (n,), which has no negative number, smoother."""
    if len(values) < 3 or values.min() < 0.0 or not (count := _count(values)):
        return
    top = float(values.max()) / count
    if top < _LEAST:
        return
    bits = np.floor(np.log2(top))
    for kind, size in (("wrap", 2.0 ** (bits + 1.0)), ("sign", 2.0**bits)):
        code = f"{kind}={size * count:.10g}"
        if _roughness(decoded(values, code)) < _SMOOTHER * _roughness(values):
            yield code


def _count(values: Array) -> float:
    """Return the step of which all values (n,) are multiples; 0 if there is none."""
    if not (values % 1.0).any():
        return 1.0
    levels = np.unique(values)
    step = float(np.diff(levels).min())
    for value in levels[levels > 0.0].tolist():
        step = value / max(round(value / step), 1)
    return step if np.abs(values / step - np.round(values / step)).max() < _ON_GRID else 0.0


def _roughness(values: Array) -> float:
    return float(np.abs(np.diff(values)).sum())


def _unexplained(torque: Array, dtheta: Array) -> float:
    """Return the fraction of the torque's variance that deflection and rate do not explain."""
    torque, dtheta = torque[:_ROWS], dtheta[:_ROWS]
    if np.ptp(torque) == 0.0:
        return 1.0
    columns = np.column_stack([np.ones_like(dtheta), dtheta, np.gradient(dtheta)])
    rest = torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
    return float(np.var(rest) / np.var(torque))
