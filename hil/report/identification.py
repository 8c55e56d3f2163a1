"""The result of `hil identify`: its headline, tables and lines, and its JSON object (docs/decisions/0009)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.report.deflection import deflection_json, deflection_lines
from hil.report.formatting import diagnostics_json, json_number, people_unit, plain_table, rounded, rounded_in_thousands
from hil.report.lack_of_fit import dynamic_stiffness_json, dynamic_stiffness_table, lack_of_fit_json
from hil.uncertainty.criteria import COUPLING

if TYPE_CHECKING:
    from rich.table import Table

    from hil.identification.result import Estimate, Fixture, Identification
    from hil.identification.selection.stepwise import Step

SCHEMA = "hil-identification/2"
_FIRST = "hil-identification/1"


def milli(found: Identification) -> bool:
    """Return whether the result is printed in mN m: a hand's joint is, an arm's is not."""
    return float(np.ptp(found.signals.torque)) < 1.0


def as_json(found: Identification) -> dict[str, Any]:
    """Return the JSON object of `hil identify --json`, SI units; a number that is not finite is null."""
    return {
        **_head(found.recordings, found.model.name, found.preset, found.seed),
        "parameters": {
            estimate.name: _parameter(estimate) | {"trusted": found.trusted(estimate.name)}
            for estimate in found.estimates
        },
        "fitness": {
            "value": found.optimum,
            "best_trial": found.fitness,
            "optimiser_gap": found.optimiser_gap,
            "unit": "N*m",
        },
        "samples": found.samples,
        "trials": len(found.trials.fitness),
        "evaluations": found.trials.evaluations,
        "seconds": found.seconds,
        "validation": {
            "fitness": json_number(found.validation.fitness),
            "nrmse": json_number(found.validation.nrmse),
        },
        **diagnostics_json(found.diagnostics),
        "model_selection": [_step(step) for step in found.steps],
        "lack_of_fit": lack_of_fit_json(found.lack_of_fit),
        "dynamic_stiffness": dynamic_stiffness_json(found.dynamic_stiffness),
        "deflection": None if found.deflection is None else deflection_json(found.deflection),
        "fixture": None if found.fixture is None else _fixture(found.fixture),
    }


def unusable_json(recordings: Sequence[Path], model: str, preset: str, seed: int, reason: str) -> dict[str, Any]:
    """Return the object where nothing could be fitted: Kc and Bc are null, and `reason` stands in the errors."""
    units = {"Kc": "N*m/rad", "Bc": "N*m*s/rad"}
    return {
        **_head(recordings, model, preset, seed),
        "parameters": {
            name: {"value": None, "unit": unit, "ci95": [None, None], "identifiable": False, "trusted": False}
            for name, unit in units.items()
        },
        **diagnostics_json(Diagnostic("unusable", reason, name, is_error=True) for name in units),
    }


def _head(recordings: Sequence[Path], model: str, preset: str, seed: int) -> dict[str, Any]:
    paths = [str(path) for path in recordings]
    return {"schema": SCHEMA, "recordings": paths, "model": model, "preset": preset, "seed": seed}


def _fixture(fixture: Fixture) -> dict[str, Any]:
    return {
        "recording": str(fixture.recording),
        "model": fixture.model,
        "parameters": {estimate.name: _parameter(estimate) for estimate in fixture.estimates},
    }


def _parameter(estimate: Estimate) -> dict[str, Any]:
    components, trials = estimate.components, estimate.optimiser
    return {
        "value": estimate.value,
        "unit": estimate.unit,
        "ci95": [json_number(end) for end in estimate.ci95],
        "conditional": _conditional(estimate),
        "choice_share": estimate.choice,
        "depends_on": estimate.depends_on,
        "identifiable": estimate.identifiable,
        "at_bound": estimate.at_bound,
        "bounds": [json_number(end) for end in estimate.bounds],
        "within_std": None if components is None else components.within,
        "between_std": None if components is None else components.between,
        "optimiser_repeatability": {
            "best": trials.best,
            "trials_mean": trials.mean,
            "trials_std": json_number(trials.std),
        },
    }


def _conditional(estimate: Estimate) -> dict[str, Any]:
    """The exact optimum of the selected model, and its interval given that model."""
    low, high = estimate.ci95 if estimate.conditional is None else estimate.conditional.ci95
    return {"value": estimate.exact, "ci95": [json_number(low), json_number(high)]}


def _step(step: Step) -> dict[str, Any]:
    return {
        "model": step.model,
        "term": step.term,
        "decision": "included" if step.included else "rejected",
        "fitness": step.fitness,
        "validation_fitness": step.held_out,
        "gain": json_number(step.gain),
        "Kc": step.Kc,
        "Bc": step.Bc,
    }


def upgraded(table: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON object of `hil identify` in the words of this version, whichever version wrote it.

    Version 1 kept the errors among the warnings without a mark: there they stay. Raises WrongUse for any other schema.
    """
    schema = table.get("schema")
    if schema == SCHEMA:
        return table
    if schema != _FIRST:
        raise WrongUse(
            f"the JSON object was written as schema {schema!r}, and this version of hil reads {_FIRST} and {SCHEMA}: "
            "identify the recordings again, or read it with the version that wrote it"
        )
    same = {name: value for name, value in table.items() if name not in {"holdout", "ladder"}}
    same["schema"] = SCHEMA
    same["parameters"] = _upgraded_parameters(table["parameters"])
    same["warnings"] = [one | {"code": _CODES.get(one["code"], one["code"])} for one in table["warnings"]]
    same["errors"] = []
    if "fitness" not in table:  # nothing could be fitted
        return same
    fitness = table["fitness"]
    same["fitness"] = {
        "value": fitness["exact_optimum"],
        "best_trial": fitness["value"],
        "optimiser_gap": fitness["relative_gap"],
        "unit": fitness["unit"],
    }
    same["validation"] = table["holdout"]
    same["model_selection"] = [_upgraded_step(step) for step in table["ladder"]]
    if table.get("fixture") is not None:
        same["fixture"] = table["fixture"] | {"parameters": _upgraded_parameters(table["fixture"]["parameters"])}
    return same


_CODES = {"unsteady": "not-stationary"}
"""Diagnostics by their code in version 1."""


def _upgraded_parameters(parameters: dict[str, Any]) -> dict[str, Any]:
    found = {}
    for name, old in parameters.items():
        trials = {"best": "value", "trials_mean": "trials_mean", "trials_std": "trials_std"}
        kept = {key: value for key, value in old.items() if key not in {"exact", "trials_mean", "trials_std"}}
        if "exact" in old:
            kept["value"] = old["exact"]
            kept["optimiser_repeatability"] = {new: old[key] for new, key in trials.items()}
        found[name] = kept
    return found


def _upgraded_step(old: dict[str, Any]) -> dict[str, Any]:
    kept = {key: value for key, value in old.items() if key not in {"taken", "held_out"}}
    return kept | {
        "decision": "included" if old["taken"] else "rejected",
        "validation_fitness": old["held_out"],
    }


def headline(found: Identification) -> str:
    """Return Kc and Bc with half of their 95 % intervals and whether they may be trusted, in one line."""
    lines = verdicts(found)
    return ",  ".join(lines) + ("  (95 %)" if all("±" in line for line in lines) else "")


def verdicts(found: Identification) -> list[str]:
    """Return a line for Kc and one for Bc: the value, half of its 95 % interval, and whether it may be trusted."""
    return [_verdict(found, estimate) for estimate in found.estimates[:2]]


def _verdict(found: Identification, estimate: Estimate) -> str:
    value, half, interval, unit = printed(found, estimate)
    codes = [code for code in found.doubts(estimate.name) if code != "two-stiffnesses" or not estimate.depends_on]
    doubts = f" (not to be trusted: {', '.join(dict.fromkeys(codes))})" if codes else ""
    if estimate.depends_on is not None:
        return f"{estimate.name} = {interval} {unit} (depends on the {estimate.depends_on}){doubts}"
    if not estimate.identifiable or half is None:
        return f"{estimate.name} = {value} {unit} (not identifiable)"
    return f"{estimate.name} = {value} ± {half} {unit}{doubts}"


def printed(found: Identification, estimate: Estimate) -> tuple[str, str | None, str, str]:
    """Return the value, half its interval, the interval and the unit of a parameter, rounded together.

    Half the interval is None where it is not finite.
    """
    factor, unit = people_unit(estimate.unit, milli=milli(found))
    low, high = (end * factor for end in estimate.ci95)
    if not math.isfinite(low):
        return f"{estimate.value * factor:.5g}", None, "not identifiable", unit
    of = rounded if estimate.name in COUPLING else rounded_in_thousands
    value, half = of(estimate.half_width * factor, estimate.value * factor)
    first, last, _ = of(0.05 * (high - low), low, high)
    return value, half, f"{first} to {last}", unit


def estimates_table(found: Identification) -> Table:
    """Return the table of values and 95 % intervals."""
    rows = []
    for estimate in found.estimates:
        value, _, interval, unit = printed(found, estimate)
        if estimate.depends_on is not None:
            rows.append((f"{estimate.name} (depends on the {estimate.depends_on})", "", interval, unit))
            continue
        name = estimate.name if estimate.identifiable else f"{estimate.name} (not identifiable)"
        rows.append((name, value, interval, unit))
    return plain_table(f"{found.model.name}, {found.samples} samples", ("", "value", "95 % interval", ""), rows)


def repeatability_table(found: Identification) -> Table:
    """Return the table of optimiser repeatability: the paper's Table 1 beside the exact optimum. No uncertainty."""
    rows = []
    for estimate in found.estimates:
        factor, unit = people_unit(estimate.unit, milli=milli(found))
        trials = estimate.optimiser
        std = f" ± {trials.std * factor:.0e}" if math.isfinite(trials.std) else ""  # none for a single trial
        numbers = (f"{trials.best * factor:.5g}", f"{trials.mean * factor:.5g}{std}", f"{estimate.exact * factor:.5g}")
        rows.append((estimate.name, *numbers, unit))
    title = f"optimiser repeatability, {len(found.trials.fitness)} trials"
    return plain_table(title, ("", "best trial", "mean ± std", "exact", ""), rows)


def model_selection_table(found: Identification) -> Table:
    """Return the table of model selection: the gain of each term, and Kc and Bc with it."""
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
    return plain_table("model selection", headings, rows)


def bands_table(found: Identification) -> Table | None:
    """Return the dynamic stiffness in bands, by amplitude too; None where the recording is too short for it."""
    if found.dynamic_stiffness is None:
        return None
    factor, stiffness = people_unit("N*m/rad", milli=milli(found))
    damping = people_unit("N*m*s/rad", milli=milli(found))[1]
    return dynamic_stiffness_table(found.dynamic_stiffness, factor, stiffness, damping)


def identification_lines(found: Identification) -> list[str]:
    """Return the lines below the tables: fitness and optimiser gap, validation, fixture, excited band, work done."""
    factor, unit = people_unit("N*m", milli=milli(found))
    return [
        f"mean |torque error| {found.optimum * factor:.5g} {unit}; best trial {found.fitness * factor:.5g} {unit}; "
        f"optimiser gap {found.optimiser_gap:.1e}",
        f"validation on 20 % held-out data: mean |torque error| {found.validation.fitness * factor:.3g} {unit}; "
        f"r.m.s. error {found.validation.nrmse:.2%} of the torque",
        *_choice_lines(found),
        *_component_lines(found),
        *deflection_lines(found.deflection),
        *_fixture_lines(found),
        *([] if found.steps else ["the intervals assume this model: --model auto selects its terms from the data"]),
        f"excited band {found.signals.band[0]:.2g} to {found.signals.band[1]:.3g} Hz; "
        f"{found.trials.evaluations} evaluations in {found.seconds:.2f} s",
    ]


def summary_lines(found: Identification) -> list[str]:
    """Return the lines below the answer: the model, the fit, corrections of Kc and Bc if there are any, the work."""
    factor, unit = people_unit("N*m", milli=milli(found))
    others = [_verdict(found, estimate) for estimate in found.estimates[2:]]
    chosen = f", selected from {len(found.steps)} candidates" if found.steps else ""
    return [
        f"model {found.model.name}{chosen}" + (f": {',  '.join(others)}" if others else ""),
        f"mean |torque error| {found.optimum * factor:.3g} {unit} over {found.samples} samples; "
        f"r.m.s. error {found.validation.nrmse:.2%} of the torque on held-out data; "
        f"optimiser gap {found.optimiser_gap:.1e}",
        *_component_lines(found),
        *(deflection_lines(found.deflection) if found.deflection and found.deflection.method != "none" else []),
        *_fixture_lines(found),
        f"excited band {found.signals.band[0]:.2g} to {found.signals.band[1]:.3g} Hz; "
        f"{found.trials.evaluations} evaluations in {found.seconds:.2f} s; more with --verbose",
    ]


def truth_lines(found: Identification, truth: Mapping[str, float]) -> list[str]:
    """Return a line for Kc and one for Bc: the simulator's true value, and whether the 95 % interval holds it.

    truth: SI, by the names of a recording's /truth group.
    """
    return [_truth_line(found, estimate, truth[estimate.name]) for estimate in found.estimates[:2]]


def _truth_line(found: Identification, estimate: Estimate, true: float) -> str:
    factor, unit = people_unit(estimate.unit, milli=milli(found))
    low, high = estimate.ci95
    holds = "holds" if low <= true <= high else "does not hold"
    _, _, interval, _ = printed(found, estimate)
    said = f"true {estimate.name} of the simulated joint: {true * factor:.5g} {unit}"
    return f"{said}; the interval, {interval}, {holds} it"


def _choice_lines(found: Identification) -> list[str]:
    """How much of the intervals of Kc and Bc comes from the choice of the model."""
    averages = [estimate for estimate in found.estimates[:2] if estimate.conditional is not None]
    shares = " and ".join(f"{estimate.choice:.0%} of the interval of {estimate.name}" for estimate in averages)
    return [f"the choice of the model makes {shares}"] if shares else []


def _component_lines(found: Identification) -> list[str]:
    """The variance components of Kc and Bc over pooled recordings, as standard deviations."""
    pooled = [(estimate, estimate.components) for estimate in found.estimates[:2] if estimate.components is not None]
    return [
        f"{estimate.name}, standard deviation between the {len(found.recordings)} recordings: "
        f"{components.between * factor:.2g} {unit}; within one: {components.within * factor:.2g} {unit}"
        for estimate, components in pooled
        for factor, unit in [people_unit(estimate.unit, milli=milli(found))]
    ]


def _fixture_lines(found: Identification) -> list[str]:
    if found.fixture is None:
        return []
    values = [
        f"{estimate.name} {estimate.value * factor:.4g} {unit}"
        for estimate in found.fixture.estimates
        for factor, unit in [people_unit(estimate.unit, milli=milli(found))]
    ]
    return [f"the fixture, {' and '.join(values)}, is removed from Kc and Bc ({found.fixture.recording})"]
