"""The result of `hil design` as tables, lines of text and JSON. Nothing is printed here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from hil.experiment_design.advice import command, described, of_profile
from hil.experiment_design.assessment import LIMITED, UNITS, Assessment, Task
from hil.report.formatting import Section, json_number, people_unit

if TYPE_CHECKING:
    from hil.diagnostics import Diagnostic
    from hil.experiment_design.fisher import Prediction

SCHEMA = "hil-design/2"
"""The name and version of the JSON object. In version 1 the warning not-identifiable had another code, and the default
model was linear.
"""


def headline(judged: Mapping[str, Assessment]) -> str:
    """Return the relative standard errors of Kc and Bc for each excitation, in one line."""
    errors = (
        f"{name} {one['Kc'].error / one['Kc'].rough:.2%}, {one['Bc'].error / one['Bc'].rough:.2%}"
        for name, one in judged.items()
    )
    return f"predicted standard errors of Kc, Bc: {'; '.join(errors)}"


def _errors(task: Task, judged: Mapping[str, Assessment]) -> Section:
    """Return a table of the predicted standard errors: one row for each parameter, one column for each excitation."""
    rows = [("", *(f"{name}: {described(one.profile)}" for name, one in judged.items()), "")]
    for parameters in zip(*(one.parameters for one in judged.values()), strict=True):
        factor, unit = people_unit(parameters[0].unit, milli=task.limits[1] < 1.0)
        rows.append((parameters[0].name, *(_error(parameter, factor) for parameter in parameters), unit))
    return Section(task.model, rows)


def _error(parameter: Prediction, factor: float) -> str:
    if math.isinf(parameter.error):
        return "not identifiable"
    share = f" ({parameter.error / parameter.rough:.2%})" if parameter.name in {"Kc", "Bc"} else ""
    return f"{parameter.error * factor:.3g}{share}"


def _limits(task: Task, judged: Mapping[str, Assessment]) -> Section:
    """Return a table of the predicted peaks and their limits, with one column for each excitation."""
    rows = [("", *judged, "limit", "")]
    for index, name in enumerate(LIMITED):
        factor, unit = people_unit(UNITS[index].replace(" ", "*"), milli=task.limits[1] < 1.0)
        cells = [f"{factor * one.peaks[index]:.3g} ({one.shares[index]:.0%})" for one in judged.values()]
        rows.append((name, *cells, f"{factor * task.limits[index]:g}", unit))
    return Section("predicted peaks, and their share of the limit", rows)


def sections(task: Task, judged: Mapping[str, Assessment], stand: str) -> list[Section]:
    """Return the tables of errors and limits, and below them the command that records each excitation.

    stand: the options that name the stand, such as "--backend sim".
    """
    lines = [
        "The errors are those of hil identify (least absolute deviations), 1.25 times those of least squares in white "
        "noise, without the uncertainty of the torque's scale.\nFour times the duration halves them. Heating is not "
        "predicted.",
        *(f"{name}, {_limit(one)}:\n  {command(one, stand, task.rate)}" for name, one in judged.items()),
    ]
    return [_errors(task, judged), replace(_limits(task, judged), lines=lines)]


def _limit(one: Assessment) -> str:
    """Return in words the limit to which an excitation comes nearest, and how near, for the given and for the worst Kc
    and Bc.
    """
    index = LIMITED.index(one.limited_by)
    share, worst = one.shares[index], one.worst_shares[index]
    return f"{share:.0%} of the limit of {one.limited_by} ({worst:.0%} if Kc and Bc are not as given)"


def as_json(task: Task, judged: Mapping[str, Assessment], general: list[Diagnostic], stand: str) -> dict[str, Any]:
    """Return the JSON object of `hil design --json`, SI; an infinite error is null.

    judged: the assessments "given" and "best". general: warnings that apply to every excitation.
    """
    return {
        "schema": SCHEMA,
        "model": "+".join(task.terms),
        "rough": {"Kc": task.joint.stiffness, "Bc": task.joint.damping},
        "corner": task.joint.corner,
        "resonance": json_number(task.joint.resonance),
        "torque_noise": task.readings.white,
        "angle_lsb": task.readings.angle_lsb,
        "skew": task.readings.skew,
        "profiles": {name: _profile(task, one, stand) for name, one in judged.items()},
        "warnings": [diagnostic.as_json() for diagnostic in general],
    }


def _profile(task: Task, judged: Assessment, stand: str) -> dict[str, Any]:
    limits = zip(LIMITED, UNITS, judged.peaks, task.limits, judged.shares, judged.worst_shares, strict=True)
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
        "warnings": [diagnostic.as_json() for diagnostic in of_profile(task, judged)],
    }


def _parameter(parameter: Prediction) -> dict[str, Any]:
    return {
        "rough": parameter.rough,
        "unit": parameter.unit,
        "standard_error": json_number(parameter.error),
        "cramer_rao": json_number(parameter.bound),
        "bias": json_number(parameter.bias),
        "relative": json_number(parameter.error / parameter.rough) if parameter.rough else None,
        "inflation": json_number(parameter.inflation),
    }
