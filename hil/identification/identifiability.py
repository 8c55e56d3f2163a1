"""Identifiability: what is doubtful about a result, and why a recording does not identify a parameter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ga.trials.outcome import Trials
from hil.diagnostics import Diagnostic
from hil.identification.evidence import UNLOADED_PLACE, Evidence, sliding, span_of_stiffness
from hil.uncertainty.criteria import (
    BETWEEN,
    COUPLING,
    FRICTION,
    INFLATION,
    LIKE_FRICTION,
    LITTLE_FRICTION,
    LONGEST_SKEW,
    ONE_SPEED,
    OPTIMISER_GAP,
    PLAY,
    UNEXPLAINED,
    distinguishable,
    narrow,
)

Array = NDArray[np.float64]


def judge(evidence: Evidence) -> list[Diagnostic]:
    """Return the warnings and errors of the result."""
    found = _interruption(evidence.trials)
    exact = dict(zip(evidence.names, (evidence.exact[0] + evidence.zeros).tolist(), strict=True))
    stiffnesses = other_stiffness(exact, spans=evidence.span[2] if evidence.span else "")
    stiffnesses += _unloaded(evidence)
    for at, name in enumerate(evidence.names):
        if not any(one.is_error and one.parameter == name for one in stiffnesses):  # that says why
            found += _of_parameter(evidence, at, name)
    found += _inertia(evidence) + _implausible_skew(evidence) + _little_load(evidence) + stiffnesses
    if evidence.holdout.nrmse > UNEXPLAINED:
        found.append(
            Diagnostic(
                "unexplained",
                f"model {evidence.model.name!r} leaves {evidence.holdout.nrmse:.0%} of the torque's spread in blocks "
                "it was not fitted to: torque and deflection have little to do with each other; check units, signs and "
                "that both are of the same joint",
                is_error=True,
            )
        )
    # the exact optimum knows no bounds: at one, the gap is the bound's and not the search's
    at_bounds = any(evidence.at_bound(at) for at in range(len(evidence.names)))
    if evidence.gap > OPTIMISER_GAP and not at_bounds and not evidence.trials.interrupted:
        found.append(
            Diagnostic(
                "not-converged",
                f"the search ended {evidence.gap:.2g} above the exact optimum: give it more --generations",
                is_error=True,
            )
        )
    return found


def other_stiffness(values: Mapping[str, float], *, spans: str = "") -> list[Diagnostic]:
    """Return what is to know of each second stiffness beside Kc that a model with these values, SI, by name, has.

    spans: what Kc depends on where its interval spans both stiffnesses, because nobody asked for one of them.
    """
    found = []
    if (before := sliding(values)) is not None:
        kc, (more, reach) = values["Kc"], before
        text = (
            f"Kc depends on how far the joint moves: it is {kc:.3g} N m/rad once the friction slides, and "
            f"{kc + more:.3g} N m/rad for motion of less than {reach:.2g} rad"
        )
        model = "boucwen" if "Fy" in values else "dahl"
        remedy = f"its interval spans both; name --model linear+offset+{model} for the former"
        use = "use the latter for such motion, and K'(f) of --verbose for other motion"
        text += f": {remedy if spans == 'amplitude' else use}"
        found.append(Diagnostic("two-stiffnesses", text, "Kc", is_error=spans == "amplitude"))
    if "Ka" in values and (span := span_of_stiffness(values, sliding_only=True)) is not None:
        soft, stiff, _ = span
        text = (
            f"Kc is {stiff:.3g} N m/rad on one side of {values['turn']:.3g} rad and {soft:.3g} N m/rad on the other: a "
            "gap or a slack tendon of which the joint reached one end, or two springs"
        )
        remedy = "its interval spans both; name --model linear+offset+slack or +deadband, or move over both ends"
        text += f": {remedy if spans == 'direction' else 'the Kc here is their mean'}"
        found.append(Diagnostic("two-stiffnesses", text, "Kc", is_error=spans == "direction"))
    if {"Kc", "K1", "tau1"} <= set(values):
        fast = values["Kc"] + values["K1"] + values.get("K2", 0.0)
        text = (
            f"Kc is {values['Kc']:.3g} N m/rad once the coupling has relaxed, and {fast:.3g} N m/rad for motion much "
            f"faster than tau1, {1e3 * values['tau1']:.3g} ms: use K'(f) and B'(f) of --verbose for motion between"
        )
        found.append(Diagnostic("two-stiffnesses", text, "Kc"))
    return found


def _unloaded(evidence: Evidence) -> list[Diagnostic]:
    """Say that the place is unknown where a curving spring has its Kc; an error where Kc could be nearly anything."""
    if evidence.span is None or evidence.span[2] != UNLOADED_PLACE:
        return []
    least, most, _ = evidence.span
    text = (
        f"the spring curves, and its Kc is that of the unloaded joint: {least:.3g} to {most:.3g} N m/rad over the "
        "motion, because no two of the zeros of encoder and torque and the middle of the spring are at one place; set "
        "the encoder's zero with the joint unloaded and record again, or name the model without offset if the torque's "
        "zero was set so"
    )
    at = evidence.names.index("Kc")
    wide = not narrow(float(evidence.errors.half_width[at]), float(evidence.values[at]))
    return [Diagnostic("unloaded-place", text, "Kc", is_error=wide)]


def _inertia(evidence: Evidence) -> list[Diagnostic]:
    """A warning of an inertia in a torque that is said to be the joint's, or of one that one speed would hide."""
    motion = evidence.signals.motion
    if "J" in evidence.names and evidence.signals.torque_from != "motor":
        inertia = float(evidence.values[evidence.names.index("J")])
        text = (
            f"the torque holds an inertia of {inertia:.2g} kg m^2 and is the motor's rather than the joint's; the "
            "model includes it, which would lower Kc otherwise; import it with --motor-torque, and set motor_inertia"
        )
        return [Diagnostic("inertia-in-torque", text, "Kc")]
    if "J" in evidence.names or evidence.signals.torque_from != "given":
        return []
    coupling = np.stack([motion.dtheta, motion.dtheta_dot, np.ones(len(motion))], axis=1)
    left = motion.dtheta_ddot - coupling @ np.linalg.lstsq(coupling, motion.dtheta_ddot, rcond=None)[0]
    if float(np.var(left)) * INFLATION > float(np.var(motion.dtheta_ddot)):
        return []
    text = (
        "the joint moved at one frequency, at which a stiffness and an inertia are alike: if the torque is the "
        f"motor's, Kc is too low by its inertia times the frequency squared, in rad/s; {_SEVERAL_SPEEDS}"
    )
    return [Diagnostic("one-frequency", text, "Kc")]


def _little_load(evidence: Evidence) -> list[Diagnostic]:
    """A warning of a torque that friction takes most of, or of a joint that hardly leaves its play."""
    values = dict(zip(evidence.names, evidence.values.tolist(), strict=True))
    torque, angle = (_middle_of(one) for one in (evidence.signals.coupling_torque, evidence.signals.motion.dtheta))
    friction = max((abs(values[name]) for name in _FRICTION if name in values), default=0.0)
    gap, causes, times = values.get("gap", 0.0), [], 1.0
    if friction > FRICTION * torque:
        causes.append(f"friction takes {friction:.2g} of the {torque:.2g} N m of torque")
        times = friction / (LITTLE_FRICTION * torque)
    if 0.5 * gap > PLAY * angle:
        beyond = max(0.0, angle - 0.5 * gap)
        causes.append(f"the joint leaves its play of {gap:.2g} rad for only {beyond:.2g} rad on each side")
    if not causes:
        return []
    text = (
        f"{' and '.join(causes)}, so that Kc follows from how these are modelled: drive with {_many(times)} the torque"
    )
    return [Diagnostic("little-load", text, "Kc")]


def _many(times: float) -> str:
    return f"at least {np.ceil(times):.0f} times" if times > 2.0 else "several times"


def _middle_of(values: Array) -> float:
    """Half the range of values (n,), without the outermost."""
    low, high = np.quantile(values, [_OUTERMOST, 1.0 - _OUTERMOST])
    return float(0.5 * (high - low))


def _implausible_skew(evidence: Evidence) -> list[Diagnostic]:
    """A warning of a skew that is longer than the readings of one recorder are apart, or of a filter."""
    if "window" in evidence.names:
        return [_filtered(evidence)]
    if "skew" not in evidence.names:
        return []
    skew = float(evidence.values[evidence.names.index("skew")])
    ticks = abs(skew) / float(np.median(np.diff(evidence.signals.motion.time)))
    if ticks <= LONGEST_SKEW:
        return []
    return [
        Diagnostic(
            "skew-implausible",
            f"the skew of {1e3 * skew:.3g} ms is {ticks:.3g} ticks, and one recorder reads torque and angle less than "
            "one apart: a filter of the torque cell, an inertia or a slow cell may be taken for it, and Bc is wrong "
            "then; try --model linear+offset+lag, or compare the two sensors' filters",
            "Bc",
        )
    ]


def _filtered(evidence: Evidence) -> Diagnostic:
    """Return what is said of a torque that a filter averages: an error, unless the user names the mean.

    Another filter of the same delay fits nearly as well and has another Bc (a Butterworth of 30 Hz: 8 % more).
    """
    window, late = (
        float(evidence.values[evidence.names.index(name)]) if name in evidence.names else 0.0
        for name in ("window", "skew")
    )
    step = float(np.median(np.diff(evidence.signals.motion.whole[0].time)))
    known = f"; if you know that it is a mean: --model {evidence.model.name}" if evidence.selected else ""
    return Diagnostic(
        "filtered-torque",
        f"the torque is {1e3 * late:.3g} ms late and a mean over {1e3 * window:.3g} ms, {window / step:.3g} ticks: a "
        "filter stands before it, and if it is not a mean, Bc is wrong; switch it off, or pass the angle through the "
        f"same filter{known}",
        "Bc",
        is_error=evidence.selected,
    )


def _interruption(trials: Trials) -> list[Diagnostic]:
    if not trials.interrupted:
        return []
    return [
        Diagnostic(
            "interrupted",
            f"the search was cut short with {int(trials.finished.sum())} of {len(trials.finished)} trials at their "
            "end: the best is the best so far, mean and deviation are over all of them as they stood",
        )
    ]


def _of_parameter(evidence: Evidence, at: int, name: str) -> list[Diagnostic]:
    found, is_error = [], name in COUPLING
    end = evidence.at_bound(at)
    if end is not None:
        found.append(
            Diagnostic(
                "at-bound",
                f"{name} lies at or beyond the {end} end of its bounds, where the search cannot go; "
                f"widen them with --bounds {name}=LOW:HIGH",
                name,
                is_error=is_error,
            )
        )
    if not evidence.identifiable(at):
        found.append(Diagnostic("not-identifiable", _why_not(evidence, at), name, is_error=is_error))
    elif evidence.parameters[at].positive and evidence.values[at] < 0.0:
        found.append(
            Diagnostic(
                "implausible",
                f"{name} is {evidence.values[at]:.3g} {evidence.parameters[at].unit}, and it cannot be negative: "
                f"{_IMPLAUSIBLE.get(name, 'Bc takes up what it is wrong by; leave its term out, or try --model auto')}",
                name if is_error else "Bc",
                is_error=True,
            )
        )
    elif name == "Bc" and evidence.friction_likeness > ONE_SPEED:
        found.append(
            Diagnostic(
                "one-speed",
                f"Bc would hold most of any dry friction, which the model has no term for and which looks like damping "
                f"at one speed: {_SEVERAL_SPEEDS}, and try --model auto",
                name,
            )
        )
    return found


_OUTERMOST = 0.002  # of the samples, at either end of a range, which may be outliers
_FRICTION = ("Fc", "Fd", "Fy")  # N m, of which a model has one
_SEVERAL_SPEEDS = "drive at several speeds (--profile chirp or multisine over two octaves)"
_IMPLAUSIBLE = {
    "Kc": "a sign is wrong; check that a positive torque makes a positive deflection",
    "Bc": "the torque is read later or earlier than the angle, or friction is taken for it; try --model auto",
}


def _why_not(evidence: Evidence, at: int) -> str:
    name = evidence.names[at]
    if name in COUPLING and evidence.unmoved:
        return f"{name} is not identifiable: {evidence.unmoved}"
    if not evidence.columns[:, at].any():
        return f"{name} is not identifiable: nothing in this recording excites it"
    if name == "Bc" and evidence.friction_likeness >= LIKE_FRICTION:
        return f"Bc cannot be distinguished from dry friction at the one speed driven; {_SEVERAL_SPEEDS}"
    if distinguishable(float(evidence.errors.half_width[at]), float(evidence.errors.inflation[at])):
        if evidence.parameters[at].presence:
            return f"{name} cannot be distinguished from zero: its 95 % interval holds zero; leave its term out"
        return _too_wide(evidence, at)
    return _alike(evidence, at)


def _alike(evidence: Evidence, at: int) -> str:
    """Return which other parameter the recording confuses this one with, and what would separate them."""
    name, columns, low, high = evidence.names[at], evidence.columns, *evidence.signals.band
    constant = float(evidence.values[evidence.names.index("tau1")]) if "tau1" in evidence.names else 0.0
    if name in {"Kc", "K1"} and constant > 1.0 / (2.0 * np.pi * low):
        return (
            f"{name} cannot be distinguished from the rest of the stiffness: a part of the coupling relaxes in about "
            f"{constant:.2g} s (tau1), and the joint moved at {low:.2g} Hz and faster; hold a load for at least "
            f"{5.0 * constant:.2g} s (--profile steps at a low --band), and use K'(f) of --verbose for motion as here"
        )
    norms = np.linalg.norm(columns, axis=0)
    alike = np.abs(columns.T @ columns[:, at]) / np.where(norms > 0.0, norms, 1.0) / norms[at]
    alike[at] = 0.0
    other = evidence.names[int(np.argmax(alike))]
    return (
        f"{name} cannot be distinguished from {other} in this recording, {low:.3g} to {high:.3g} Hz; drive at several "
        "speeds (--profile chirp or multisine) and over a wider band"
    )


def _too_wide(evidence: Evidence, at: int) -> str:
    """Return why the parameter's interval is as wide as its value, and what would narrow it."""
    name, scatter = evidence.names[at], evidence.scattered[at]
    if scatter is not None and scatter.between > BETWEEN * scatter.within:
        return (
            f"{name} is not identifiable: the recordings differ by {scatter.between:.2g} (standard deviation), their "
            f"own errors are {scatter.within:.2g}; see which with hil compare, and pool only those of one joint in the "
            "same units"
        )
    if evidence.selected and evidence.exact[1][at] < 0.5 * abs(evidence.exact[0][at]):
        return _by_the_choice(evidence, at)
    wide = "its 95 % interval is as wide as its value"
    if name == "Bc" and evidence.has_friction:
        return f"Bc cannot be distinguished from Coulomb friction (Fc): {wide}; {_corner(evidence)}{_SEVERAL_SPEEDS}"
    corner = _corner(evidence) if name == "Bc" else ""
    return f"{name} is not identifiable: {wide}; {corner}excite it more (--band, --amplitude)"


def _by_the_choice(evidence: Evidence, at: int) -> str:
    """Return which value the selected model alone gives a parameter that other models give another value."""
    name, unit = evidence.names[at], evidence.parameters[at].unit
    value, half = (float(of[at]) for of in evidence.exact)
    if {"skew", "lag", "window"} & set(evidence.names):
        cause = "a torque that is read late looks like a viscoelastic coupling that relaxes fast"
        known = "if you know that the torque cell or its filter is that late"
    else:
        cause = "in slow motion a torque cell that lags looks like less damping; drive faster (--band)"
        known = "or, if you know that nothing delays the torque"
    return (
        f"{name} is {value:.3g} +- {half:.2g} {unit} by the model {evidence.model.name}, but others fit as well with "
        f"another {name}: {cause}; {known}, name the model: --model {evidence.model.name}"
    )


def _corner(evidence: Evidence) -> str:
    """Return how fast damping shows: near and above the corner Kc/(2 pi Bc). Empty where the joint moved as fast."""
    if "Kc" not in evidence.names:
        return ""
    kc, bc, high = evidence.names.index("Kc"), evidence.names.index("Bc"), evidence.signals.band[1]
    stiffness, damping = evidence.values[kc], evidence.values[bc] + evidence.errors.half_width[bc]
    if not (stiffness > 0.0 and damping > 0.0):
        return ""
    corner = stiffness / (2.0 * np.pi * damping)
    if high >= corner:
        return ""
    return f"the joint moved at up to {high:.3g} Hz, and damping shows only towards {corner:.3g} Hz: "
