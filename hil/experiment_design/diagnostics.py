"""What is to be said of a profile before it is driven, and the command that drives it."""

from __future__ import annotations

import math
import shlex
from typing import Any

from drivers.servo import Quantity
from hil.acquisition.excitation import Profile
from hil.diagnostics import Diagnostic
from hil.experiment_design.assessment import LIMITED, UNITS, Assessment, Task
from hil.experiment_design.fisher import Parameter

SCHEMA = "hil-design/1"

_CONFUSED = 30.0  # variance inflation from which two parameters look alike, as in `hil identify`
_ONE_SPEED = ("sine", "ramp")  # a triangle has one speed, and a sine too little else
_FEW_SPEEDS = 4.0  # the ratio of a band's ends below which friction and damping look alike


def task_diagnostics(task: Task, *, noise_stated: bool) -> list[Diagnostic]:
    """What holds whatever the profile."""
    found = []
    if not noise_stated:
        found.append(
            Diagnostic(
                "noise-assumed",
                f"the stand file says nothing of its sensors: torque noise {task.readings.white:.3g} N m and a count "
                f"of {task.readings.angle_lsb:.2g} rad are assumed, and every error grows with the noise; measure it "
                "with hil inspect and give it as --torque-noise",
            )
        )
    if task.joint.inertia == 0.0 and task.quantity is Quantity.TORQUE:
        found.append(
            Diagnostic(
                "no-inertia",
                "the stand file gives no motor_inertia: the resonance is not seen, and at it the deflection can be "
                "many times what is predicted; add it to [stand]",
            )
        )
    if task.readings.motor_side and task.quantity is Quantity.POSITION:
        found.append(
            Diagnostic(
                "motor-side",
                "between ticks the motor's torque follows the drive's own position loop, which is not predicted: Bc "
                "can be far from what is said here; use a torque cell, or --quantity torque",
                "Bc",
            )
        )
    elif task.readings.motor_side:
        found.append(
            Diagnostic(
                "motor-side",
                "the motor's torque is held from tick to tick and read before it changes, which is half a tick "
                f"({500.0 / task.rate:.2g} ms) of skew: the bias of Bc is rough and it scatters more than is said here",
                "Bc",
            )
        )
    return found


def diagnostics(task: Task, judged: Assessment) -> list[Diagnostic]:
    """What is to be said of one profile, each beginning with its name."""
    return [
        *_near_limits(judged),
        *_corner(task, judged),
        *_speeds(task, judged),
        *_biased(task, judged),
        *_not_told(judged),
    ]


def _near_limits(judged: Assessment) -> list[Diagnostic]:
    if max(judged.strained) <= 1.0 + 1e-9:
        return []
    return [
        Diagnostic(
            "near-limit",
            f"{named(judged.profile)}: keeps the limits for this Kc and Bc, and passes that on {judged.limited_by} by "
            f"{max(judged.strained) - 1.0:.0%} where Kc is a quarter more or a fifth less, or Bc half more or a third "
            "less",
        )
    ]


def _corner(task: Task, judged: Assessment) -> list[Diagnostic]:
    low, high = judged.profile.band
    corner = task.joint.corner
    if judged.profile.kind == "file" or low <= corner <= high or (judged.profile.kind == "prbs" and corner <= high):
        return []
    where = "above" if corner > high else "below"
    weak, remedy = ("Bc", "widen --band upwards") if corner > high else ("Kc", "widen --band downwards")
    return [
        Diagnostic(
            "corner-outside-band",
            f"{named(judged.profile)}: the corner Kc/(2 pi Bc) of {corner:.3g} Hz lies {where} the band, where {weak} "
            f"carries the smaller part of the torque and is told less well; {remedy}, or record for longer",
            weak,
        )
    ]


def _speeds(task: Task, judged: Assessment) -> list[Diagnostic]:
    profile, found = judged.profile, []
    swept = profile.kind in {"chirp", "multisine", "sine"}
    if profile.kind in _ONE_SPEED or (swept and profile.band[1] < _FEW_SPEEDS * profile.band[0]):
        found.append(
            Diagnostic(
                "one-speed",
                f"{named(profile)}: dry friction and damping look alike at one speed, whatever the model says of "
                "them; drive at several (--profile chirp or multisine over two octaves)",
                "Bc",
            )
        )
    if judged.friction:
        amount = 0.01 * judged.peaks.torque
        found.append(
            Diagnostic(
                "friction-in-damping",
                f"{named(profile)}: without +coulomb, dry friction of 1 % of the torque ({amount:.2g} N m) passes for "
                f"{amount * judged.friction / task.joint.damping:+.1%} of Bc",
                "Bc",
            )
        )
    return found


def _biased(task: Task, judged: Assessment) -> list[Diagnostic]:
    remedy = "" if "skew" in task.terms else ", but a term for it may (+skew)"
    return [
        Diagnostic(
            "biased",
            f"{named(judged.profile)}: {name} comes out {judged[name].bias / judged[name].rough:+.2%} wrong, "
            f"{abs(judged[name].bias) / judged[name].error:.0f} of its standard errors, through the skew of the "
            f"readings and the window of the rate; more time does not help{remedy}",
            name,
        )
        for name in ("Kc", "Bc")
        if 2.0 * judged[name].error < abs(judged[name].bias) < math.inf
    ]


def _not_told(judged: Assessment) -> list[Diagnostic]:
    found = []
    for parameter in judged.parameters:
        name = parameter.name
        if math.isinf(parameter.error) or parameter.inflation > _CONFUSED:
            what = "cannot be told" if math.isinf(parameter.error) else "is hardly told"
            reason = "nothing moves it, or another parameter looks the same; leave a term out or widen --band"
        elif name in {"Kc", "Bc"} and 1.96 * parameter.error > 0.5 * parameter.rough:
            what, reason = (
                "cannot be told",
                "its 95 % interval is as wide as its value; raise --amplitude or --duration",
            )
        else:
            continue
        found.append(Diagnostic("not-told", f"{named(judged.profile)}: {name} {what}: {reason}", name))
    return found


def named(profile: Profile) -> str:
    """The profile in a few words."""
    if profile.kind == "file":
        return profile.setpoints
    low, high = profile.band
    return f"{profile.kind} {low:g} Hz" if low == high else f"{profile.kind} {low:g} to {high:g} Hz"


def command(judged: Assessment, stand: str, rate: float) -> str:
    """The words that record the profile. stand: what names it, such as "--backend sim"."""
    profile = judged.profile
    words = f"hil record {stand} --profile {profile.kind}"
    if profile.kind == "file":
        words += f" --setpoints {shlex.quote(profile.setpoints)}"
    else:
        low, high = profile.band
        words += f" --band {low:.12g}" if low == high else f" --band {low:.12g}:{high:.12g}"
    words += f" --amplitude {profile.amplitude:.12g} --duration {profile.duration:.12g} --rate {rate:.12g}"
    return words + (" --quantity position" if profile.quantity is Quantity.POSITION else "")


def as_json(task: Task, judged: dict[str, Assessment], general: list[Diagnostic], stand: str) -> dict[str, Any]:
    """The JSON object of `hil design --json`, SI; an error that is infinite is null. judged: by "given" and "best"."""
    return {
        "schema": SCHEMA,
        "model": "+".join(task.terms),
        "rough": {"Kc": task.joint.stiffness, "Bc": task.joint.damping},
        "corner": task.joint.corner,
        "resonance": _number(task.joint.resonance),
        "torque_noise": task.readings.white,
        "angle_lsb": task.readings.angle_lsb,
        "skew": task.readings.skew,
        "profiles": {name: _profile(task, one, stand) for name, one in judged.items()},
        "warnings": [diagnostic.as_json() for diagnostic in general],
    }


def _profile(task: Task, judged: Assessment, stand: str) -> dict[str, Any]:
    limits = zip(LIMITED, UNITS, judged.peaks.in_order, task.limits, judged.shares, judged.strained, strict=True)
    return {
        "profile": judged.profile.attributes() | {"rate": task.rate},
        "command": command(judged, stand, task.rate),
        "parameters": {parameter.name: _parameter(parameter) for parameter in judged.parameters},
        "limits": {
            name: {
                "peak": peak,
                "limit": limit,
                "unit": unit.replace(" ", "*"),
                "share": share,
                "share_at_worst": worst,
            }
            for name, unit, peak, limit, share, worst in limits
        },
        "limited_by": judged.limited_by,
        "warnings": [diagnostic.as_json() for diagnostic in diagnostics(task, judged)],
    }


def _parameter(parameter: Parameter) -> dict[str, Any]:
    return {
        "rough": parameter.rough,
        "unit": parameter.unit,
        "standard_error": _number(parameter.error),
        "cramer_rao": _number(parameter.bound),
        "bias": _number(parameter.bias),
        "relative": _number(parameter.error / parameter.rough) if parameter.rough else None,
        "inflation": _number(parameter.inflation),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
