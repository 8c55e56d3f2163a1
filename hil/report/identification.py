"""The result of `hil identify` as text: its answer in one line, its tables and its further lines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ga.model.coupling import CouplingModel
from hil.recording.interval import named
from hil.report.formatting import (
    Section,
    engineering,
    people_unit,
    rounded,
    rounded_in_thousands,
    rounded_with_value,
    scale_line,
)
from hil.report.lack_of_fit import dynamic_stiffness_section
from hil.signals import constants as c
from hil.units import with_unit

if TYPE_CHECKING:
    from ga.model.separable import SeparableModel
    from hil.identification.result import Deflection, Estimate, Identification

_METHODS = {"instruments": "the command as an instrument", "simulation": "a simulation of the noise"}


def milli(found: Identification) -> bool:
    """Return whether torques are printed in mN m, as for the joint of a hand, and not in N m, as for the joint of an
    arm.
    """
    return float(np.ptp(found.signals.torque)) < 1.0


def headline(found: Identification) -> str:
    """Return the answer in one line: Kc and Bc with half of their 95 % intervals, and whether each may be trusted."""
    lines = verdicts(found)
    return ",  ".join(lines) + ("  (95 %)" if all("±" in line for line in lines) else "")


def verdicts(found: Identification) -> list[str]:
    """Return a line for Kc and one for Bc: the value, half of its 95 % interval, and whether it may be trusted."""
    return [_verdict(found, estimate) for estimate in found.estimates[:2]]


def _verdict(found: Identification, estimate: Estimate) -> str:
    if found.sign_is_wrong:
        return f"{estimate.name} (not identifiable: a sign is wrong)"
    value, half, interval, unit = printed(found, estimate)
    codes = [code for code in found.doubts(estimate.name) if code != "two-stiffnesses" or not estimate.depends_on]
    doubts = f" (not to be trusted: {', '.join(dict.fromkeys(codes))})" if codes else ""
    if estimate.depends_on is not None:
        return f"{estimate.name} = {with_unit(interval, unit)} (depends on the {estimate.depends_on}){doubts}"
    if not estimate.identifiable or half is None:
        return f"{estimate.name} = {with_unit(value, unit)} (not identifiable)"
    return f"{estimate.name} = {with_unit(f'{value} ± {half}', unit)}{doubts}"


def printed(found: Identification, estimate: Estimate) -> tuple[str, str | None, str, str]:
    """Return value, half of the interval, interval and unit of a parameter as texts, rounded together.

    Half of the interval is None if it is not finite.
    """
    factor, unit = people_unit(estimate.unit, milli=milli(found))
    low, high = (end * factor for end in estimate.ci95)
    if not math.isfinite(low):
        return f"{estimate.value * factor:.5g}", None, "not identifiable", unit
    is_coupling = estimate.name in c.COUPLING
    of = rounded if is_coupling else rounded_in_thousands
    value, half = (rounded_with_value if is_coupling else of)(estimate.half_width * factor, estimate.value * factor)
    first, last, _ = of(0.05 * (high - low), low, high)
    return value, half, f"{first} to {last}", unit


def equation(model: SeparableModel) -> str:
    """Return a model as an equation, with the meaning of every symbol that is no parameter; "" for a model of
    the user.
    """
    if not isinstance(model, CouplingModel):
        return ""
    added, changes = [], []
    for term in model.terms:
        said = term.equation or f"(the torque of {term.name})"
        torque, _, more = said.partition(", ") if term.columns else ("", "", said)
        added += [torque] if torque else []
        changes += [more] if more else []
    signs = "tau: torque at the joint; x: deflection; v: its rate; t: time"
    return f"tau = {' + '.join(added)}" + "".join(f"; {one}" for one in changes) + f" ({signs})"


def meaning(model: SeparableModel) -> str:
    """Return a model in words; for a model of the user, its name."""
    return "; ".join(term.meaning for term in model.terms) if isinstance(model, CouplingModel) else model.name


def estimates_section(found: Identification) -> Section:
    """Return a table of all parameters with their values and 95 % intervals."""
    rows = [("", "value", "95 % interval", "")]
    for estimate in found.estimates:
        value, _, interval, unit = printed(found, estimate)
        if estimate.depends_on is not None:
            rows.append((f"{estimate.name} (depends on the {estimate.depends_on})", "", interval, unit))
            continue
        name = estimate.name if estimate.identifiable else f"{estimate.name} (not identifiable)"
        rows.append((name, value, interval, unit))
    return Section(f"{found.model.name}, {found.samples} samples", rows)


def repeatability_section(found: Identification) -> Section:
    """Return a table of how well the optimiser repeats: statistics over the trials as in the paper's Table 1, and the
    exact optimum. These are not uncertainties of the parameters.
    """
    rows = [("", "best trial", "mean ± std", "exact", "")]
    for estimate in found.estimates:
        factor, unit = people_unit(estimate.unit, milli=milli(found))
        trials = estimate.optimiser
        std = f" ± {trials.std * factor:.0e}" if math.isfinite(trials.std) else ""  # none for a single trial
        numbers = (f"{trials.best * factor:.5g}", f"{trials.mean * factor:.5g}{std}", f"{estimate.exact * factor:.5g}")
        rows.append((estimate.name, *numbers, unit))
    return Section(f"optimiser repeatability, {len(found.trials.fitness)} trials", rows)


def model_selection_section(found: Identification) -> Section:
    """Return a table of the model selection: for each term the improvement of the score, and Kc and Bc with this
    term.
    """
    torque, kc, bc = (people_unit(unit, milli=milli(found)) for unit in ("N*m", "N*m/rad", "N*m*s/rad"))
    headings = ("", f"error, {torque[1]}", "held-out", "gain", f"Kc, {kc[1]}", f"Bc, {bc[1]}", "")
    rows = [
        (
            step.term if step.term == "linear" else f"+ {step.term}",
            f"{step.fitness * torque[0]:.4g}",
            f"{step.held_out * torque[0]:.4g}",
            f"{step.gain:.3g}" if math.isfinite(step.gain) else "",
            f"{step.Kc * kc[0]:.5g}",
            f"{step.Bc * bc[0]:.4g}",
            "included" if step.included else "rejected",
        )
        for step in found.steps
    ]
    return Section("model selection", [headings, *rows])


def bands_section(found: Identification) -> Section | None:
    """Return a table of the dynamic stiffness in frequency bands; None if the recording is too short."""
    if found.dynamic_stiffness is None:
        return None
    factor, stiffness = people_unit("N*m/rad", milli=milli(found))
    damping = people_unit("N*m*s/rad", milli=milli(found))[1]
    bands = dynamic_stiffness_section(found.dynamic_stiffness, factor, stiffness, damping)
    if not found.torque_scale.included:
        return bands
    # it would hide the shape, for which these intervals are
    return replace(bands, heading=f"{bands.heading}, without the uncertainty of the torque's scale")


def identification_lines(found: Identification) -> list[str]:
    """Return the lines below the tables: fitness and optimiser gap, validation, fixture, excited band, amount of
    computation.
    """
    factor, unit = people_unit("N*m", milli=milli(found))
    return [
        *_window_lines(found),
        f"mean |torque error| {found.optimum * factor:.5g} {unit}; best trial {found.fitness * factor:.5g} {unit}; "
        f"optimiser gap {found.optimiser_gap:.1e}",
        f"validation on 20 % held-out data: mean |torque error| {found.validation.fitness * factor:.3g} {unit}; "
        f"r.m.s. error {found.validation.nrmse:.2%} of the torque",
        *optimum_lines(found),
        *_width_lines(found),
        *_component_lines(found),
        *deflection_lines(found.deflection),
        *_fixture_lines(found),
        *_scale_lines(found),
        *([] if found.steps else ["the intervals assume this model: --model auto selects its terms from the data"]),
        f"excited band {found.signals.band[0]:.2g} to {found.signals.band[1]:.3g} Hz; "
        f"{found.trials.evaluations} evaluations in {found.seconds:.2f} s",
    ]


def summary_lines(found: Identification) -> list[str]:
    """Return the lines below the answer: the model, the fit, corrections of Kc and Bc if there are any, amount of
    computation.

    If a sign is wrong, only the amount of computation is returned, because model and fit do not describe the joint.
    """
    work = (
        f"excited band {found.signals.band[0]:.2g} to {found.signals.band[1]:.3g} Hz; "
        f"{found.trials.evaluations} evaluations in {found.seconds:.2f} s; more with --verbose"
    )
    if found.sign_is_wrong:
        return [work]
    factor, unit = people_unit("N*m", milli=milli(found))
    others = [_verdict(found, estimate) for estimate in found.estimates[2:]]
    chosen = f", selected from {len(found.steps)} candidates" if found.steps else ""
    lost = f", {found.signals.defects.lost} lost replies left out" if found.signals.defects.lost else ""
    return [
        f"model {found.model.name}{chosen}" + (f": {',  '.join(others)}" if others else ""),
        *_window_lines(found),
        f"mean |torque error| {found.optimum * factor:.3g} {unit} over {found.samples} samples{lost}; "
        f"r.m.s. error {found.validation.nrmse:.2%} of the torque on held-out data; "
        f"optimiser gap {found.optimiser_gap:.1e}",
        *_component_lines(found),
        *(deflection_lines(found.deflection) if found.deflection and found.deflection.method != "none" else []),
        *_fixture_lines(found),
        *_scale_lines(found),
        work,
    ]


def truth_lines(found: Identification, truth: Mapping[str, float]) -> list[str]:
    """Return a line for Kc and one for Bc: the simulator's true value, and whether the 95 % interval contains it.

    truth: the true values, SI, by the names in a recording's /truth group.
    """
    return [_truth_line(found, estimate, truth[estimate.name]) for estimate in found.estimates[:2]]


def _truth_line(found: Identification, estimate: Estimate, true: float) -> str:
    factor, unit = people_unit(estimate.unit, milli=milli(found))
    low, high = estimate.ci95
    holds = "holds" if low <= true <= high else "does not hold"
    _, _, interval, _ = printed(found, estimate)
    said = f"true {estimate.name} of the simulated joint: {with_unit(f'{true * factor:.5g}', unit)}"
    return f"{said}; the interval, {interval}, {holds} it"


def _window_lines(found: Identification) -> list[str]:
    """Return a line that names the parts of the recordings that were used, none if all rows were."""
    used = [named(*one) for one in zip(found.recordings, found.windows, strict=True) if one[1] is not None]
    return [f"only a part was used: {', '.join(used)}"] if used else []


def optimum_lines(found: Identification) -> list[str]:
    """Return why Kc and Bc are not the exact optimum of the selected model; [] if they are."""
    others = [estimate for estimate in found.estimates[:2] if estimate.conditional is not None]
    if not others:
        return []
    corrected = found.deflection is not None and found.deflection.method != "none"
    why = [
        *(["averaged over the models that the data cannot decide between"] if found.steps else []),
        *(["corrected for the noise of the deflection"] if corrected else []),
        *(["without the compliance of the fixture"] if found.fixture else []),
    ]
    alone = " and ".join(
        f"{one.name} {with_unit(f'{one.exact * factor:.5g}', unit)}"
        for one in others
        for factor, unit in [people_unit(one.unit, milli=milli(found))]
    )
    subject = f"{others[0].name} is" if len(others) == 1 else "Kc and Bc are"
    reasons = ", ".join(why) or "the middle of a range"
    return [f"{subject} {reasons}: the exact optimum of {found.model.name} alone is {alone}"]


def _width_lines(found: Identification) -> list[str]:
    """Return for Kc and Bc a line that says what makes the interval wide, in percent of the value, the largest part
    first."""
    lines = []
    for estimate in found.estimates[:2]:
        if estimate.value and estimate.widths and math.isfinite(estimate.half_width):
            percent = 100.0 / abs(estimate.value)
            widths = sorted(estimate.widths.items(), key=lambda one: -one[1])
            parts = ", ".join(f"{source} {half * percent:.2g} %" for source, half in widths)
            lines.append(f"half the interval of {estimate.name} is {estimate.half_width * percent:.2g} %: {parts}")
    return lines


def _component_lines(found: Identification) -> list[str]:
    """Return for pooled recordings how far Kc and Bc differ between them, and what that does to their intervals."""
    lines = []
    for estimate in found.estimates[:2]:
        if (parts := estimate.components) is None:
            continue
        factor, unit = people_unit(estimate.unit, milli=milli(found))
        apart, own = (with_unit(f"{part * factor:.2g}", unit) for part in (parts.between, parts.within))
        why = (
            f"differs from recording to recording by {apart} (standard deviation), which its interval includes"
            if parts.between > 0.0
            else "differs from recording to recording by no more than their own errors, and its interval includes what "
            "so few recordings leave open"
        )
        lines.append(
            f"{estimate.name} of {len(found.recordings)} pooled recordings {why}; the error of one recording is {own}"
        )
    return lines


def _scale_lines(found: Identification) -> list[str]:
    """Return a line about the torque's scale, with the answer for an exact scale; [] if nothing is known of the
    scale, or the scale is exact.
    """
    exact = replace(found, estimates=tuple(one.without_scale for one in found.estimates))
    line = scale_line(found.torque_scale, f"; if it is exact, {',  '.join(verdicts(exact))}")
    return [line] if line else []


def _fixture_lines(found: Identification) -> list[str]:
    if found.fixture is None:
        return []
    values = [
        f"{estimate.name} {estimate.value * factor:.4g} {unit}"
        for estimate in found.fixture.estimates
        for factor, unit in [people_unit(estimate.unit, milli=milli(found))]
    ]
    return [f"the fixture, {' and '.join(values)}, is removed from Kc and Bc ({found.fixture.recording})"]


def deflection_lines(one: Deflection | None) -> list[str]:
    """Return a line about the noise of the deflection and its correction; an empty list if the noise has no effect."""
    if one is None:
        return []
    passed = "" if one.low_pass is None else f", before a low-pass of {one.low_pass:.3g} Hz"
    noise = f"the deflection has noise of {engineering(one.noise, 'rad', 2)}{passed}"
    if one.method == "none":
        left = ", ".join(f"{name} {100.0 * size:+.1g} %" for name, size in one.predicted.items())
        return [f"{noise}; the rest does not matter ({left})"]
    before = ", ".join(f"{name} {100.0 * size:+.2g} %" for name, size in one.before.items() if math.isfinite(size))
    return [f"{noise}; Kc and Bc are corrected with {_METHODS[one.method]} (before: {before})"]
