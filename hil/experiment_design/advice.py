"""Advice on an excitation before the motor moves: warnings with remedies, and the command that records the
excitation.
"""

from __future__ import annotations

import math

from drivers.servo import Quantity
from ga.model.terms import TERMS
from hil.acquisition.excitation import Profile
from hil.diagnostics import Diagnostic
from hil.experiment_design.assessment import Assessment, Task
from hil.identification.verdict.criteria import distinguishable, narrow
from hil.printable import quoted
from hil.signals import constants as c

_NORMAL = 1.96


def of_task(task: Task, *, noise_stated: bool) -> list[Diagnostic]:
    """Return the warnings that apply to every excitation. noise_stated: whether the user gave the torque noise."""
    found = []
    if not noise_stated:
        found.append(
            Diagnostic(
                "noise-assumed",
                f"the stand file does not describe its sensors. A torque noise of {task.readings.white:.3g} N m and a "
                f"count of {task.readings.angle_lsb:.2g} rad are assumed; all errors are proportional to the noise. "
                "Measure it with hil inspect and give it as --torque-noise",
            )
        )
    if task.joint.inertia == 0.0 and task.mode is Quantity.TORQUE:
        found.append(
            Diagnostic(
                "no-inertia",
                "the stand file gives no motor_inertia, so the resonance is not predicted. The deflection can be many "
                "times the predicted one there. Add motor_inertia to [stand]",
            )
        )
    if task.readings.motor_side:
        found.append(_motor_side(task))
    return found


def _motor_side(task: Task) -> Diagnostic:
    if task.mode is Quantity.POSITION:
        message = (
            "between ticks the drive's own position loop changes the motor's torque, which is not predicted. Bc can be "
            "far from this prediction. Use a torque cell, or --mode torque"
        )
    else:
        message = (
            "the motor's torque is constant from tick to tick and read before it changes, which is a skew of half a "
            f"tick ({500.0 / task.rate:.2g} ms). The predicted bias of Bc is rough, and its error is larger than "
            "predicted. Use a torque cell, or a higher --rate"
        )
    return Diagnostic("motor-side", message, "Bc")


def of_profile(task: Task, judged: Assessment) -> list[Diagnostic]:
    """Return the warnings about one excitation; each begins with a description of the excitation."""
    return [
        *_near_limits(judged),
        *_corner(task, judged),
        *_speeds(task, judged),
        *_biased(task, judged),
        *_not_identifiable(judged),
    ]


def _near_limits(judged: Assessment) -> list[Diagnostic]:
    worst = max(judged.worst_shares)
    if worst <= 1.0 + 1e-9:
        return []
    return [
        Diagnostic(
            "near-limit",
            f"{described(judged.profile)}: keeps the limits for this Kc and Bc. If Kc is 25 % higher or 20 % lower, or "
            f"Bc 50 % higher or 33 % lower, it exceeds the limit of {judged.limited_by} by {worst - 1.0:.0%}. Lower "
            "--amplitude",
        )
    ]


def _corner(task: Task, judged: Assessment) -> list[Diagnostic]:
    low, high = judged.profile.band
    corner = task.joint.corner
    if judged.profile.setpoints or low <= corner <= high or (judged.profile.excitation.from_zero and corner <= high):
        return []
    where = "above" if corner > high else "below"
    weak, remedy = ("Bc", "Widen --band upwards") if corner > high else ("Kc", "Widen --band downwards")
    return [
        Diagnostic(
            "corner-outside-band",
            f"{described(judged.profile)}: the corner Kc/(2 pi Bc) of {corner:.3g} Hz is {where} the band. There "
            f"{weak} makes the smaller part of the torque and is estimated less well. {remedy}, or record for longer",
            weak,
        )
    ]


def _speeds(task: Task, judged: Assessment) -> list[Diagnostic]:
    profile, found = judged.profile, []
    if c.ONE_SPEED < judged.friction_likeness < c.LIKE_FRICTION:
        found.append(
            Diagnostic(
                "hidden-friction",
                f"{described(profile)}: the joint moves at one speed, where dry friction looks like damping. The model "
                "has no term for friction, so Bc includes most of any friction. Drive at several speeds (--profile "
                "chirp or multisine over two octaves)",
                "Bc",
            )
        )
    if judged.friction:
        amount = 0.01 * judged.peaks.torque
        found.append(
            Diagnostic(
                "friction-in-damping",
                f"{described(profile)}: without +coulomb, dry friction of 1 % of the torque ({amount:.2g} N m) changes "
                f"Bc by {amount * judged.friction / task.joint.damping:+.1%}. Add +coulomb to --model",
                "Bc",
            )
        )
    return found


def _biased(task: Task, judged: Assessment) -> list[Diagnostic]:
    delays = next(name for name, term in TERMS.items() if term.delays)
    remedy = "" if delays in task.terms else f". Add +{delays} to --model"
    return [
        Diagnostic(
            "biased",
            f"{described(judged.profile)}: {name} has a bias of {judged[name].bias / judged[name].rough:+.2%}, "
            f"{abs(judged[name].bias) / judged[name].error:.0f} of its standard errors, from the skew of the readings "
            f"and the window of the rate. A longer recording does not reduce it{remedy}",
            name,
        )
        for name in ("Kc", "Bc")
        if 2.0 * judged[name].error < abs(judged[name].bias) < math.inf
    ]


def _not_identifiable(judged: Assessment) -> list[Diagnostic]:
    found = []
    for parameter in judged.parameters:
        name = parameter.name
        if not distinguishable(parameter.error, parameter.inflation):
            reason = "it has no effect on the torque, or another parameter has the same; leave a term out of --model"
        elif name == "Bc" and judged.friction_likeness >= c.LIKE_FRICTION:
            reason = "at one speed it cannot be distinguished from dry friction; drive at several speeds"
        elif name in c.COUPLING and not narrow(_NORMAL * parameter.error, parameter.rough):
            half = _NORMAL * parameter.error / parameter.rough
            reason = f"half its 95 % interval is {half:.0%} of its value; raise --amplitude or --duration"
        else:
            continue
        message = f"{described(judged.profile)}: {name} is not identifiable: {reason}, or widen --band"
        found.append(Diagnostic("not-identifiable", message, name))
    return found


def described(profile: Profile) -> str:
    """Return the excitation in a few words, such as "chirp 0.1 to 15 Hz"."""
    if profile.setpoints:
        return profile.setpoints
    low, high = profile.band
    return f"{profile.kind} {low:g} Hz" if low == high else f"{profile.kind} {low:g} to {high:g} Hz"


def command(judged: Assessment, stand: str, rate: float) -> str:
    """Return the command that records the excitation at `rate` Hz. stand: options that name the stand, such as
    "--backend sim".
    """
    profile = judged.profile
    words = f"hil record {stand} --profile {profile.kind}"
    if profile.setpoints:
        words += f" --setpoints {quoted(profile.setpoints)}"
    else:
        low, high = profile.band
        words += f" --band {low:.12g}" if low == high else f" --band {low:.12g}:{high:.12g}"
    words += f" --amplitude {profile.amplitude:.12g} --duration {profile.duration:.12g} --rate {rate:.12g}"
    return words + (" --mode position" if profile.mode is Quantity.POSITION else "")
