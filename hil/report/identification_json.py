"""The JSON object of `hil identify` (docs/decisions/0009), and the conversion of objects that earlier versions
wrote.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.report.controller import controller_json
from hil.report.formatting import diagnostics_json, json_number, scale_json
from hil.report.lack_of_fit import dynamic_stiffness_json, lack_of_fit_json

if TYPE_CHECKING:
    from hil.identification.result import Deflection, Estimate, Fixture, Identification, Step

SCHEMA = "hil-identification/2"
_FIRST = "hil-identification/1"


def as_json(found: Identification) -> dict[str, Any]:
    """Return the JSON object of `hil identify --json`, SI units; a number that is not finite is null."""
    return {
        **_head(found.recordings, found.model.name, found.preset, found.seed),
        "torque_scale": scale_json(found.torque_scale),
        "windows": [None if one is None else list(one) for one in found.windows],
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
        "controller": controller_json(found),
    }


def deflection_json(deflection: Deflection) -> dict[str, Any]:
    """Return the entry "deflection" of the JSON object of `hil identify --json`."""
    return {
        "noise": deflection.noise,
        "counts": json_number(deflection.counts),
        "low_pass": deflection.low_pass,
        "method": deflection.method,
        "instrument_strength": deflection.strength,
        "before": {name: json_number(one) for name, one in deflection.before.items()},
        "predicted": {name: json_number(one) for name, one in deflection.predicted.items()},
    }


def unusable_json(recordings: Sequence[Path], model: str, preset: str, seed: int, reason: str) -> dict[str, Any]:
    """Return the JSON object for recordings from which nothing could be identified: Kc and Bc are null, and `reason` is
    in the list of errors.
    """
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
        "ci95_without_torque_scale": [json_number(end) for end in estimate.without_scale.ci95],
        "conditional": _conditional(estimate),
        "choice_share": estimate.choice,
        "widths": {source: json_number(half) for source, half in estimate.widths.items()},
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
    """Return the exact optimum of the selected model, and the interval on condition that this model is correct."""
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
    """Return a JSON object of `hil identify`, written by any version, with the names that the present version uses.

    In version 1 the errors were in the list of warnings without a mark; they stay in that list. Raises WrongUse for any
    other schema.
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


_CODES = {"unsteady": "misfit"}
"""The present code of each diagnostic, by its code in version 1."""


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
