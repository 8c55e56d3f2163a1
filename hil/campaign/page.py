"""The report of a campaign as an HTML page, as lines for the terminal and as a JSON object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hil.campaign.plan import Plan
from hil.campaign.results import PARAMETERS, Line, Outlier, Results, Value
from hil.diagnostics import Diagnostic
from hil.report.chart import Chart, Panel, with_intervals
from hil.report.formatting import people_unit, rounded
from hil.report.html_page import Page, Picture, Section, write
from hil.report.provenance import provenance

_CHANCE = 0.05


def verdict(found: Results) -> str:
    """Return the campaign's result in one line: how many joints have Kc and Bc, and which of them need attention."""
    complete = sum(len(line.values) == len(PARAMETERS) for line in found.lines)
    text = f"Kc and Bc of {complete} of {len(found.lines)} joints and settings"
    odd = [line.name for line in found.lines if line.stands_out or False in line.repeats.values()]
    failed = f"; without a result: {len(found.failed)} recordings" if found.failed else ""
    return text + failed + (f"; look at {', '.join(odd)}" if odd else "")


def diagnostics(found: Results) -> list[Diagnostic]:
    """Return the warnings and errors about the campaign's results, each with a remedy."""
    listed = [Diagnostic("no-result", f"{one.run.name}: {one.failure}", is_error=True) for one in found.failed]
    for line in found.lines:
        for name in PARAMETERS:
            if line.repeats[name] is False:
                text = f"{name} differs between its repeats, {_range(found, line, name)}: check mounting and lock"
                listed.append(Diagnostic("does-not-repeat", f"{line.name}: {text}", name))
        for name, one in line.stands_out.items():
            text = f"{name} is {_unlike(found, line, name, one)}: check its cable and its recording"
            listed.append(Diagnostic("outlier", f"{line.name}: {text}", name))
    for name, (slope, mean) in found.drifts.items():
        if slope.p < _CHANCE:
            text = f"{name} of the drift checks changes by {100.0 * slope.slope / mean:+.2g} % an hour"
            listed.append(Diagnostic("drift", f"{text}: the joints were not measured under the same conditions", name))
    return listed


def _range(found: Results, line: Line, name: str) -> str:
    """Return in words the smallest and largest value of a parameter over a line's recordings, and their largest
    error.
    """
    factor, unit = people_unit(_units(found)[name], milli=_milli(found))
    known = [one.values[name] for one in line.measured if name in one.values]
    least, most = (factor * end(one.value for one in known) for end in (min, max))
    half = factor * max(one.ci95[1] - one.ci95[0] for one in known) / 2.0
    return f"{least:.4g} to {most:.4g} {unit}, by more than their own errors, ± {half:.2g} at most"


def _unlike(found: Results, line: Line, name: str, outlier: Outlier) -> str:
    """Return in words how an outlier differs from the median of the hand's joints."""
    factor, unit = people_unit(_units(found)[name], milli=_milli(found))
    value = line.values[name].value
    return (
        f"{factor * value:.4g} {unit}, {value / outlier.median:.2g} times the hand's median of "
        f"{factor * outlier.median:.4g} (modified z-score {outlier.score:.1f}, of which 3.5 is usual at most)"
    )


def table(found: Results) -> list[list[str]]:
    """Return a table of the hand with one row for each joint and setting; the first row has the headings."""
    factor = {name: people_unit(unit, milli=_milli(found)) for name, unit in _units(found).items()}
    headings = ["joint", "setting", "recordings", *(f"{name}, {factor[name][1]}" for name in PARAMETERS), "state"]
    rows = []
    for line in found.lines:
        setting = ", ".join(part for part in (line.pretension, line.profile) if part)
        used = sum(bool(one.values) for one in line.measured)
        values = [_cell(line.values.get(name), factor[name][0]) for name in PARAMETERS]
        rows.append([line.joint, setting, f"{used} of {len(line.measured)}", *values, _state(line)])
    return [headings, *rows]


def _units(found: Results) -> dict[str, str]:
    known = {"Kc": "N*m/rad", "Bc": "N*m*s/rad"}
    return known | {name: value.unit for line in found.lines for name, value in line.values.items()}


def _milli(found: Results) -> bool:
    values = [line.values["Kc"].value for line in found.lines if "Kc" in line.values]
    return not values or min(abs(value) for value in values) < 1.0


def _cell(value: Value | None, factor: float) -> str:
    if value is None:
        return "no result"
    half = 0.5 * (value.ci95[1] - value.ci95[0]) * factor
    return " ± ".join(rounded(half, value.value * factor))


def _state(line: Line) -> str:
    notes = [f"{name} does not repeat" for name in PARAMETERS if line.repeats[name] is False]
    notes += [f"{name} stands out" for name in line.stands_out]
    if any(one.failure for one in line.measured):
        notes.append("recordings without a result")
    return "; ".join(notes) or ("repeats" if True in line.repeats.values() else "")


def as_json(plan: Plan, found: Results) -> dict[str, Any]:
    """Return the JSON object of `hil campaign --json`, SI."""
    return {
        "schema": "hil-campaign/1",
        "name": plan.settings.name,
        "plan": str(plan.path),
        "model": plan.settings.model,
        "complete": found.complete,
        "joints": [_line_json(line) for line in found.lines],
        "drift_per_hour": {
            name: {"value": slope.slope, "ci95": list(slope.ci95), "p": slope.p}
            for name, (slope, _) in found.drifts.items()
        },
        "failed": [{"run": one.run.name, "reason": one.failure} for one in found.failed],
    }


def _line_json(line: Line) -> dict[str, Any]:
    return {
        "joint": line.joint,
        "profile": line.profile,
        "pretension": line.pretension or None,
        "recordings": [str(one.run.path) for one in line.measured if one.values],
        "parameters": {
            name: {"value": one.value, "ci95": list(one.ci95), "unit": one.unit} for name, one in line.values.items()
        },
        "repeats": dict(line.repeats),
        "outlier": list(line.stands_out),
        "outliers": {
            name: {"ratio_to_median": line.values[name].value / one.median, "modified_z_score": one.score}
            for name, one in line.stands_out.items()
        },
    }


def write_page(plan: Plan, found: Results, path: Path, command: str = "") -> Path:
    """Write the HTML report to `path` and return the path. A report of the same campaign is replaced."""
    rows = table(found)
    text = "; ".join(f"{row[0]}, {row[1]}: Kc {row[3]}, Bc {row[4]}" for row in rows[1:])
    done = [one.run.path for line in found.lines for one in line.measured if one.values]
    page = Page(
        title=f"{plan.settings.name}: {verdict(found)}",
        subject=f"Campaign {plan.settings.name}, {plan.path}",
        verdict=(verdict(found),),
        diagnostics=[*diagnostics(found), *_of_recordings(found)],
        sections=[Section("The hand, with 95 % intervals", rows), Section("Every recording", _recordings(found))],
        pictures=[Picture("hand", "Kc and Bc of each joint", text, lambda: chart(found))] if done else [],
        provenance=provenance(done[:1], command),
        table=as_json(plan, found),
        failed=not done,
    )
    return write(page, path, force=True)


def _of_recordings(found: Results) -> list[Diagnostic]:
    """Return the warnings and errors of all recordings, without the errors that a failed recording's `failure`
    states.
    """
    measured = [one for line in found.lines for one in line.measured]
    return [said for one in measured for said in one.diagnostics if not (one.failure and said.is_error)]


def _recordings(found: Results) -> list[list[str]]:
    rows = [["recording", *PARAMETERS, "failure"]]
    factor = {name: people_unit(unit, milli=_milli(found))[0] for name, unit in _units(found).items()}
    for line in found.lines:
        for one in line.measured:
            values = [_cell(one.values.get(name), factor[name]) for name in PARAMETERS]
            rows.append([one.run.path.name, *values, one.failure])
    return rows


def chart(found: Results) -> Chart:
    """Return Kc and Bc of every line with their intervals; the outliers are in another colour."""
    panels = []
    for name in PARAMETERS:
        factor, unit = people_unit(_units(found)[name], milli=_milli(found))
        points: dict[bool, list[tuple[float, float, float]]] = {False: [], True: []}
        for at, line in enumerate(found.lines):
            if (value := line.values.get(name)) is not None:
                half = 0.5 * (value.ci95[1] - value.ci95[0]) * factor
                points[name in line.stands_out].append((at, value.value * factor, half))
        lines = [with_intervals(points[False]), with_intervals(points[True], "outlier", "error")]
        names = [line.name for line in found.lines]
        panels.append(Panel("", f"{name} [{unit}]", lines if points[True] else lines[:1], names=names))
    return Chart(panels)
