"""Warn of a model that does not describe its recording: in which respects, by how much, and what to try."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ga.model.coupling import CouplingModel
from ga.model.separable import SeparableModel
from ga.model.terms import TERMS, of_kind, of_role
from hil.diagnostics import Diagnostic, again
from hil.identification.misfit.described import Described, tested_motion
from hil.identification.misfit.dynamic_stiffness import DynamicStiffness
from hil.identification.misfit.outcome import LackOfFit
from hil.identification.result import Estimate
from hil.printable import quoted
from hil.signals import constants as c
from hil.signals.prepare import Signals


def misfit_diagnostics(
    described: Described, model: str, found: LackOfFit | None, dynamic: DynamicStiffness | None, *, selected: bool
) -> list[Diagnostic]:
    """Return the warning or error that the model does not describe its recording; [] if it does.

    described: the recording and its fit. model: the model's name. found: the result of the lack-of-fit tests. dynamic:
    the dynamic stiffness. selected: whether the model was selected, and not named by the user. If the torque is later
    than a model can correct, the text reports that first, and not a term that looks like it.
    """
    if found is None or found.is_undecided or not found.misfit:
        missed = _untested_motion(described, model) if selected else []
        return missed or ([] if found and not found.is_undecided else [_untested(model, found)])
    signals = described.signals
    bounds = (one.bounds for one in TERMS.values() if one.delays and one.bounds)
    longest = max(high for own in bounds for _, high in own(signals.motion, signals.band[1]))
    seen = long_delay(signals, longest)
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


def lost_by_misfit(before: Sequence[Estimate], found: Sequence[Estimate]) -> list[Diagnostic]:
    """Return the error of each parameter that is identifiable in `before` and no longer in `found`.

    before: the estimates with the intervals of the model alone. found: the estimates with intervals widened by the
    misfit.
    """
    return [
        Diagnostic(
            "not-identifiable",
            f"{one.name} is not identifiable: it is uncertain by {percent(one.half_width / one.value)}, of which "
            "effects that the model leaves out, or errors of the deflection, make "
            f"{percent((one.half_width - old.half_width) / one.value)}. Record for longer, and with a larger amplitude",
            one.name,
            is_error=True,
        )
        for old, one in zip(before, found, strict=True)
        if old.identifiable and not one.identifiable
    ]


def _untested(model: str, found: LackOfFit | None) -> Diagnostic:
    """Return the warning that the recording is too short for the lack-of-fit tests, or too short for them to decide
    anything.
    """
    seen = f", but the motion predicts {100.0 * found.share:.0f} % of its residuals" if found else ""
    return Diagnostic(
        "misfit-untested",
        f"the recording is too short to test model {model}{seen}. Kc and Bc may include effects that the model leaves "
        "out. Record for longer",
    )


def _untested_motion(described: Described, model: str) -> list[Diagnostic]:
    """Return the error that hardly any of the motion is in the samples that the tests use; [] otherwise.

    Beside jumps of the acceleration the model is compared with the dynamic stiffness instead. That is impossible for a
    model with friction, which may hold the joint there, and for a model with an inertia, whose torque jumps. If the
    spring curves, Kc gets an error too, because any other effect would change the curve.
    """
    sticks = isinstance(described.model, CouplingModel) and described.model.sticks
    moving = tested_motion(described)
    if moving > c.TESTED_MOTION or not (sticks or of_kind(described.names, "moment of inertia")):
        return []
    smooth = again("Drive a multisine or a chirp", "--profile", imported=described.signals.imported)
    curves = bool(set(of_role("curve")).intersection(model.split("+")))
    wrong = "and each changes how a spring seems to curve. Kc and Bc" if curves else "and Bc"
    text = (
        f"only {percent(moving)} of the motion is in samples away from jumps of the acceleration, where the fit "
        "can be tested. Between two rests, friction, an inertia, a stiffness that relaxes and a late torque "
        f"reading look alike, {wrong} may be wrong. {smooth}. If you know that the model is right, name "
        f"--model {quoted(model)}"
    )
    return [Diagnostic("misfit-untested", text, None if curves else "Bc", is_error=True)]


def _respects(model: str, found: LackOfFit) -> str:
    compared = [one for one in found.failed if one.Kc is not None]
    differing = [f"{one.name} (Kc by {_size(found, 0, one.Kc)}, Bc by {_size(found, 1, one.Bc)})" for one in compared]
    plain = [one.name for one in found.failed if one.Kc is None and one.code != "any"]
    respects = ([f"Kc and Bc differ {' and '.join(differing)}"] if differing else []) + plain
    said = "".join(f"{one}; " for one in respects[: c.RESPECTS])
    share = f"the motion predicts {100.0 * found.share:.0f} % of the residuals"
    parts = [f"{said}{share}"] if found.failed or found.explains_too_little else []
    return f"model {model} does not describe this recording: {', and '.join([*parts, *_at_jumps(found)])}"


def _at_jumps(found: LackOfFit) -> list[str]:
    """Return, as text, the torque that the model lacks beside jumps of the acceleration; [] if nothing is lacking."""
    lacking = found.at_jumps
    if lacking is None:
        return []
    return [
        f"at {lacking.frequency:.2g} Hz the model lacks {percent(lacking.part)} of the dynamic stiffness, with the "
        "samples beside jumps of the acceleration, which it was not fitted to"
    ]


def _consequence(found: LackOfFit, names: Sequence[str]) -> str:
    left = f"It leaves out {100.0 * found.unexplained:.2g} % of the torque"
    if not {"Kc", "Bc"} <= set(names):
        return f"{left}, so its parameters may be wrong"
    if found.explains_too_little:
        return f"{left}, so Kc and Bc mean nothing"
    if found.at_jumps is not None:
        return "Kc and Bc may be wrong by more than their intervals"
    return f"Kc may be wrong by {_size(found, 0, found.Kc)} and Bc by {_size(found, 1, found.Bc)}" + (
        "; their intervals include this" if found.outside else ""
    )


def _size(found: LackOfFit, of: int, size: float | None, *, sign: str = "") -> str:
    """Return a relative change of Kc (of = 0) or Bc (of = 1) as text, in its unit if the value is zero. sign: "+"
    prints the sign.
    """
    absolute = found.change(of, size or 0.0)
    if math.isfinite(absolute):
        return f"{absolute if sign else abs(absolute):{sign}.2g} {('N m/rad', 'N m s/rad')[of]}"
    return f"{100.0 * (size or 0.0):{sign}.{1 - of}f} %" if sign else percent(size)


def percent(size: float | None) -> str:
    """Return a relative change as text in percent."""
    size = abs(size or 0.0)
    return "more than 100 %" if size > 1.0 else f"{100.0 * size:.2g} %"


def _remedy(model: SeparableModel, found: LackOfFit) -> str:
    """Return, as text, the effects that may explain the residuals, and the model or experiment to try."""
    if found.at_jumps is not None and not found.suspects:
        return (
            "An inertia, or friction from rest on, may show there only. Drive a multisine or a chirp, or read the "
            "sensors more often"
        )
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


def _frequencies(bands: DynamicStiffness | None) -> str:
    """Return how the storage stiffness K' changes over the excited band, as text, if it does."""
    if bands is None:
        return ""
    low, high = float(bands.stiffness[0]), float(bands.stiffness[-1])
    error = float(np.hypot(bands.stiffness_half_width[0], bands.stiffness_half_width[-1]))
    if len(bands.frequency) < 2 or abs(high - low) < max(error, c.LACKING * abs(low)):
        return ""
    first, last = float(bands.frequency[0]), float(bands.frequency[-1])
    return f"Without a model, Kc is {low:.3g} N m/rad at {first:.3g} Hz and {high:.3g} N m/rad at {last:.3g} Hz"


def long_delay(signals: Signals, longest: float) -> str:
    """Return, as text, the delay of the torque reading and the remedy, if the delay exceeds `longest`, s; else "".

    longest: the longest delay that the models of the coupling describe.
    """
    motion = signals.motion
    if signals.slower or motion.part_of is not None or len(motion.starts) > 1:
        return ""
    late = _delay(signals, motion.step)
    if late <= longest:
        return ""
    return (
        f"the torque reading is {1e3 * late:.3g} ms late, and a model corrects at most {1e3 * longest:.2g} ms. "
        "Subtract the delay from the time stamps of the torque, or find what delays its readings"
    )


def _delay(signals: Signals, step: float) -> float:
    """Return the delay of the torque, s, if spring and damper explain the torque much better with that delay; else
    0.
    """
    motion, torque = signals.motion, signals.torque
    columns = np.stack([motion.dtheta, motion.dtheta_dot, np.ones(len(motion))], axis=1)
    pace = max(step, 1.0 / (2.0 * c.DENSE_READINGS * signals.band[1]))
    most = min(int(c.LATEST / pace), len(torque) // (4 * max(1, round(pace / step))))
    tried = pace * np.arange(most + 1)
    inside = slice(int(c.LATEST / step) + 1, None)

    def left(delay: float) -> float:
        shift = round(delay / step)
        then = columns[inside.start - shift : len(columns) - shift]
        found = torque[inside]
        return float(np.sum((found - then @ np.linalg.lstsq(then, found, rcond=None)[0]) ** 2))

    if len(torque[inside]) < c.FEWEST * columns.shape[1]:
        return 0.0
    rest = np.array([left(delay) for delay in tried.tolist()])
    return float(tried[np.argmin(rest)]) if rest.min() < c.MAJORITY * rest[0] else 0.0
