"""Identifiability: the warnings and errors of a result, and why a recording does not identify a parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ga.model.terms import PARAMETERS, of_kind, size_of
from ga.trials.outcome import Trials
from hil.diagnostics import Diagnostic, again
from hil.identification.fitting.unloaded import DEFLECTION, UNLOADED_PLACE
from hil.identification.result import VarianceComponents
from hil.identification.verdict.confounding import confounded, several_speeds
from hil.identification.verdict.criteria import distinguishable, narrow
from hil.identification.verdict.evidence import Evidence, sliding, span_of_stiffness
from hil.printable import quoted
from hil.recording.channels import TorqueScale
from hil.signals import constants as c
from hil.units import with_unit


def judge(evidence: Evidence) -> list[Diagnostic]:
    """Return the warnings and errors of the result."""
    found = _stopped_search(evidence.solution.trials)
    exact = dict(zip(evidence.names, (evidence.exact[0] + evidence.zeros).tolist(), strict=True))
    deflected, spans = float(np.std(evidence.signals.motion.dtheta)), evidence.span[2] if evidence.span else ""
    stiffnesses = other_stiffness(exact, deflected, model=evidence.model.name, spans=spans)
    stiffnesses += _unloaded(evidence)
    for at, name in enumerate(evidence.names):
        if not any(one.is_error and one.parameter == name for one in stiffnesses):  # that says why
            found += _of_parameter(evidence, at, name)
    found += confounded(evidence) + stiffnesses
    if evidence.holdout.nrmse > c.UNEXPLAINED:
        found.append(
            Diagnostic(
                "not-identifiable",
                f"model {evidence.model.name} misses {evidence.holdout.nrmse:.0%} of the torque in data that it was "
                "not fitted to. Torque and deflection hardly depend on each other, so Kc and Bc mean nothing. Check "
                "units and signs, and that both readings are of the same joint",
                is_error=True,
            )
        )
    # the exact optimum knows no bounds but zero: at one, the gap is the bound's and not the search's
    at_bounds = any(evidence.at_bound(at) for at in range(len(evidence.names)))
    gap = evidence.solution.gap
    if gap > c.OPTIMISER_GAP and not at_bounds and not evidence.solution.trials.interrupted:
        found.append(
            Diagnostic(
                "not-converged",
                f"the search ended {gap:.2%} above the exact optimum. Use more --generations",
                is_error=True,
            )
        )
    return found


def wide_intervals(evidence: Evidence, doubts: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Return warnings of wide intervals of Kc and Bc, except for parameters that one of the `doubts` already names.

    Differences between recordings have warnings of their own.
    """
    half, values = evidence.errors.half_width, evidence.values
    return [
        Diagnostic("wide-interval", _wide(evidence, at), name)
        for at, name in enumerate(evidence.names)
        if name in c.COUPLING
        and half[at] > c.UNCERTAIN * abs(values[at])
        and not any(one.parameter == name for one in doubts)
        and _differs(evidence, at) is None
    ]


def uncertain_scale(scale: TorqueScale) -> list[Diagnostic]:
    """Return a warning if the torque's scale alone makes the intervals of Kc and Bc wide."""
    half = c.NORMAL * scale.included
    text = (
        f"Kc and Bc are uncertain by {half:.0%} because the torque's scale is: {scale.source}, {scale.included:.0%} "
        "(standard uncertainty). Bc/Kc and differences between recordings of this stand are not affected. Use a torque "
        "cell at the joint (hil calibrate torque), or measure the drive's torque against a load cell and give "
        "torque_uncertainty in [stand]"
    )
    return [Diagnostic("wide-interval", text)] if half > c.UNCERTAIN else []


def other_stiffness(
    values: Mapping[str, float], deflected: float = 0.0, /, *, model: str = "", spans: str = ""
) -> list[Diagnostic]:
    """Return a diagnostic for each second stiffness of a model, such as the stiffness of a spring behind a gap.

    values: the model's parameters, SI, by name. deflected: r.m.s. deflection, rad. model: the model's name. spans: the
    quantity on which Kc depends ("amplitude", "direction" or "deflection") if the interval of Kc contains both
    stiffnesses.
    """
    found = []
    if (before := sliding(values, deflected)) is not None:
        kc, (more, reach) = values["Kc"], before
        text = (
            f"Kc depends on the amplitude: it is {kc:.3g} N m/rad in large motion, where the friction slides, and "
            f"{kc + more:.3g} N m/rad in motion of less than {reach:.2g} rad. "
        )
        remedy = f"The interval of Kc spans both. For the Kc of large motion, name --model {quoted(model)}"
        use = "The Kc here is that of large motion. For motion between, use K'(f) of --verbose"
        text += remedy if spans == "amplitude" else use
        found.append(Diagnostic("two-stiffnesses", text, "Kc", is_error=spans == "amplitude"))
    half, turns = size_of(values, "side stiffness"), of_kind(values, "side place")
    if turns and (spans == DEFLECTION or span_of_stiffness(values, sliding_only=True) is not None):
        soft, stiff = (values["Kc"] + side * abs(half) for side in (-1.0, 1.0))
        text = (
            f"Kc is {stiff:.3g} N m/rad on one side of {values[turns[0]]:.3g} rad and {soft:.3g} N m/rad on the other. "
            "The joint has two springs, or a gap or a slack tendon of which it reached only one end. "
        )
        remedy = (
            "The interval of Kc spans both. Move the joint beyond both ends of the gap, or name --model "
            "linear+offset+slack or linear+offset+deadband"
        )
        if spans == DEFLECTION:
            remedy = (
                "It is unloaded beside that place. The interval of Kc spans both. For the mean of both, name "
                f"--model {quoted(model)}"
            )
        text += remedy if spans in ("direction", DEFLECTION) else "The Kc here is their mean"
        found.append(Diagnostic("two-stiffnesses", text, "Kc", is_error=spans == "direction"))
    if "Kc" in values and (relaxing := _relaxing(values)):
        fast, name = values["Kc"] + size_of(values, "relaxing stiffness"), min(relaxing)[1]
        text = (
            f"Kc depends on the speed: it is {values['Kc']:.3g} N m/rad in slow motion, and {fast:.3g} N m/rad in "
            f"motion much faster than {1e3 * values[name]:.3g} ms ({name}). The Kc here is that of slow motion. For "
            "motion between, use K'(f) and B'(f) of --verbose"
        )
        found.append(Diagnostic("two-stiffnesses", text, "Kc"))
    return found


def _relaxing(values: Mapping[str, float]) -> list[tuple[float, str]]:
    """Return the relaxation time, s, of each branch of a model with these values, and the name of its parameter."""
    return [(values[name], name) for name in of_kind(values, "relaxation time")]


def _unloaded(evidence: Evidence) -> list[Diagnostic]:
    """Return the diagnostic for a spring that curves and whose unloaded deflection is unknown; an error if Kc is too
    uncertain.
    """
    if evidence.span is None or evidence.span[2] != UNLOADED_PLACE:
        return []
    least, most, _ = evidence.span
    text = (
        f"the spring curves: its stiffness is {least:.3g} to {most:.3g} N m/rad over the motion. Kc is the stiffness "
        "of the unloaded joint, but the place where the joint is unloaded is not known: the encoder's zero, the "
        "torque's zero and the middle of the spring are at three places. The interval of Kc spans the whole motion. "
        "Set the encoder's zero with the joint unloaded and record again. If the torque's zero was set with the joint "
        "unloaded, name the model without offset"
    )
    at = evidence.names.index("Kc")
    wide = not narrow(float(evidence.errors.half_width[at]), float(evidence.values[at]))
    return [Diagnostic("unloaded-place", text, "Kc", is_error=wide)]


def _stopped_search(trials: Trials) -> list[Diagnostic]:
    """Return the warning that Ctrl-C stopped the search before all trials had ended; [] otherwise."""
    if not trials.interrupted:
        return []
    text = (
        f"the search was stopped after {int(trials.finished.sum())} of {len(trials.finished)} trials. The best trial "
        "is the best so far; the mean and the deviation include the trials that had not ended"
    )
    return [Diagnostic("not-converged", text)]


def _of_parameter(evidence: Evidence, at: int, name: str) -> list[Diagnostic]:
    found, is_error = [], name in c.COUPLING
    end, negative = evidence.at_bound(at), evidence.contradicted(at)
    at_zero = end == "low" and evidence.parameters[at].positive and evidence.solution.low[at] <= 0.0  # physics'
    if end is not None and not at_zero:
        text = f"{name} is at the {end} end of its bounds, and its true value may lie beyond. Widen the bounds: "
        found.append(Diagnostic("at-bound", f"{text}--bounds {name}=LOW:HIGH", name, is_error=is_error))
    if negative is None and not evidence.identifiable(at):
        found.append(Diagnostic("not-identifiable", _why_not(evidence, at), name, is_error=is_error))
    elif negative is not None:
        text = (
            f"{name} would be {with_unit(f'{negative:.3g}', evidence.parameters[at].unit)}, but it cannot be negative. "
            f"{_IMPLAUSIBLE.get(name, 'Bc is wrong by the same torque. Leave the term out')}"
            f"{'' if evidence.selected or name == 'Kc' else ', or try --model auto'}"
        )
        found.append(Diagnostic("implausible", text, name if is_error else "Bc", is_error=True))
    elif name == "Bc" and evidence.friction_likeness > c.ONE_SPEED:
        text = (
            "the joint moved at one speed, where dry friction looks like damping. The model has no term for friction, "
            f"so Bc includes most of any friction. {several_speeds(evidence)}"
            f"{'' if evidence.selected else ', and try --model auto'}"
        )
        found.append(Diagnostic("hidden-friction", text, name))
    return found


_IMPLAUSIBLE = {
    "Kc": "A sign is wrong: check that a positive torque makes a positive deflection",
    "Bc": "Torque and angle are exchanged or not read together, or there is friction. Check this",
}


def _why_not(evidence: Evidence, at: int) -> str:
    name = evidence.names[at]
    if name in c.COUPLING and evidence.unmoved:
        return f"{name} is not identifiable: {evidence.unmoved}"
    if not evidence.solution.columns[:, at].any():
        return f"{name} is not identifiable: nothing in this recording excites it"
    if name == "Bc" and evidence.friction_likeness >= c.LIKE_FRICTION:
        return f"Bc cannot be distinguished from dry friction: the joint moved at one speed. {several_speeds(evidence)}"
    if distinguishable(float(evidence.errors.half_width[at]), float(evidence.errors.inflation[at])):
        if evidence.parameters[at].presence:
            return f"{name} may be zero: its 95 % interval includes zero. Name a --model without its term"
        return _wide(evidence, at)
    return _alike(evidence, at)


def _alike(evidence: Evidence, at: int) -> str:
    """Return, as text, the parameter that cannot be distinguished from parameter `at`, and the remedy."""
    name, columns, low, high = evidence.names[at], evidence.solution.columns, *evidence.signals.band
    relaxing = _relaxing(dict(zip(evidence.names, evidence.values.tolist(), strict=True)))
    constant, slowest = max(relaxing, default=(0.0, ""))
    if name in {"Kc", slowest.replace("tau", "K")} and constant > 1.0 / (2.0 * np.pi * low):
        seconds = f"Hold a load for at least {4.0 * constant:.2g} s"  # to 2 %
        hold = again(seconds, "--profile steps at a low --band", imported=evidence.signals.imported)
        return (
            f"{name} is not identifiable: a part of the stiffness relaxes in about {constant:.2g} s ({slowest}), but "
            f"the slowest motion was at {low:.2g} Hz. {hold}. In the band of this recording, use "
            "K'(f) of --verbose"
        )
    norms = np.linalg.norm(columns, axis=0)
    alike = np.abs(columns.T @ columns[:, at]) / np.where(norms > 0.0, norms, 1.0) / norms[at]
    alike[at] = 0.0
    other = evidence.names[int(np.argmax(alike))]
    pair = " from ".join(f"{one} ({PARAMETERS[one].meaning})" if one in PARAMETERS else one for one in (name, other))
    extra = [one for one in (name, other) if one not in c.COUPLING]
    wider = again(
        "Drive at several speeds over a wider band",
        "--profile chirp or multisine, --band",
        imported=evidence.signals.imported,
    )
    return f"the band of this recording, {low:.3g} to {high:.3g} Hz, does not distinguish {pair}. {wider}" + (
        f", or leave out the term of {extra[0]}" if extra else ""
    )


def _wide(evidence: Evidence, at: int) -> str:
    """Return, as text, why the interval of parameter `at` is wide or too wide, and the remedy."""
    name, unit = evidence.names[at], evidence.parameters[at].unit
    value, half = float(evidence.values[at]), float(evidence.errors.half_width[at])
    uncertain = f"{name} is uncertain by {half / abs(value):.0%}" if evidence.identifiable(at) else ""
    head = uncertain or f"{name} is not identifiable"
    if (scatter := _differs(evidence, at)) is not None:
        return (
            f"{name} is not identifiable: it differs between the recordings by "
            f"{with_unit(f'{scatter.between:.2g}', unit)} (standard deviation), and the error of one recording is only "
            f"{with_unit(f'{scatter.within:.2g}', unit)}. Find the recording that "
            "differs with hil compare, and pool only recordings of one joint in the same units"
        )
    own = float(evidence.exact[1][at])
    if evidence.selected and own < 0.5 * half and own < 0.5 * abs(float(evidence.exact[0][at])):
        return f"{uncertain or f'{name} depends on the model'}: {_by_the_choice(evidence, at)}"
    imported, corner = evidence.signals.imported, _corner(evidence) if name == "Bc" else ""
    more = again("Move the joint faster, or with a larger amplitude", "--band, --amplitude", imported=imported)
    if name == "Bc" and evidence.has_friction:
        head, more = uncertain or "Bc cannot be distinguished from friction", several_speeds(evidence)
    return f"{head}: it is {with_unit(f'{value:.3g} ± {half:.2g}', unit)} (95 %). {corner}{more}"


def _differs(evidence: Evidence, at: int) -> VarianceComponents | None:
    """Return the variance components of the parameter if it differs between recordings by more than its error; else
    None.
    """
    scatter = evidence.scattered[at]
    return scatter if scatter is not None and scatter.between > c.BETWEEN * scatter.within else None


def _by_the_choice(evidence: Evidence, at: int) -> str:
    """Return, as text, the value of the selected model alone if likely models disagree on the parameter, and the
    remedy.
    """
    name, unit = evidence.names[at], evidence.parameters[at].unit
    value, half = (float(of[at]) for of in evidence.exact)
    corner, imported = _corner(evidence) if name == "Bc" else "", evidence.signals.imported
    remedy = again("Move the joint faster", "--band", imported=imported)
    if name == "Kc":
        cause, known = "Effects that the recording neither shows nor excludes change Kc", "the joint has none of them"
        remedy = again("Use a larger amplitude and a wider band", "--amplitude, --band", imported=imported)
    elif of_kind(evidence.names, "delay", "lag time", "mean time"):
        cause = "A late torque reading looks like a viscoelastic coupling that relaxes fast"
        known = "the torque cell or its filter is that late"
    else:
        cause = (
            "In slow motion, a torque cell that lags looks like less damping, and damping that grows with the rate "
            "like more"
        )
        known = "nothing delays the torque and damping does not grow with the rate"
    return (
        f"model {evidence.model.name} gives "
        f"{with_unit(f'{value:.3g} ± {half:.2g}', unit)}, and other models that fit equally well give other "
        f"values. {cause}. {corner}{remedy}. If you know that {known}, name --model {quoted(evidence.model.name)}"
    )


def _corner(evidence: Evidence) -> str:
    """Return, as text, the corner frequency Kc/(2 pi Bc), above which damping dominates; "" if the joint moved at such
    frequencies.
    """
    if "Kc" not in evidence.names:
        return ""
    kc, bc, high = evidence.names.index("Kc"), evidence.names.index("Bc"), evidence.signals.band[1]
    stiffness, damping = evidence.values[kc], evidence.values[bc] + evidence.errors.half_width[bc]
    if not (stiffness > 0.0 and damping > 0.0):
        return ""
    corner = stiffness / (2.0 * np.pi * damping)
    if high >= corner:
        return ""
    return f"Damping shows near {corner:.3g} Hz and above, but the joint moved at up to {high:.3g} Hz only. "
