"""Test whether a model describes the recording that it was fitted to, and compute the joint's stiffness without a
model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ga.arrays import Array, Mask
from ga.model.coupling import CouplingModel
from ga.model.separable import SeparableModel
from ga.model.terms import of_kind
from ga.model.trajectory import Motion
from hil.identification.deflection.fitted import linearised
from hil.identification.deflection.held import damping_at, of_jerk
from hil.identification.deflection.instruments import followed, is_instrument
from hil.identification.deflection.simulation import noisier
from hil.identification.misfit.dynamic_stiffness import DynamicStiffness, dynamic_stiffness
from hil.identification.misfit.effects import EFFECTS
from hil.identification.misfit.lack_of_fit import Residuals, lack_of_fit, predicted
from hil.identification.misfit.outcome import Lacking, LackOfFit
from hil.signals import constants as c
from hil.signals.deflection_noise import smallest_step
from hil.signals.prepare import Signals
from hil.signals.rate.windows import is_smooth


@dataclass(frozen=True, eq=False)
class Described:
    """A recording and the model fitted to it, SI.

    signals: all samples (n,). kept (n,): which samples the model describes; there are m. residuals (m,) N m and columns
    (m, p): at these samples. values and half_width (p,): the parameters, and half their intervals. averaged: whether
    the intervals include the small effects of every bench, which are then no misfit. ends_if_differing: the fitted
    row, of m, at which each recording ends, for pooled recordings that differ from each other; () if they do not
    differ. Such a difference has a diagnostic of its own: no effect that changes with time is suggested as its cause.
    """

    model: SeparableModel
    signals: Signals
    kept: Mask
    residuals: Array
    columns: Array
    values: Array
    half_width: Array
    averaged: bool = False
    ends_if_differing: tuple[int, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return tuple(parameter.name for parameter in (*self.model.linear, *self.model.nonlinear))

    def linearised(self, motion: Motion) -> Array:
        """Return the columns (n, p) of the model at all samples, computed with the given motion."""
        return linearised(self.model, motion, *np.split(self.values, [len(self.model.linear)]))

    def dynamic_stiffness(self, torque: Array) -> DynamicStiffness | None:
        """Return the dynamic stiffness of a torque (n,), N m, in the excited band; None for a short recording."""
        signals = self.signals
        return dynamic_stiffness(signals.motion.alone(slice(None)), torque, signals.band, signals.command)


def tested(described: Described) -> LackOfFit | None:
    """Test the fit for lack of fit; None if the recording is too short."""
    found = _tested(described)
    return replace(found, at_jumps=_lacking_at_jumps(described)) if found else None


def _tested(described: Described) -> LackOfFit | None:
    """Test the fit at the samples that it was made from."""
    signals, motion = described.signals, _without_errors(described.signals)
    if motion is signals.motion:
        return _tested_as_read(described)
    found = _tested_without_errors(described, motion)
    if found is None or not found.misfit or not (signals.window and signals.window.count):
        return found
    # roundings that repeat with the motion stand in the residuals, also beside a motion without errors
    as_read = _tested_as_read(described)
    return as_read if as_read is not None and not as_read.misfit else found


def _tested_without_errors(described: Described, motion: Motion) -> LackOfFit | None:
    """Test the fit with a motion (n,) computed from the command, which has no measurement errors."""
    columns = described.linearised(motion)
    fitted = _held_against(described, motion, columns)
    # where the acceleration jumps no low-pass gives the rate, which only a motion without noise shows
    smooth = is_smooth(motion, described.signals.window)
    fitted = replace(fitted, kept=smooth if fitted.kept is None else fitted.kept & smooth)
    found = lack_of_fit(fitted)
    if found is None or not found.misfit:
        return found
    # what errors of the deflection make: where the joint rests at only a few angles, rounding follows the motion
    p, read = len(described.model.linear), described.linearised(described.signals.motion)
    beside = np.column_stack([fitted.columns, (read - columns)[:, :p] @ described.values[:p]])
    without = lack_of_fit(replace(fitted, columns=beside))
    return found if without is None or without.misfit else without


def _tested_as_read(described: Described) -> LackOfFit | None:
    """Test the fit with the measured motion, and compare a misfit with the residuals that measurement errors would
    cause.
    """
    signals, motion = described.signals, described.signals.motion
    found = lack_of_fit(_held_against(described, motion, None))
    if found is None or not found.misfit or signals.window is None:
        return found
    before, added = described.linearised(motion), list[float]()
    for pair in noisier(motion, signals.window):
        added.append(float(np.mean([_added(described, before, one) for one in pair])))
        if len(added) == c.ENOUGH_PAIRS and found.is_far_beyond_noise(max(added)):
            return found
    return found.beside_noise(np.array(added), counted=signals.window.count > 0.0)


def tested_motion(described: Described) -> float:
    """Return the fraction of the motion that is tested: the power of the rate in the tested samples over that in all
    samples.

    Samples beside jumps of the acceleration are not tested. A joint that steps from rest to rest moves only in such
    samples.
    """
    power = np.where(described.kept, described.signals.motion.dtheta_dot, 0.0) ** 2
    return float(np.sum(power[described.signals.smooth])) / max(float(np.sum(power)), np.finfo(float).tiny)


def _lacking_at_jumps(described: Described) -> Lacking | None:
    """Return the largest effect that the model lacks beside jumps of the acceleration; None if no relevant effect is
    lacking.

    The fit and its test leave these samples out, because their rate is not known. But if set-points jump, an inertia
    shows hardly anywhere else, and friction that builds up may hide it. The dynamic stiffness of the unexplained torque
    needs no rate of single samples. It is not computed for a model with an inertia, whose torque jumps, nor for one
    with friction, which may hold the joint when it starts to move.
    """
    signals, model = described.signals, described.model
    if not isinstance(model, CouplingModel) or model.sticks or of_kind(described.names, "moment of inertia"):
        return None
    if signals.rate_known.all() and tested_motion(described) > c.MAJORITY:
        return None
    genes, nonlinear = np.split(described.values, [len(model.linear)])
    columns = described.linearised(signals.motion)[:, : len(genes)]
    left = model.target(signals.motion, signals.torque, nonlinear) - columns @ genes
    whole, lacking = (described.dynamic_stiffness(torque) for torque in (signals.coupling_torque, left))
    if whole is None or lacking is None or len(whole.frequency) != len(lacking.frequency):
        return None
    speed = 2.0 * np.pi * lacking.frequency
    part, all_of_it = (np.hypot(one.stiffness, speed * one.damping) for one in (lacking, whole))
    is_sure = (np.abs(lacking.stiffness) > c.SURE_BAND * lacking.stiffness_half_width) | (
        np.abs(lacking.damping) > c.SURE_BAND * lacking.damping_half_width
    )
    parts = np.where(is_sure, part / all_of_it, 0.0)
    most = int(np.argmax(parts))
    return Lacking(float(lacking.frequency[most]), float(parts[most])) if parts[most] > c.LACKING else None


def _added(described: Described, before: Array, noisy: Motion) -> float:
    """Return by how much additional measurement errors raise the power, (N m)^2, of the predictable part of the
    residuals.

    before (n, p): the columns without the additional errors. noisy: the motion (n,) with them. The errors are added to
    the regressors too, and some regressors consist of little else; both powers are computed with equal regressors.
    """
    p = len(described.model.linear)
    after = described.linearised(noisy)
    without = _held_against(described, noisy, after)
    more = np.where(described.kept, (after - before)[:, :p] @ described.values[:p], 0.0)
    larger, own = predicted(replace(without, residuals=without.residuals - more), without)
    return float(larger**2 - own**2)


def _held_against(described: Described, motion: Motion, of_motion: Array | None) -> Residuals:
    """Return the fit for the lack-of-fit test with another motion.

    of_motion (n, p): the columns of that motion; None: the columns of the motion that the model was fitted to.
    """
    names, count, torque = described.names, len(described.signals), described.signals.coupling_torque
    alone = motion.alone(slice(None))  # a slow cell's torque is known at its own readings only
    coupling = (names.index("Kc"), names.index("Bc")) if {"Kc", "Bc"} <= set(names) else None
    residuals, columns = np.zeros(count), np.zeros((count, len(names)))
    residuals[described.kept], columns[described.kept] = described.residuals, described.columns
    columns = columns if of_motion is None else of_motion
    values, half_width = (
        (0.0, 0.0) if coupling is None else (float(array[coupling[0]]), float(array[coupling[1]]))
        for array in (described.values, described.half_width)
    )
    skew = next((names.index(name) for name in of_kind(names, "delay")), None)
    if described.averaged:
        columns = np.concatenate([columns, *_small_bench_effects(described, alone, residuals, columns)], axis=1)
    if described.ends_if_differing and coupling is not None:
        columns = np.concatenate([columns, _of_each_recording(described, columns[:, list(coupling)])], axis=1)
    columns = np.concatenate([columns, *_of_rounding(described.signals, residuals)], axis=1)
    columns = np.concatenate([columns, *_of_jumps(described, motion, residuals, columns)], axis=1)
    kept = described.kept & described.signals.smooth  # the same samples, whatever errors are added
    included = frozenset(one.code for one in EFFECTS if one.is_in(names))
    return Residuals(alone, torque, residuals, columns, coupling, values, half_width, skew, kept, included)


def _without_errors(signals: Signals) -> Motion:
    """Return the motion for the test: computed from the command if the residuals contain the noise of the deflection.

    With the measured motion, the same noise would be in residuals and regressors, and the test would detect it.
    """
    window, command = signals.window, signals.command
    if window is None or not window.noisy or not is_instrument(command) or signals.motion.part_of is not None:
        return signals.motion  # a slow cell's readings are too far apart to follow a command
    sound = window.sound(signals.motion.time)
    motion = followed(signals.motion, window, command, sound)
    left = float(np.var((motion.dtheta - signals.motion.dtheta)[sound]))
    return motion if left < c.SMALL_PART * float(np.var(signals.motion.dtheta)) else signals.motion


def _small_bench_effects(described: Described, motion: Motion, residuals: Array, columns: Array) -> list[Array]:
    """Return the torque (n, 1), N m for a factor of one, of each small effect that every bench has and the fitted model
    lacks.

    residuals (n,): N m. columns (n, p): those of the fitted model.
    """
    torque = described.signals.coupling_torque
    bench_effects = (effect for effect in EFFECTS if any(term.bench for term in effect.terms))
    lacking = (effect for effect in bench_effects if not effect.is_in(described.names))
    torques = (column for effect in lacking for column in effect.signature(motion, torque, torque - residuals))
    return [column for column in torques if _is_small(described, residuals, columns, column)]


def _of_each_recording(described: Described, coupling: Array) -> Array:
    """Return the columns (n, k) that give each recording its own Kc and Bc.

    coupling (n, 2): the common columns of Kc and Bc. The recordings' deviations from the common Kc and Bc sum to zero.
    """
    count = len(described.ends_if_differing)
    at = np.searchsorted(described.ends_if_differing, np.cumsum(described.kept) - 1, side="right").clip(0, count - 1)
    weights = np.concatenate([np.eye(count - 1), -np.ones((1, count - 1))])[at]  # (n, count - 1)
    return np.concatenate([weights * column[:, None] for column in coupling.T], axis=1)


def _is_small(described: Described, residuals: Array, columns: Array, effect: Array) -> bool:
    """Return whether the fit of an effect (n, 1) to the residuals changes Kc and Bc by only a small part.

    Model averages contain only small effects: a skew that replaces the whole damping would really be an inertia.
    """
    rows = slice(None, None, max(1, len(residuals) // c.TESTED))
    both = np.concatenate([columns[rows], effect[rows] * described.kept[rows, None]], axis=1)
    changes = np.linalg.lstsq(both, residuals[rows], rcond=None)[0]
    left = dict(zip(described.names, (changes[:-1] + (1.0 - c.MAJORITY) * described.values).tolist(), strict=True))
    return all(left[name] > 0.0 for name in ("Kc", "Bc") if name in left)


def _of_jumps(described: Described, motion: Motion, residuals: Array, columns: Array) -> list[Array]:
    """Return the torque (n, 1), N m, caused by set-points that are held until the next reading; [] if the residuals
    exclude it.

    The jumps of the acceleration change the rate in proportion to rate, acceleration and jerk. Bc and a skew absorb the
    first two parts. The size of the third part follows from Bc and the time step, so it can hide no other effect.
    """
    damping = damping_at(motion.dtheta_dot, dict(zip(described.names, described.values.tolist(), strict=True)))
    jumps = -(damping * of_jerk(motion))[:, None]
    rows = slice(None, None, max(1, len(residuals) // c.TESTED))
    both = np.concatenate([columns, jumps * described.kept[:, None]], axis=1)[rows]
    size = float(np.linalg.lstsq(both, residuals[rows], rcond=None)[0][-1])
    return [jumps] if 0.0 < size < c.HELD_JUMPS else []


def _of_rounding(signals: Signals, residuals: Array) -> list[Array]:
    """Return the torque (n, 5), N m, that rounding of the torque to counts adds; [] if it is small beside the residuals
    (n,).

    Rounding adds a sawtooth of the model's torque; with noise, only the first harmonics of the sawtooth remain.
    """
    count = smallest_step(signals.as_read)
    if (c.ROUNDING * count) ** 2 < c.SMALL_PART * float(np.var(residuals)):
        return []
    levels = np.unique(signals.as_read)
    number = np.round((levels - levels[0]) / count)
    count, first = np.polyfit(number, levels, 1).tolist()
    if float(np.abs(first + count * number - levels).max()) > c.OFF_COUNTS * count:
        return []
    place = (signals.torque - residuals - first) / count
    waves = [wave(2.0 * np.pi * turns * place) for turns in (1.0, 2.0) for wave in (np.sin, np.cos)]
    found = count * np.stack([np.round(place) - place, *waves], axis=1)
    if signals.unfiltered is None or signals.window is None:
        return [found]
    return [signals.window.passing(signals.motion.time)(found.T).T]
