"""Whether the chosen model describes the recording, which effects it may lack, and the joint without any model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel, parse
from ga.model.separable import SeparableModel
from ga.model.trajectory import Motion
from hil.diagnostics import Diagnostic
from hil.identification.selection.held import damping_at, of_jerk
from hil.signals.deflection_noise import smallest_step
from hil.signals.prepare import Signals
from hil.signals.torque_reading import seen_in_torque
from hil.signals.windows import is_smooth
from hil.uncertainty.criteria import narrow
from hil.uncertainty.dynamic_stiffness import DynamicStiffness, dynamic_stiffness
from hil.uncertainty.effects import EFFECTS, Recorded
from hil.uncertainty.instruments import followed, is_instrument, linearised, noisier
from hil.uncertainty.lack_of_fit import Fitted, lack_of_fit, predicted
from hil.uncertainty.misfit import LackOfFit

Array = NDArray[np.float64]

_RESPECTS = 3  # that a message names
_OF_EVERY_BENCH = {"tau0": "offset", "drift": "drift", "skew": "skew", "Fc": "coulomb"}  # parameter and effect
_TERMS = {  # parameters of terms that leave nothing of these effects: a Maxwell branch may leave another
    **_OF_EVERY_BENCH,
    "lag": "sensor-lag",
    "J": "inertia",
    "mu": "capstan",
    "B2": "quadratic-damping",
    "K3": "cubic",
    "gap": "backlash",
    "Ka": "asymmetry",
    "Kp": "asymmetry",
    "Ks": "stiffness-drift",
}
_FOLLOWED = 0.02  # of the power of the deflection, which a motion that follows from the command may lack
_CHANGES = 0.03  # of K' over the band, from which it is said
_ROUNDED = 0.01  # of the residuals' power, which rounding to counts must be for the tests to see it
_MOST = 0.5  # of Kc and Bc, which a small effect leaves
_ROWS = 20_000  # samples, of which it is seen how much of an effect there is
_JUMPS = (0.0, 1.5)  # times its computed size, within which the torque of held set-points is one of these
_OFF_GRID = 0.2  # counts, by which a reading in counts is off their grid at most


@dataclass(frozen=True, eq=False)
class Described:
    """A recording and the model fitted to it, SI.

    signals: all samples (n,). kept (n,): those that the model describes. residuals (m,) N m and columns (m, p): of
    these m, the columns of its parameters. values and half_width (p,): of these and of their intervals.
    averaged: whether the intervals include the small effects that every bench has, so that these are no misfit.
    differing: where each recording ends, in rows of these m, of pooled ones that differ, which is said already: no
    effect that changes with time is to explain it. () where they do not differ.
    """

    model: SeparableModel
    signals: Signals
    kept: NDArray[np.bool_]
    residuals: Array
    columns: Array
    values: Array
    half_width: Array
    averaged: bool = False
    differing: tuple[int, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return tuple(parameter.name for parameter in (*self.model.linear, *self.model.nonlinear))

    def linearised(self, motion: Motion) -> Array:
        """Return the columns (n, p) of all samples with this motion."""
        return linearised(self.model, motion, *np.split(self.values, [len(self.model.linear)]))

    def recorded(self, motion: Motion) -> Recorded:
        """Return the samples with this motion (n,)."""
        return Recorded(motion.time, self.signals.coupling_torque, motion.dtheta, motion.dtheta_dot, motion.starts)


def tested(described: Described) -> LackOfFit | None:
    """Test the fit; None where the recording is too short."""
    signals, motion = described.signals, _without_errors(described.signals)
    columns = None if motion is signals.motion else described.linearised(motion)
    recorded, fitted = _held_against(described, motion, columns)
    if columns is not None:
        # where the acceleration jumps no low-pass gives the rate, which only a motion without noise shows
        smooth = is_smooth(motion)
        fitted = replace(fitted, kept=smooth if fitted.kept is None else fitted.kept & smooth)
    found = lack_of_fit(recorded, fitted)
    if found is None or not found.misfit:
        return found
    if columns is not None:
        beside = np.column_stack([fitted.columns, _of_errors(described, columns)])
        without = lack_of_fit(recorded, replace(fitted, columns=beside))
        return found if without is None or without.misfit else without
    if signals.window is None or motion.part_of is not None:
        return found
    before = described.linearised(motion)
    added = [np.mean([_added(described, before, one) for one in pair]) for pair in noisier(motion, signals.window)]
    return found.beside_noise(np.array(added))


def _of_errors(described: Described, followed: Array) -> Array:
    """The torque (n,), N m, that errors of the deflection add: of the motion that was read less that which follows.

    followed (n, p): the columns of the latter. Where the joint rests at a few angles the errors of counts go with the
    motion, and are no misfit.
    """
    p = len(described.model.linear)
    read = described.linearised(described.signals.motion)
    return np.asarray((read - followed)[:, :p] @ described.values[:p])


def _added(described: Described, before: Array, noisy: Motion) -> float:
    """What more errors of the motion (n,) add to the power that is predicted, (N m)^2, by standing in the residuals.

    before (n, p): the columns without them. They stand in the regressors too, of which some show little but errors:
    these are the same with and without.
    """
    p = len(described.model.linear)
    after = described.linearised(noisy)
    recorded, without = _held_against(described, noisy, after)
    more = np.where(described.kept, (after - before)[:, :p] @ described.values[:p], 0.0)
    larger, own = predicted(recorded, replace(without, residuals=without.residuals - more), without)
    return float(larger**2 - own**2)


def _held_against(described: Described, motion: Motion, of_motion: Array | None) -> tuple[Recorded, Fitted]:
    """The recording and the fit with the columns (n, p) of a motion with other errors; None: with its own."""
    names, count, recorded = described.names, len(described.signals), described.recorded(motion)
    coupling = (names.index("Kc"), names.index("Bc")) if {"Kc", "Bc"} <= set(names) else None
    residuals, columns = np.zeros(count), np.zeros((count, len(names)))
    residuals[described.kept], columns[described.kept] = described.residuals, described.columns
    columns = columns if of_motion is None else of_motion
    values, half_width = (
        (0.0, 0.0) if coupling is None else (float(array[coupling[0]]), float(array[coupling[1]]))
        for array in (described.values, described.half_width)
    )
    skew = names.index("skew") if "skew" in names else None
    if described.averaged:
        columns = np.concatenate([columns, *_of_every_bench(described, recorded, residuals, columns)], axis=1)
    if described.differing and coupling is not None:
        columns = np.concatenate([columns, _of_each_recording(described, columns[:, list(coupling)])], axis=1)
    columns = np.concatenate([columns, *_of_rounding(described.signals, residuals)], axis=1)
    columns = np.concatenate([columns, *_of_jumps(described, motion, residuals, columns)], axis=1)
    kept = described.kept & described.signals.smooth  # the same samples, whatever errors are added
    included = frozenset(code for name, code in _TERMS.items() if name in names)
    return recorded, Fitted(residuals, columns, coupling, values, half_width, skew, kept, included)


def _without_errors(signals: Signals) -> Motion:
    """The motion to test with: what follows from the command, where the deflection's noise stands in the residuals too.

    The tests would find that noise in both.
    """
    window, command = signals.window, signals.command
    if window is None or not window.noisy or not is_instrument(command):
        return signals.motion
    sound = window.sound(signals.motion.time)
    motion = followed(signals.motion, window, command, sound)
    left = float(np.var((motion.dtheta - signals.motion.dtheta)[sound]))
    return motion if left < _FOLLOWED * float(np.var(signals.motion.dtheta)) else signals.motion


def _of_every_bench(described: Described, recorded: Recorded, residuals: Array, columns: Array) -> list[Array]:
    """What the small effects add (n, 1) each that the model of columns (n, p) lacks and every bench has."""
    model, lacking = recorded.torque - residuals, set(_OF_EVERY_BENCH).difference(described.names)
    codes = {code for name, code in _OF_EVERY_BENCH.items() if name in lacking}
    found = [column for one in EFFECTS if one.code in codes for column in one.signature(recorded, model)]
    return [one for one in found if _is_small(described, residuals, columns, one)]


def _of_each_recording(described: Described, coupling: Array) -> Array:
    """The columns (n, k) with which each recording has a Kc and a Bc of its own; coupling (n, 2): those of both.

    Their means over the recordings stay those of the model.
    """
    count = len(described.differing)
    at = np.searchsorted(described.differing, np.cumsum(described.kept) - 1, side="right").clip(0, count - 1)
    weights = np.concatenate([np.eye(count - 1), -np.ones((1, count - 1))])[at]  # (n, count - 1)
    return np.concatenate([weights * column[:, None] for column in coupling.T], axis=1)


def _is_small(described: Described, residuals: Array, columns: Array, effect: Array) -> bool:
    """Whether the residuals ask for so little of an effect (n, 1) that it leaves the most of Kc and Bc.

    Averages over models contain no other one: a skew that takes the damping would stand for an inertia.
    """
    rows = slice(None, None, max(1, len(residuals) // _ROWS))
    both = np.concatenate([columns[rows], effect[rows] * described.kept[rows, None]], axis=1)
    changes = np.linalg.lstsq(both, residuals[rows], rcond=None)[0]
    left = dict(zip(described.names, (changes[:-1] + (1.0 - _MOST) * described.values).tolist(), strict=True))
    return all(left[name] > 0.0 for name in ("Kc", "Bc") if name in left)


def _of_jumps(described: Described, motion: Motion, residuals: Array, columns: Array) -> list[Array]:
    """What set-points that are held until the next reading add (n, 1), N m; none where the residuals ask for another.

    The jumps of the acceleration take a part off the rate that goes with rate, acceleration and jerk. Bc and a skew
    take the first two. The size of the third follows from Bc and the step, so no other effect may hide behind it.
    """
    damping = damping_at(motion.dtheta_dot, dict(zip(described.names, described.values.tolist(), strict=True)))
    jumps = -(damping * of_jerk(motion))[:, None]
    rows = slice(None, None, max(1, len(residuals) // _ROWS))
    both = np.concatenate([columns, jumps * described.kept[:, None]], axis=1)[rows]
    size = float(np.linalg.lstsq(both, residuals[rows], rcond=None)[0][-1])
    return [jumps] if _JUMPS[0] < size < _JUMPS[1] else []


def _of_rounding(signals: Signals, residuals: Array) -> list[Array]:
    """What rounding the torque to counts adds (n, 5), N m, none where it is small beside residuals (n,).

    It is a sawtooth of the model, of which noise leaves the first waves only.
    """
    count = smallest_step(signals.as_read)
    if count**2 / 12.0 < _ROUNDED * float(np.var(residuals)):
        return []
    levels = np.unique(signals.as_read)
    number = np.round((levels - levels[0]) / count)
    count, first = np.polyfit(number, levels, 1).tolist()
    if float(np.abs(first + count * number - levels).max()) > _OFF_GRID * count:
        return []
    place = (signals.torque - residuals - first) / count
    waves = [wave(2.0 * np.pi * turns * place) for turns in (1.0, 2.0) for wave in (np.sin, np.cos)]
    found = count * np.stack([np.round(place) - place, *waves], axis=1)
    if signals.unfiltered is None or signals.window is None:
        return [found]
    return [np.stack([signals.window.alike(signals.motion.time, one) for one in found.T], axis=1)]


def without_model(described: Described) -> DynamicStiffness | None:
    """Return the dynamic stiffness in the excited band; None where the recording is too short."""
    signals = described.signals
    return dynamic_stiffness(described.recorded(signals.motion), signals.band, signals.command)


def ignored_command(described: Described, found: DynamicStiffness | None) -> list[Diagnostic]:
    """Return the warning that a command was recorded and not used, because the motion does not follow it."""
    if found is None or found.instrument == "command" or not is_instrument(described.signals.command):
        return []
    text = (
        "the motion does not follow the recorded command, so it is not used. Kc and Bc are less accurate where "
        "the deflection is noisy. Record the set-point that was driven, or name its column with --command"
    )
    return [Diagnostic("weak-command", text)]


def misfit_diagnostics(
    described: Described, model: str, found: LackOfFit | None, dynamic: DynamicStiffness | None
) -> list[Diagnostic]:
    """Return the warning or error about a model of that name that does not describe its recording; none where it does.

    Where the torque's readings show what was done to them, that comes first, and no term that looks like it.
    """
    if found is None or found.is_undecided:
        return [_untested(model, found)]
    if not found.misfit:
        return []
    signals = described.signals
    longest = float(parse("linear+skew").bounds(signals.motion, signals.band[1])[1][0])
    seen = seen_in_torque(signals, longest)
    parts = [
        _respects(model, found),
        _consequence(found, described.names),
        "" if seen else _remedy(described.model, found),
        _frequencies(dynamic),
    ]
    message = ". ".join(part for part in parts if part)
    is_grave = found.is_grave or not {"Kc", "Bc"} <= set(described.names)  # it has no other measure
    misfit = Diagnostic("misfit", message, found.affected, is_error=is_grave)
    return [Diagnostic("torque-reading", seen, found.affected, is_error=is_grave), misfit] if seen else [misfit]


def outweighed_spring(described: Described, found: LackOfFit | None) -> list[Diagnostic]:
    """Return the error of a Kc that rests on less torque than the model leaves unexplained; none where it does not.

    Friction, play and the other parameters can make most of what a spring that is hardly loaded does: Kc follows from
    the rest of its torque. An effect that the model lacks may look like that rest: it would change Kc by the ratio of
    the two. Noise is averaged away and does not: so a model that the tests do not reject is not doubted, and the noise
    of the reading is not counted. A Kc of zero, its bound, is refused already, with what is wrong.
    """
    if found is None or not (found.misfit or found.is_undecided) or "Kc" not in described.names:
        return []
    if not described.values[described.names.index("Kc")] > 0.0:
        return []
    carried, left = _carried(described), _beyond_noise(described)
    if narrow(left, carried):
        return []
    whole = float(np.std(described.signals.coupling_torque[described.kept]))
    return [
        Diagnostic(
            "spring-outweighed",
            f"of {whole:.2g} N m of torque (standard deviation), only {carried:.2g} N m follows from Kc alone, and not "
            f"from friction, play or the rest of the model. The model leaves {left:.2g} N m unexplained, beyond the "
            f"noise of the reading. An effect of that size can change Kc by {_percent(left / carried)}, whatever its "
            "interval says. Drive with several times the torque, so that the spring carries most of it",
            "Kc",
            is_error=True,
        )
    ]


def _carried(described: Described) -> float:
    """The size of the spring's torque, N m r.m.s., without what the columns of the other parameters can make."""
    at = described.names.index("Kc")
    columns = described.columns[:: max(1, len(described.columns) // _ROWS)]
    others, own = np.delete(columns, at, axis=1), columns[:, at]
    sizes = np.linalg.norm(others, axis=0)
    others = others[:, sizes > 0.0] / sizes[sizes > 0.0]
    left = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    return abs(float(described.values[at])) * float(np.sqrt(np.mean(left**2)))


def _beyond_noise(described: Described) -> float:
    """The size of the residuals without the noise of the reading, N m r.m.s.

    Noise is what differs between readings that follow each other; of it a low-pass lets its part of the band through.
    """
    signals, residuals = described.signals, np.zeros(len(described.signals))
    residuals[described.kept] = described.residuals
    differences = np.diff(signals.as_read - signals.torque + residuals)
    differences = differences[described.kept[1:] & described.kept[:-1]]
    low_pass = signals.window.low_pass if signals.window else None
    passed = 1.0 if low_pass is None or signals.unfiltered is None else min(1.0, 2.0 * low_pass.cut * low_pass.step)
    noise = 0.5 * passed * float(np.mean(differences**2)) if len(differences) else 0.0
    return float(np.sqrt(max(0.0, float(np.mean(described.residuals**2)) - noise)))


def _untested(model: str, found: LackOfFit | None) -> Diagnostic:
    """Return the warning that the recording is too short for the tests, or that they can decide nothing by it."""
    seen = f", but the motion predicts {100.0 * found.share:.0f} % of its residuals" if found else ""
    return Diagnostic(
        "misfit-untested",
        f"the recording is too short to test model {model}{seen}. Kc and Bc may include effects that the model leaves "
        "out. Record for longer",
    )


def _respects(model: str, found: LackOfFit) -> str:
    compared = [one for one in found.failed if one.Kc is not None]
    differing = [f"{one.name} (Kc by {_size(found, 0, one.Kc)}, Bc by {_size(found, 1, one.Bc)})" for one in compared]
    plain = [one.name for one in found.failed if one.Kc is None and one.code != "any"]
    respects = ([f"Kc and Bc differ {' and '.join(differing)}"] if differing else []) + plain
    said = "".join(f"{one}; " for one in respects[:_RESPECTS])
    return (
        f"model {model} does not describe this recording: {said}the motion predicts {100.0 * found.share:.0f} % of the "
        "residuals"
    )


def _consequence(found: LackOfFit, names: Sequence[str]) -> str:
    left = f"It leaves out {100.0 * found.unexplained:.2g} % of the torque"
    if not {"Kc", "Bc"} <= set(names):
        return f"{left}, so its parameters may be wrong"
    if found.explains_too_little:
        return f"{left}, so Kc and Bc mean nothing"
    return f"Kc may be wrong by {_size(found, 0, found.Kc)} and Bc by {_size(found, 1, found.Bc)}" + (
        "; their intervals include this" if found.outside else ""
    )


def _size(found: LackOfFit, of: int, size: float | None, *, sign: str = "") -> str:
    """A relative change of Kc (0) or Bc (1), in its unit where the value is zero; sign: "+", to print its sign."""
    absolute = found.change(of, size or 0.0)
    if math.isfinite(absolute):
        return f"{absolute if sign else abs(absolute):{sign}.2g} {('N m/rad', 'N m s/rad')[of]}"
    return f"{100.0 * (size or 0.0):{sign}.{1 - of}f} %" if sign else _percent(size)


def _percent(size: float | None) -> str:
    size = abs(size or 0.0)
    return "more than 100 %" if size > 1.0 else f"{100.0 * size:.2g} %"


def _remedy(model: SeparableModel, found: LackOfFit) -> str:
    """What the residuals look like, with the model or experiment to try."""
    if not found.suspects:
        return "No known effect explains the residuals. Look at them with --report, and at K'(f) with --verbose"
    has_coupling = {"Kc", "Bc"} <= {one.name for one in (*model.linear, *model.nonlinear)}
    terms = [model.name.split("+")] if isinstance(model, CouplingModel) else []
    looks = [
        f"{one.effect.name} (with it Kc {_size(found, 0, one.Kc, sign='+')}, Bc {_size(found, 1, one.Bc, sign='+')})"
        if has_coupling
        else one.effect.name
        for one in found.suspects
    ]
    return f"The residuals look like {' or '.join(looks)}: {found.suspects[0].effect.remedy(*terms)}"


def _frequencies(dynamic: DynamicStiffness | None) -> str:
    """How K' changes over the band, where it does."""
    if dynamic is None:
        return ""
    bands = dynamic.bands
    low, high = float(bands.stiffness[0]), float(bands.stiffness[-1])
    error = float(np.hypot(bands.stiffness_half_width[0], bands.stiffness_half_width[-1]))
    if len(bands.frequency) < 2 or abs(high - low) < max(error, _CHANGES * abs(low)):
        return ""
    first, last = float(bands.frequency[0]), float(bands.frequency[-1])
    return f"Without a model, Kc is {low:.3g} N m/rad at {first:.3g} Hz and {high:.3g} N m/rad at {last:.3g} Hz"
