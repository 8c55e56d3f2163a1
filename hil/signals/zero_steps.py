"""Find the times at which the zero of the torque, or of the deflection, changes during a recording, and the rows in
which the torque is constant although the motion changes it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ga.arrays import Array, Mask
from ga.model.sticking import FULL
from ga.model.trajectory import Motion
from hil.signals import constants as c
from hil.signals.angle import frozen


class ZeroStep(NamedTuple):
    """A step of a zero. channel: "torque" or "deflection". before, time: of the samples before and after it, s. size:
    N m or rad.
    """

    channel: str
    before: float
    time: float
    size: float


def zero_steps(motion: Motion, torque: Array) -> list[ZeroStep]:
    """Return the steps of a zero, in the order of time.

    torque (n,): in the coupling, N m. It is fitted by a curve of the deflection for each direction of motion, damping,
    an inertia and a drift, and steps are added one after the other, each where the residuals fall most (binary
    segmentation; Scott and Knott 1974). A step is kept if it is sudden, lasts, and has several turns of the motion
    before and after it; otherwise it may be friction, a gap or a drift. A large step of the deflection looks like
    another part of the curve; therefore the deflection is fitted by the torque too.
    """
    every = slice(None, None, len(torque) // c.ENOUGH + 1)
    time, torque, angle = motion.time[every], torque[every], motion.dtheta[every]
    for name, values, other in (("torque", torque, angle), ("deflection", angle, torque)):
        columns = _columns(other, motion.dtheta_dot[every], motion.dtheta_ddot[every])
        basis = _orthonormal(np.column_stack([columns, time - time.mean()]))
        if found := _steps(basis, values, other):
            steps = [(ZeroStep(name, float(time[row - 1]), float(time[row]), size), part) for row, size, part in found]
            return [_of_channel(step, torque[part], angle[part], time[part]) for step, part in steps]
    return []


def _steps(basis: Array, values: Array, other: Array) -> list[tuple[int, float, slice]]:
    """Return the steps in `values` (n,) beside the columns of a basis (n, k): row, size, and the rows up to the steps
    before and after. other (n,): the channel that moves to and fro.
    """
    rows, least = list[int](), c.BESIDE_JUMP**2 * float(np.ptp(values))
    while len(rows) < c.ZERO_STEPS and (row := _next(basis, values, rows)):
        rows = sorted([*rows, row])
    while rows:
        sizes, rest = _fitted(basis, values, rows)
        ends = [0, *rows, len(values)]
        found = [
            (row, float(size), slice(*ends[at : at + 3 : 2]))
            for at, (row, size) in enumerate(zip(rows, sizes, strict=True))
        ]
        sure = [_sureness(rest, *one, other) for one in found]
        if min(sure) > c.SURE:
            return found if np.abs(sizes).max() > least else []
        rows.pop(int(np.argmin(sure)))
    return []


def stuck_torque(time: Array, torque: Array, angle: Array) -> Mask:
    """Return in which rows (n,) the torque, N m, is constant for long, although the motion would change it.

    time (n,): s. angle (n,): rad. What the motion would make of it comes from the other rows: in a gap, at the end of
    the sensor's range and after the torque was switched off, it is constant too.
    """
    found = frozen(time, torque, angle, 0.5 * c.FROZEN_TIME)
    if not 0 < np.count_nonzero(found) < 0.5 * len(found):
        return np.zeros(len(found), dtype=bool)
    with np.errstate(all="ignore"):  # beside equal stamps
        rate = np.gradient(angle, time)
        columns = np.nan_to_num(_columns(angle, rate, np.gradient(rate, time)), posinf=0.0, neginf=0.0)
    basis, rows = _orthonormal(columns), np.flatnonzero(found)
    every = basis.T @ torque
    usual = c.SURE * float(np.median(np.abs(torque - basis @ every)))
    for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        of = basis[part]
        others = np.linalg.lstsq(np.eye(len(every)) - of.T @ of, every - of.T @ torque[part], rcond=None)[0]
        found[part[0] - 1] = found[part] = np.median(np.abs(torque[part] - of @ others)) > usual
    return found


def without(steps: list[ZeroStep], channel: str, time: Array, values: Array, scale: float = 1.0) -> Array:
    """Return readings (n,) of a channel at `time` (n,), s, without its steps, each of which lies where the readings
    change most between its two samples. scale: of the readings over the steps.
    """
    values = values.copy()
    for one in steps:
        if one.channel == channel:
            first, last = np.searchsorted(time, one.before, "right"), np.searchsorted(time, one.time)
            values[first + np.argmax(np.abs(np.diff(values[first - 1 : last + 1]))) :] -= scale * one.size
    return values


def _columns(position: Array, rate: Array, acceleration: Array) -> Array:
    """Return columns (n, p): hat functions of a position, for either direction, damping that may grow, inertia."""
    knots = np.unique(np.quantile(position, np.linspace(0.0, 1.0, c.CELLS_A_SIDE + 2)))
    hats = np.stack([np.interp(position, knots, one) for one in np.eye(len(knots))], axis=1)
    direction = np.tanh(rate / (FULL * float(np.sqrt(np.mean(rate**2))) or 1.0))
    dampers = np.stack([rate, np.maximum(rate, 0.0), acceleration, position * rate], axis=1)
    return np.concatenate([hats, hats * direction[:, None], dampers], axis=1)


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis (n, k) of columns (n, p), some of which may depend on others."""
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    kept = values > c.ROUNDED * values[-1]
    return np.asarray(columns @ (vectors[:, kept] / np.sqrt(values[kept])))


def _fitted(basis: Array, values: Array, rows: list[int]) -> tuple[Array, Array]:
    """Return the sizes (k,) of steps that begin in these rows, and the residuals (n,) with basis and steps."""
    steps, rest = _beside(basis, rows), values - basis @ (basis.T @ values)
    sizes = np.asarray(np.linalg.lstsq(steps, rest, rcond=None)[0])
    return sizes, rest - steps @ sizes


def _beside(basis: Array, rows: list[int]) -> Array:
    """Return the columns (n, k) of steps that begin in these rows, orthogonal to a basis (n, p)."""
    steps = np.arange(len(basis))[:, None] >= np.array(rows, dtype=int)
    return np.asarray(steps - basis @ (basis.T @ steps))


def _next(basis: Array, values: Array, rows: list[int]) -> int:
    """Return the row of the step that lowers the squared residuals most beside those in `rows`; 0 if it lowers them
    little.
    """
    rest = _fitted(basis, values, rows)[1]
    basis = np.concatenate([basis, np.linalg.qr(_beside(basis, rows))[0]], axis=1)
    after = np.arange(len(rest), 0, -1)
    power = after - (np.cumsum(basis[::-1], axis=0)[::-1] ** 2).sum(axis=1)
    edge = int(c.MANY * len(rest)) + 1
    is_free = power > c.MANY * after * (1.0 - after / len(rest))
    for row in (0, *rows, len(rest)):
        is_free[max(0, row - edge) : row + edge] = False
    gain = np.where(is_free, np.cumsum(rest[::-1])[::-1] ** 2 / np.maximum(power, 1.0 / len(rest)), 0.0)
    row = int(np.argmax(gain))
    return row if gain[row] > c.PLAIN_MISFIT * float(rest @ rest) else 0


def _sureness(rest: Array, row: int, size: float, part: slice, other: Array) -> float:
    """Return the size of a step over its standard error; 0 if the step is small, not sudden, or beside too little
    motion.

    rest (n,): residuals. part: the rows up to the steps before and after.
    """
    sides = slice(part.start, row), slice(row, part.stop)
    spread = c.SPREAD * float(np.median(np.abs(rest[part])))
    near = max(c.FEWEST, int(2.0 * (2.0 * c.SURE * spread / size) ** 2))
    if near > c.MOST * min(row - part.start, part.stop - row):
        return 0.0
    sums = np.cumsum(np.append(0.0, rest[part]))
    changes = (sums[2 * near :] - 2.0 * sums[near:-near] + sums[: -2 * near]) / near
    change = size + float(changes[row - part.start - near])
    is_sudden = abs(change) > c.SURE * c.SPREAD * np.median(np.abs(changes)) and abs(change - size) < 0.5 * abs(size)
    turns = min(_turns(other[side]) for side in sides)
    error = _change(rest[sides[0]], rest[sides[1]])[1]
    return abs(size) / max(error, np.finfo(float).tiny) if is_sudden and turns >= c.STEP_TURNS else 0.0


def _change(before: Array, after: Array) -> tuple[float, float]:
    """Return by how much the mean changes, and the standard error, from the scatter over blocks of time."""
    means = np.array([[block.mean() for block in np.array_split(one, c.BLOCKS // 4)] for one in (before, after)])
    error = float(np.sqrt(np.var(means, axis=1, ddof=1).sum() / means.shape[1]))
    return float(np.diff(means.mean(axis=1))[0]), error


def _turns(values: Array) -> int:
    """Return how often a channel (n,) moves from its lowest to its highest third, or back."""
    third = np.searchsorted(np.quantile(values, [1.0 / 3.0, 2.0 / 3.0]), values)
    return int(np.count_nonzero(np.diff(third[third != 1])))


def _of_channel(step: ZeroStep, torque: Array, angle: Array, time: Array) -> ZeroStep:
    """Return a step as one of the deflection if its mean surely changes, by more than the stiffness makes of the
    torque's change; else as one of the torque.

    torque, angle, time (m,): around the step alone.
    """
    is_after = time >= step.time
    columns = np.stack([angle, is_after, np.ones_like(angle)], axis=1)
    stiffness = float(np.linalg.lstsq(columns, torque, rcond=None)[0][0])
    of_torque, (change, error) = (_change(one[~is_after], one[is_after]) for one in (torque, angle))
    channel = "deflection" if abs(change) > max(c.SURE * error, abs(of_torque[0] / stiffness)) else "torque"
    if channel == step.channel:
        return step
    return step._replace(channel=channel, size=-step.size * (stiffness if channel == "torque" else 1.0 / stiffness))
