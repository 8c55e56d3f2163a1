"""Warn of effects that this recording cannot distinguish from Kc and Bc: inertia, friction, a filter or a delayed
reading.
"""

from __future__ import annotations

import numpy as np

from ga.arrays import Array
from ga.model.record import FRICTION
from ga.model.sticking import is_hidden, looks_like_spring
from ga.model.terms import TERMS, of_kind, of_role, size_of
from hil.diagnostics import Diagnostic, again
from hil.identification.candidates.criterion import predicts_better
from hil.identification.candidates.fits import LATE, Fits
from hil.identification.verdict.criteria import dampings_behind_filter
from hil.identification.verdict.evidence import Evidence
from hil.printable import quoted
from hil.signals import constants as c


def several_speeds(evidence: Evidence) -> str:
    """Return the remedy, as text, for an effect that cannot be seen at a single speed."""
    imported = evidence.signals.imported
    return again("Drive at several speeds over two octaves", "--profile chirp or multisine", imported=imported)


def confounded(evidence: Evidence) -> list[Diagnostic]:
    """Return the warnings and errors of effects that the recording cannot distinguish from Kc and Bc."""
    found = (_filtered_angle(evidence) or _inertia(evidence)) + _one_frequency(evidence) + _friction_at_rest(evidence)
    return found + _implausible_skew(evidence) + _little_load(evidence)


def _inertia(evidence: Evidence) -> list[Diagnostic]:
    """Return the warning that the joint's torque contains an inertia."""
    inertia = evidence.size_of("moment of inertia")
    if inertia is None or evidence.signals.torque_from == "motor":
        return []
    text = (
        f"the torque includes an inertia of {inertia:.2g} kg m^2, so it is likely the motor's torque and not the "
        "joint's. The model has a term for the inertia, so Kc is not affected. If it is the motor's, "
        f"{_as_motors(evidence)}"
    )
    return [Diagnostic("inertia-in-torque", text, "Kc")]


def _as_motors(evidence: Evidence) -> str:
    """Return the instruction, as text, for declaring that the torque is the motor's, for an imported table or for a
    stand.
    """
    if evidence.signals.imported or evidence.signals.torque_from == "given":
        return "import it with --motor-torque, and set motor_inertia in the stand file"
    return 'set torque_source = "motor" and motor_inertia in the stand file'


def _filtered_angle(evidence: Evidence) -> list[Diagnostic]:
    """Return the diagnostic for an inertia that may equally be a filter of the angle.

    [] if the torque is the motor's, because the inertia is then expected.
    """
    values = dict(zip(evidence.names, evidence.values.tolist(), strict=True))
    inertia = size_of(values, "moment of inertia")
    if not {"Kc", "Bc"} <= set(values) or evidence.signals.torque_from == "motor" or inertia <= 0.0:
        return []
    stiffness, damping = values["Kc"], values["Bc"]
    most = damping + float(evidence.errors.half_width[evidence.names.index("Bc")])
    if not 0.0 < 4.0 * stiffness * inertia <= most**2:
        return []
    both = dampings_behind_filter(stiffness, damping, inertia) or [0.5 * damping]
    either = " or ".join(f"{bc:.3g} N m s/rad (a filter of {bc / (2.0 * np.pi * inertia):.3g} Hz)" for bc in both)
    text = (
        f"the torque includes an inertia of {inertia:.2g} kg m^2, or the angle passed a filter that the torque did "
        f"not: both fit alike. Bc is {damping:.3g} N m s/rad with an inertia, and {either} behind a filter of the "
        "angle; Kc is the same. Record the angle without the drive's filter. If the torque is the motor's, "
        f"{_as_motors(evidence)}"
    )
    known = (
        f". If you know that there is an inertia, name --model {quoted(evidence.model.name)}"
        if evidence.selected
        else ""
    )
    return [Diagnostic("inertia-in-torque", text + known, "Bc", is_error=evidence.selected)]


def _one_frequency(evidence: Evidence) -> list[Diagnostic]:
    """Return the diagnostic for motion at one frequency, where more than one coupling gives the same torque.

    For a part that relaxes, or an inertia, there is a spring and damper that fit equally well, and the data cannot
    select one of them.
    """
    motion, selected = evidence.signals.motion, evidence.selected
    if not selected and (of_kind(evidence.names, "moment of inertia") or evidence.signals.torque_from != "given"):
        return []
    if not motion.has_one_frequency:
        return []
    text = (
        "the joint moved at one frequency. There, a part of the stiffness that relaxes looks like more stiffness and "
        "damping, and an inertia (if the torque is the motor's) like less stiffness. Kc and Bc are those at this "
        f"frequency. {several_speeds(evidence)}"
    )
    known = f". If you know that the joint has neither, name --model {quoted(evidence.model.name)}" if selected else ""
    return [Diagnostic("one-frequency", text + known, None if selected else "Kc", is_error=selected)]


def _friction_at_rest(evidence: Evidence) -> list[Diagnostic]:
    """Return the error of Kc and Bc if friction of a joint that comes to rest would become a part of Kc and Bc.

    If a first-order drive answers a step of the set-point, the torque of friction is a sum of the torques of deflection
    and rate, so nothing in the recording shows it. If a second-order drive does, friction is partly proportional to the
    acceleration too: it looks like more stiffness and damping, and like a torque that is read too early. In other
    motion friction looks nearly like the torque of a spring that curves.
    """
    motion, values = evidence.signals.motion, dict(zip(evidence.names, evidence.values.tolist(), strict=True))
    curves = set(of_role("curve")).intersection(evidence.model.name.split("+"))
    # in ticks of the recorder: a slow cell is late, and never early, by its own pace
    early = -size_of(values, "delay") / (c.TICK_SHARE * motion.whole[0].step)
    if not evidence.selected or _least_friction(evidence) > c.SMALL_PART * _loaded(evidence):
        return []
    has_inertia = bool(of_kind(values, "moment of inertia"))
    accelerates = has_inertia or early > c.LITTLE_EARLY
    if (curves or early > c.CLEARLY) and looks_like_spring(motion):
        other = "a spring that curves" if curves else "a torque that is read before the angle"
        fits = f"has the torque of more stiffness, and {other} fits as well"
    elif is_hidden(motion, inertia=accelerates):
        third = "inertia" if has_inertia else "an earlier reading"
        parts = f"stiffness, damping and {third}" if accelerates else "stiffness and damping"
        fits = f"has the torque of more {parts}, in this motion at every sample"
    else:
        return []
    smooth = again("Drive a multisine or a chirp", "--profile", imported=evidence.signals.imported)
    known = f". If you know that there is no friction, name --model {quoted(evidence.model.name)}"
    text = (
        "the joint rests at one place after each move up, and at another after each move down. Dry friction that holds "
        f"it there {fits}. Kc and Bc may be wrong. {smooth}{'' if of_kind(values, *FRICTION, 'load share') else known}"
    )
    return [Diagnostic("hidden-friction", text, is_error=True)]


def _little_load(evidence: Evidence) -> list[Diagnostic]:
    """Return the warning if most of the torque is friction, or if most of the motion is play."""
    values = dict(zip(evidence.names, evidence.values.tolist(), strict=True))
    torque, angle = _loaded(evidence), _middle_of(evidence.signals.motion.dtheta)
    friction = max((abs(values[name]) for name in of_kind(values, *FRICTION)), default=0.0)
    gap, causes, times = size_of(values, "gap width"), [], 1.0
    if friction > c.MAJORITY * torque:
        causes.append(f"friction takes {friction:.2g} N m of the {torque:.2g} N m of torque")
        times = friction / (c.LITTLE_FRICTION * torque)
    if 0.5 * gap > c.PLAY * angle:
        beyond = max(0.0, angle - 0.5 * gap)
        causes.append(f"the joint has {gap:.2g} rad of play and moves only {beyond:.2g} rad beyond it on each side")
    if not causes:
        return []
    text = (
        f"{', and '.join(causes)}. Kc then depends on the model of that effect. Drive with "
        f"{f'at least {np.ceil(times):.0f}' if times > 2.0 else 'several'} times the torque"
    )
    return [Diagnostic("little-load", text, "Kc")]


def _least_friction(evidence: Evidence) -> float:
    """Return the lower end of the interval of the friction, N m; zero if the model has no friction term.

    For friction in proportion to the torque, the value at the largest torque is used.
    """
    least = dict(zip(evidence.names, (np.abs(evidence.values) - evidence.errors.half_width).tolist(), strict=True))
    sizes = [least[name] for name in of_kind(least, *FRICTION)]
    return max((*sizes, *(least[name] * _loaded(evidence) for name in of_kind(least, "load share"))), default=0.0)


def _loaded(evidence: Evidence) -> float:
    """Return half the range of the coupling's torque, N m."""
    return _middle_of(evidence.signals.coupling_torque)


def _middle_of(values: Array) -> float:
    """Return half the range of values (n,) without the outermost values, which may be outliers."""
    low, high = np.quantile(values, [c.OUTERMOST, 1.0 - c.OUTERMOST])
    return float(0.5 * (high - low))


def _implausible_skew(evidence: Evidence) -> list[Diagnostic]:
    """Return the warning if the skew is too long for one recorder, or is the effect of a filter."""
    window, skew = evidence.size_of("mean time"), evidence.size_of("delay")
    if window is not None:
        return [_filtered(evidence, window, skew or 0.0)]
    if skew is None:
        return []
    delay, lag = LATE
    ticks = abs(skew) / evidence.signals.motion.step
    if ticks <= c.LONGEST_SKEW:
        return []
    text = (
        f"the torque reading seems {1e3 * abs(skew):.3g} ms {'older' if skew > 0.0 else 'newer'} than the angle "
        f"reading, {ticks:.3g} ticks. One recorder reads both within one tick, so the cause may be a filter of the "
        "torque cell, a slow cell or an inertia. Bc is wrong then. "
        f"Try --model {quoted(evidence.model.name.replace(delay, lag))}, or compare the filters of the two sensors"
    )
    # the average over models includes the other causes; a named model does not
    return [Diagnostic("torque-reading", text, "Bc", is_error=not (evidence.selected or _is_distinct(evidence)))]


def _is_distinct(evidence: Evidence) -> bool:
    """Return whether the named model predicts held-out blocks clearly better than with another cause of its skew."""
    signals, terms = evidence.signals, tuple(evidence.model.name.split("+"))
    fits = Fits(signals.motion, signals.torque, signals.band[1], signals.window)
    others = [
        tuple(cause if TERMS[term].delays else term for term in terms)
        for cause in (*LATE, *of_role("mass"))
        if cause not in terms
    ]
    own = fits.candidate(terms, {})
    found = [fits.candidate_or_none(one, own.values) for one in others]
    return all(predicts_better(own, one) > c.CLEARLY for one in found if one is not None)


def _filtered(evidence: Evidence, window: float, late: float) -> Diagnostic:
    """Return the diagnostic for a torque that a filter averages over `window`, s: an error, unless the user named it.

    Another filter with the same delay fits nearly as well and gives another Bc (a Butterworth filter of 30 Hz: 8 %
    more).
    """
    step = evidence.signals.motion.whole[0].step
    known = f". If you know that it is a mean, name --model {quoted(evidence.model.name)}" if evidence.selected else ""
    return Diagnostic(
        "torque-reading",
        f"a filter acts on the torque: it is {1e3 * late:.3g} ms late and looks like a mean over {1e3 * window:.3g} ms "
        f"({window / step:.3g} ticks). Bc is wrong if the filter is not a mean. Switch the filter off, or pass the "
        f"angle through the same filter{known}",
        "Bc",
        is_error=evidence.selected,
    )
