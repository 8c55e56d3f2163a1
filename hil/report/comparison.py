"""The result of `hil compare` as a table, a JSON object and a figure."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from hil.identification.compare import Comparison, Measured, Repeated
from hil.recording.channels import TorqueScale
from hil.recording.interval import named
from hil.report.chart import Band, Chart, Panel, with_intervals
from hil.report.formatting import (
    Section,
    capitalised,
    diagnostics_json,
    json_number,
    people_unit,
    rounded,
    rounded_with_value,
    scale_json,
    scale_line,
)
from hil.report.html_page import Page, Picture, write
from hil.report.provenance import provenance
from hil.signals.constants import COUPLING

SCHEMA = "hil-comparison/2"
"""The name and version of the JSON object. In version 1 the errors were in the list of warnings."""


def as_json(found: Comparison) -> dict[str, Any]:
    """Return the JSON object of `hil compare --json`, with SI units and hours; an unknown value is null."""
    return {
        "schema": SCHEMA,
        "model": found.model,
        "torque_scale": scale_json(_torque_scale(found)),
        "recordings": [_recording(one) for one in found.recordings],
        "parameters": {one.name: _parameter(one) for one in found.parameters},
        "verdict": [one.verdict for one in found.parameters],
        **diagnostics_json(found.diagnostics),
    }


def _recording(one: Measured) -> dict[str, Any]:
    return {
        "path": str(one.path),
        "window": None if one.window is None else list(one.window),
        "created": None if one.created is None else one.created.isoformat(),
        "hours": json_number(one.hours),
        "model": one.model,
        "parameters": {
            name: {
                "value": estimate.value,
                "unit": estimate.unit,
                "ci95": [json_number(end) for end in estimate.ci95],
                "ci95_without_torque_scale": [json_number(end) for end in estimate.without_scale.ci95],
                "identifiable": name in one.identifiable,
            }
            for name, estimate in one.estimates.items()
        },
    }


def _parameter(one: Repeated) -> dict[str, Any]:
    drift = one.drift
    names = ("value", "standard_error", "ci95", "within", "between", "between_ci95", "p_alike")
    return {
        "unit": one.unit,
        "recordings": len(one.recordings),
        **{name: None if one.pooled is None else getattr(one.pooled, name) for name in names},
        "drift_per_hour": None if drift is None else {"value": drift.slope, "ci95": list(drift.ci95), "p": drift.p},
        "repeats": one.repeats,
        "verdict": one.verdict,
    }


def _scale(found: Comparison, unit: str) -> tuple[float, str]:
    """Return factor and unit for printing a column: based on mN m for a soft joint such as a hand's, otherwise on N
    m.
    """
    kc = [abs(one.estimates["Kc"].value) for one in found.recordings if one.estimates]
    return people_unit(unit, milli=not kc or min(kc) < 1.0)


def comparison_section(found: Comparison) -> Section:
    """Return a table with one row for each recording, and below these the pooled value and the variance components."""
    pooled = _pooled_rows(found)
    rows = [_headings(found), *_recording_rows(found), *pooled]
    return Section(f"{found.model}, {_alone(found)}", rows, _notes(found), len(pooled))


def _torque_scale(found: Comparison) -> TorqueScale:
    return TorqueScale.widest(one.torque_scale for one in found.recordings)


def _alone(found: Comparison) -> str:
    """Return the heading of the single recordings, whose errors leave out what all of them share."""
    without = ", without the uncertainty of the torque's scale" if _torque_scale(found).included else ""
    return f"each recording on its own{without}"


def _headings(found: Comparison) -> list[str]:
    columns = (f"{parameter.name}, {_scale(found, parameter.unit)[1]}" for parameter in found.parameters)
    return ["", "hours", *columns]


def _recording_rows(found: Comparison) -> list[list[str]]:
    return [
        [
            named(one.path, one.window),
            f"{one.hours:.3g}" if math.isfinite(one.hours) else "unknown",
            *(_cell(found, one, name) for name in COUPLING),
        ]
        for one in found.recordings
    ]


def _pooled_rows(found: Comparison) -> list[list[str]]:
    headings = ("pooled", "95 % interval", "within a recording", "between them", "drift an hour")
    together = [_together(found, parameter) for parameter in found.parameters]
    return [[heading, "", *cells] for heading, *cells in zip(headings, *together, strict=True)]


def _notes(found: Comparison) -> list[str]:
    """Return the lines below the table: the uncertainty of the torque's scale, which is common to all recordings."""
    line = scale_line(_torque_scale(found), ", the same in all recordings; only the pooled intervals include it")
    return [line] if line else []


def write_page(found: Comparison, path: Path, command: str = "", *, force: bool) -> Path:
    """Write the HTML report to `path` and return the path. command: the command line, for the report. Raises
    WrongUse.
    """
    verdicts = [parameter.verdict for parameter in found.parameters]
    table = comparison_section(found)
    alt = f"Kc and Bc of {len(found.recordings)} recordings with their 95 % intervals. {' '.join(verdicts)}"
    paths = [one.path for one in found.recordings]
    page = Page(
        title=f"{', '.join(path.name for path in paths)}: {verdicts[0]}",
        subject=f"Comparison of {len(paths)} recordings, {found.model}",
        verdict=_pooled(found) or verdicts,
        diagnostics=found.diagnostics,
        sections=[Section(capitalised(_alone(found)), table.rows, [*verdicts, *table.lines])],
        pictures=[Picture("comparison", "Kc and Bc of each recording", alt, lambda: chart(found))],
        provenance=provenance(paths, command),
        table=as_json(found),
    )
    return write(page, path, force=force)


def _pooled(found: Comparison) -> list[str]:
    """Return a line with the pooled value and interval of each parameter; [] if one has none."""
    lines = []
    for one in found.parameters:
        if one.pooled is None:
            return []
        factor, unit = _scale(found, one.unit)
        low, high = one.pooled.ci95
        value, half = rounded_with_value(0.5 * (high - low) * factor, one.pooled.value * factor)
        how = "does not repeat" if one.repeats is False else f"{len(one.recordings)} recordings pooled"
        lines.append(f"{one.name} = {value} ± {half} {unit} ({how})")
    return lines


def _cell(found: Comparison, one: Measured, name: str) -> str:
    if name not in one.estimates:
        return "left out"
    estimate = one.estimates[name].without_scale
    factor = _scale(found, estimate.unit)[0]
    half = estimate.half_width * factor
    if name not in one.identifiable or not math.isfinite(half):
        return f"{estimate.value * factor:.3g} (not identifiable)"
    return " ± ".join(rounded(half, estimate.value * factor))


def _together(found: Comparison, one: Repeated) -> list[str]:
    if one.pooled is None:
        return ["unknown"] * 5
    factor = _scale(found, one.unit)[0]
    low, high = (end * factor for end in one.pooled.ci95)
    share = 100.0 / abs(one.pooled.value)
    components = [f"{part * share:.2g} %" for part in (one.pooled.within, one.pooled.between)]
    slope = "unknown" if one.drift is None else f"{one.drift.slope * share:+.2g} % (p = {one.drift.p:.2g})"
    value, first, last, _ = rounded(0.05 * (high - low), one.pooled.value * factor, low, high)
    return [value, f"{first} to {last}", *components, slope]


def chart(found: Comparison) -> Chart:
    """Return each parameter over the recordings with its interval, and the pooled interval as a background."""
    panels = []
    for parameter in found.parameters:
        factor, unit = _scale(found, parameter.unit)
        shown = [
            (index, one.estimates[parameter.name].without_scale)
            for index, one in enumerate(found.recordings)
            if parameter.name in one.identifiable
        ]
        line = with_intervals([(index, one.value * factor, one.half_width * factor) for index, one in shown])
        low, high = parameter.pooled.ci95 if parameter.pooled else (math.nan, math.nan)
        bands = [Band(low * factor, high * factor, "pooled, 95 %")] if parameter.pooled else []
        names = [one.path.stem for one in found.recordings]
        panels.append(Panel("", f"{parameter.name} [{unit}]", [line], names=names, bands=bands))
    return Chart(panels)
