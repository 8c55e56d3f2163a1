"""The report of a campaign as an HTML page, as lines for the terminal and as a JSON object."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hil.campaign import fingers
from hil.campaign.plan import Plan
from hil.campaign.results import BESIDE, PARAMETERS, Line, Measured, Outlier, Results, Value
from hil.diagnostics import Diagnostic
from hil.printable import quoted
from hil.recording.output import atomic_write
from hil.report.chart import Chart, Panel, with_intervals
from hil.report.formatting import Section, people_unit, rounded_with_value
from hil.report.html_page import Page, Picture, write
from hil.report.provenance import provenance

_CHANCE = 0.05
_MEANINGS = {"Fc": "friction Fc", "Fd": "friction Fd", "mu": "friction mu", "gap": "play"}


def verdict(found: Results) -> str:
    """Return the campaign's result in one line: how many joints have Kc and Bc, and which of them need attention."""
    complete = sum(not line.missing for line in found.lines)
    what = "joints and settings" if _differ(found) else "joints"
    text = f"Kc and Bc of {complete} of {len(found.lines)} {what}"
    odd = [line.name for line in found.lines if line.stands_out or False in line.repeats.values()]
    failed = f"; without a result: {len(found.failed)} recordings" if found.failed else ""
    return text + failed + (f"; look at {', '.join(odd)}" if odd else "")


def diagnostics(found: Results) -> list[Diagnostic]:
    """Return the warnings and errors about the campaign's results, each with a remedy."""
    listed = [Diagnostic("no-result", f"{one.run.name}: {one.failure}", is_error=True) for one in found.failed]
    for line in found.lines:
        known = [one for one in line.measured if one.values]
        for name in line.missing if known else ():  # the reason of a run without any result stands above
            said = [each for one in known for each in one.diagnostics if each.is_error and each.parameter == name]
            why = said[0].message if said else f"hil identify {quoted(known[0].run.path)} says why"
            text = f"{line.name}: no recording identifies {name}: {why}"
            listed.append(Diagnostic("no-result", text, name, is_error=True))
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
    factor, unit = _printed(found)[name]
    known = [one.values[name] for one in line.measured if name in one.values]
    least, most = (factor * end(one.value for one in known) for end in (min, max))
    half = factor * 1.96 * max(one.error for one in known)
    return f"{least:.4g} to {most:.4g} {unit}, by more than their own errors, ± {half:.2g} at most"


def _unlike(found: Results, line: Line, name: str, outlier: Outlier) -> str:
    """Return in words how an outlier differs from the median of the hand's joints."""
    factor, unit = _printed(found)[name]
    value = line.values[name].value
    return (
        f"{factor * value:.4g} {unit}, {value / outlier.median:.2g} times the hand's median of "
        f"{factor * outlier.median:.4g} (modified z-score {outlier.score:.1f}, of which 3.5 is usual at most)"
    )


def table(found: Results) -> list[list[str]]:
    """Return a table of the hand with one row for each joint and setting; the first row has the headings.

    A setting that all joints share has no column.
    """
    rows = [["joint", "setting", "recordings", *_headings(found), "state"]]
    for line in found.lines:
        setting = ", ".join(part for part in (line.pretension, line.profile) if part)
        used = sum(bool(one.values) for one in line.measured)
        rows.append([line.joint, setting, f"{used} of {len(line.measured)}", *_cells(found, line), _state(line)])
    return rows if _differ(found) else [[joint, *beside] for joint, _, *beside in rows]


def _differ(found: Results) -> bool:
    """Return whether the lines differ in their settings, so that a line's joint alone does not name it."""
    return len({(line.pretension, line.profile) for line in found.lines}) > 1


def _names(found: Results) -> list[str]:
    return [line.name if _differ(found) else line.joint for line in found.lines]


def _headings(found: Results) -> list[str]:
    return [f"{_MEANINGS.get(name, name)}, {unit}" for name, (_, unit) in _printed(found).items()]


def _cells(found: Results, one: Line | Measured) -> list[str]:
    """Return the cells below `_headings`. A model without friction or play has empty cells there."""
    printed = _printed(found)
    kept = [_cell(one.values.get(name), printed[name][0]) for name in PARAMETERS]
    beside = [name for name in printed if name not in PARAMETERS]
    return kept + [_cell(one.beside[name], printed[name][0]) if name in one.beside else "" for name in beside]


def _printed(found: Results) -> dict[str, tuple[float, str]]:
    """Return for each parameter the factor from SI to the printed unit, and the printed unit."""
    return {name: people_unit(unit, milli=_milli(found)) for name, unit in _units(found).items()}


def _units(found: Results) -> dict[str, str]:
    known = {"Kc": "N*m/rad", "Bc": "N*m*s/rad"}
    kept = [one for line in found.lines for one in (*line.values.items(), *line.beside.items())]
    listed = {name: value.unit for name, value in kept}
    return known | {name: listed[name] for name in (*PARAMETERS, *BESIDE) if name in listed}


def _milli(found: Results) -> bool:
    values = [line.values["Kc"].value for line in found.lines if "Kc" in line.values]
    return not values or min(abs(value) for value in values) < 1.0


def _cell(value: Value | None, factor: float) -> str:
    if value is None:
        return "no result"
    half = 0.5 * (value.ci95[1] - value.ci95[0]) * factor
    return " ± ".join(rounded_with_value(half, value.value * factor))


def _state(line: Line) -> str:
    notes = [f"{name} does not repeat" for name in PARAMETERS if line.repeats[name] is False]
    notes += [f"{name} stands out" for name in line.stands_out]
    said = [each for one in line.measured for each in one.diagnostics if each.is_error]
    for name in line.missing:
        codes = dict.fromkeys(each.code for each in said if each.parameter in {name, None})
        notes.append(f"no {name}" + (f" ({', '.join(codes)})" if codes else ""))
    if any(one.failure for one in line.measured):
        notes.append("recordings without a result")
    agreed = [name for name in PARAMETERS if line.repeats[name]]
    return "; ".join(notes) or (
        ("" if line.missing else "trusted")
        if not agreed
        else "repeats"
        if agreed == [*PARAMETERS]
        else f"{agreed[0]} repeats"
    )


def as_json(plan: Plan, found: Results) -> dict[str, Any]:
    """Return the JSON object of `hil campaign --json`, SI."""
    return {
        "schema": f"hil-{plan.kind}/1",
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
        **fingers.hand_json(fingers.motors(plan, found)),
    }


def _line_json(line: Line) -> dict[str, Any]:
    return {
        "joint": line.joint,
        "profile": line.profile,
        "pretension": line.pretension or None,
        "recordings": [str(one.run.path) for one in line.measured if one.values],
        "parameters": {
            name: {"value": one.value, "ci95": list(one.ci95), "unit": one.unit}
            for name, one in (dict(line.values) | dict(line.beside)).items()
        },
        "repeats": dict(line.repeats),
        "outlier": list(line.stands_out),
        "outliers": {
            name: {"ratio_to_median": line.values[name].value / one.median, "modified_z_score": one.score}
            for name, one in line.stands_out.items()
        },
    }


def write_results(plan: Plan, found: Results, command: str = "") -> Path:
    """Write the report into the plan's folder, for a hand also hand.json; return the path of the report."""
    if plan.hand is not None:
        with atomic_write(plan.folder / "hand.json", force=True) as temporary:
            temporary.write_text(json.dumps(as_json(plan, found), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return write_page(plan, found, plan.folder / "report.html", command)


def write_page(plan: Plan, found: Results, path: Path, command: str = "") -> Path:
    """Write the HTML report to `path` and return the path. A report of the same campaign is replaced."""
    rows = table(found)
    units = [unit for _, unit in _printed(found).values()]
    text = f"Kc in {units[0]} and Bc in {units[1]}: "
    at = rows[0].index("recordings") + 1
    named = zip(_names(found), rows[1:], strict=True)
    text += "; ".join(f"{name}: Kc {row[at]}, Bc {row[at + 1]}" for name, row in named)
    done = [one.run.path for line in found.lines for one in line.measured if one.values]
    page = Page(
        title=f"{plan.settings.name}: {verdict(found)}",
        subject=f"{plan.kind.capitalize()} {plan.settings.name}, {plan.path}",
        verdict=(verdict(found),),
        diagnostics=[*diagnostics(found), *_of_recordings(found)],
        sections=[
            Section("The hand, with 95 % intervals", rows),
            *fingers.sections(fingers.motors(plan, found)),
            *_recordings(found),
        ],
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


def _recordings(found: Results) -> Iterator[Section]:
    """Yield a section with the recordings of each line, which the page shows on a click."""
    for line in found.lines:
        rows = [["recording", *_headings(found), "failure"]]
        rows += [[one.run.path.name, *_cells(found, one), one.failure] for one in line.measured]
        yield Section(f"Recordings of {line.name}", rows)


def chart(found: Results) -> Chart:
    """Return Kc and Bc of every line with their intervals; the outliers are in another colour."""
    panels = []
    for name in PARAMETERS:
        factor, unit = _printed(found)[name]
        points: dict[bool, list[tuple[float, float, float]]] = {False: [], True: []}
        for at, line in enumerate(found.lines):
            if (value := line.values.get(name)) is not None:
                half = 0.5 * (value.ci95[1] - value.ci95[0]) * factor
                points[name in line.stands_out].append((at, value.value * factor, half))
        lines = [with_intervals(points[False]), with_intervals(points[True], "outlier", "error")]
        shown = lines if points[True] else lines[:1]
        panels.append(Panel("", f"{name} [{unit}]", shown, names=_names(found)))
    return Chart(panels)
