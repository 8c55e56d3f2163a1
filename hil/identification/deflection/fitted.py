"""A model at its exact optimum, and its motion with other errors of the deflection."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ga.arrays import Array, Mask
from ga.model.coupling import lag_of
from ga.model.separable import SeparableModel
from ga.model.trajectory import Motion
from hil.signals.constants import CLIPPED, CORRECTED, NORMAL, SPREAD, SURE, TESTED
from hil.signals.rate.windows import Window


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model at its exact optimum, with the data that it was fitted to, SI.

    torque (n,): the torque as read, N m. used (n,): the samples that the model was fitted to. genes (p,), nonlinear
    (q,): the linear and the nonlinear parameters. half_width (p + q,): half the parameters' intervals. decisive: the
    indices of the parameters that decide whether anything is corrected. window: the window from which the rate was
    computed. command (n,): the set-points, None if not recorded. torque_count: the smallest step between two readings
    of the torque, N m.
    """

    model: SeparableModel
    motion: Motion
    torque: Array
    used: Mask
    genes: Array
    nonlinear: Array
    half_width: Array
    decisive: tuple[int, ...]
    window: Window
    command: Array | None
    torque_count: float = 0.0

    def part(self) -> Fitted:
        """Return the fit on consecutive samples from the middle of the recording, or, where the joint rests there, from
        where it moves most.
        """
        whole, places = self.motion.whole
        last = max(0, len(whole) - TESTED)
        starts = [last // 2, *(min(start, last) for start in range(0, len(whole), TESTED))]
        power = [float(np.var(whole.dtheta[start : start + TESTED])) for start in starts]
        first = starts[0 if power[0] > 0.1 * max(power) else int(np.argmax(power))]
        motion = whole.alone(slice(first, first + TESTED))
        rows = np.arange(len(whole))[places] - first
        inside = (rows >= 0) & (rows < len(motion))
        if self.motion.part_of is not None:  # a slow cell's readings are far apart: what is between them is needed
            motion = motion.of(rows[inside])
        command = None if self.command is None else self.command[inside]
        return replace(self, motion=motion, torque=self.torque[inside], used=self.used[inside], command=command)

    def linearised(self, motion: Motion) -> tuple[Array, Array]:
        """Return columns (n, p + q) and residuals (n,) N m of the model for another motion."""
        columns = linearised(self.model, motion, self.genes, self.nonlinear)
        left = self.model.target(motion, self.torque, self.nonlinear) - columns[:, : len(self.genes)] @ self.genes
        return columns, left

    def matters(self, change: Array) -> bool:
        """Return whether a change (p + q,) of the parameters is large enough, compared with their intervals, to be
        made.
        """
        at = list(self.decisive)
        return bool((np.abs(change[at]) > CORRECTED * self.half_width[at]).any())

    def shows(self, change: Change) -> bool:
        """Return whether a change of the parameters is large enough to be made, and larger than its own error (Hausman
        1978).
        """
        return self.matters(np.where(np.abs(change.values) > SURE / NORMAL * change.half_width, change.values, 0.0))


def linearised(model: SeparableModel, motion: Motion, genes: Array, nonlinear: Array) -> Array:
    """Return the derivatives (n, p + q) of the torque with respect to genes (p,) and nonlinear parameters (q,), for a
    motion (n,).
    """
    lag = lag_of(*genes[:2].tolist()) if model.needs_ratio else 0.0
    columns = model.columns(motion, nonlinear, lag)
    return np.concatenate([columns, model.jacobian(motion, nonlinear, genes, lag)], axis=1)


@dataclass(frozen=True, eq=False)
class Change:
    """A correction added to the parameters (p + q,), and the half width of its 95 % interval."""

    values: Array
    half_width: Array


def behind(window: Window, motion: Motion, readings: Array) -> tuple[Array, Array, Array]:
    """Return readings (n,) filtered by the window, with slope and curvature; zero in pieces that are too short for the
    window.
    """
    found = np.zeros((3, len(motion)))
    for part in motion.pieces:
        if window.low_pass is not None or part.stop - part.start > 2 * window.widest:
            found[:, part] = window.moved(motion.time[part], readings[part])
    value, slope, curvature = np.nan_to_num(found)
    return value, slope, curvature


def sampled(motion: Motion) -> Motion:
    """Return the motion at the samples at which the angle was read.

    If the torque cell is slow, `motion` has only the samples of the cell's readings, and the whole motion is returned.
    Its times are then made evenly spaced in each piece, because a window needs an even spacing; the errors hardly
    depend on it.
    """
    if motion.part_of is None:
        return motion
    whole = motion.whole[0]
    ends = [(whole.time[one.start], whole.time[one.stop - 1], one.stop - one.start) for one in whole.pieces]
    return replace(whole, time=np.concatenate([np.linspace(first, last, count) for first, last, count in ends]))


def moved(motion: Motion, more: tuple[Array, Array, Array]) -> Motion:
    """Return the motion with additional deflection, rate and acceleration.

    more: these three, each (n,), at all samples of the motion that `motion` is a part of. The motor's own torque
    changes with rate and acceleration.
    """
    (whole, rows), (value, slope, curvature) = motion.whole, more
    own = np.stack([whole.dtheta_dot, whole.dtheta_ddot], axis=1)
    share = np.linalg.lstsq(own, whole.known, rcond=None)[0] if whole.known.any() else np.zeros(2)
    found = replace(
        whole,
        dtheta=whole.dtheta + value,
        dtheta_dot=whole.dtheta_dot + slope,
        dtheta_ddot=whole.dtheta_ddot + curvature,
        known=whole.known + np.stack([slope, curvature], axis=1) @ share,
    )
    return found if motion.part_of is None else found.of(rows)


def solved(columns: Array, instruments: Array, left: Array) -> Array:
    """Return the change of the parameters (p + q,) that makes the residuals orthogonal to the instruments.

    columns, instruments (n, p + q). left (n,): the residuals, N m.
    """
    sizes = np.linalg.norm(columns, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    gram = (instruments / sizes).T @ (columns / sizes)
    found = np.linalg.lstsq(gram, (instruments / sizes).T @ clipped(left), rcond=1e-12)[0]
    return np.asarray(found / sizes)


def clipped(left: Array) -> Array:
    """Return residuals (n,), N m, clipped as in Huber's (1964) estimate and scaled so that a correction step has full
    length.

    left (n,): the residuals before clipping.
    """
    limit = CLIPPED * SPREAD * float(np.median(np.abs(left)))
    inside = float(np.mean(np.abs(left) < limit))
    return np.asarray(np.clip(left, -limit, limit) / max(0.5, inside))
