"""The report of many recordings in one HTML page: a table and a figure of Kc and Bc, and the fit of each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.diagnostics import Diagnostic
from hil.report.chart import Chart, Panel, with_intervals
from hil.report.formatting import Section, people_unit, rounded_with_value
from hil.report.html_page import Page, Picture, write
from hil.report.identification import headline, milli
from hil.report.identification_json import as_json
from hil.report.pictures.result import fit_pictures
from hil.report.provenance import provenance

if TYPE_CHECKING:
    from hil.identification.result import Estimate, Identification

PARAMETERS = ("Kc", "Bc")


@dataclass(frozen=True, slots=True)
class Entry:
    """One recording in the report.

    found: its identification, None if it failed. reason: why it failed. unusable: the JSON object of the failure.
    """

    path: Path
    found: Identification | None
    reason: str = ""
    unusable: Mapping[str, Any] | None = None

    @property
    def trusted(self) -> bool:
        """Return whether both Kc and Bc may be trusted."""
        return self.found is not None and all(map(self.found.trusted, PARAMETERS))

    def estimate(self, name: str) -> Estimate | None:
        """Return a parameter's estimate, None if the parameter was not identified."""
        estimates = () if self.found is None else self.found.estimates
        return next((one for one in estimates if one.name == name), None)


def write_page(entries: Sequence[Entry], path: Path, command: str = "", *, force: bool) -> Path:
    """Write the report of separately identified recordings to `path` and return the path. Raises WrongUse.

    command: the command line, for the report. force: replace an existing file.
    """
    good = [entry for entry in entries if entry.found is not None]
    names = ", ".join(entry.path.name for entry in entries)
    page = Page(
        title=f"{verdict(entries)}: {names}",
        subject=f"Identification of {len(entries)} recordings, each on its own",
        verdict=(verdict(entries),),
        diagnostics=_diagnostics(entries),
        sections=[Section("Kc and Bc, with 95 % intervals", table(entries))],
        pictures=[picture for at, entry in enumerate(good) for picture in _pictures(at, entry)],
        provenance=provenance([entry.path for entry in entries], command),
        table={"schema": "hil-identifications/1", "results": [_json(entry) for entry in entries]},
        failed=not good,
    )
    if len(good) > 1:
        headings, *rows = table(good)
        text = f"{headings[1]} and {headings[2]}. " + "; ".join(f"{row[0]}: {row[1]}, {row[2]}" for row in rows)
        together = Picture("together", "Kc and Bc of each recording", text, lambda: chart(good))
        page = replace(page, pictures=[together, *page.pictures])
    return write(page, path, force=force)


def verdict(entries: Sequence[Entry]) -> str:
    """Return in one line for how many of the recordings Kc and Bc can be trusted."""
    counts = [sum(entry.found is not None and entry.found.trusted(name) for entry in entries) for name in PARAMETERS]
    parts = " and ".join(f"{name} of {count}" for name, count in zip(PARAMETERS, counts, strict=True))
    return f"{len(entries)} recordings: {parts} can be trusted"


def table(entries: Sequence[Entry]) -> list[list[str]]:
    """Return a table with one row for each recording; the first row has the headings."""
    factor, units = _units(entries)
    rows = [["recording", f"Kc [{units[0]}]", f"Bc [{units[1]}]", "model", "state"]]
    for entry in entries:
        cells = [_cell(entry, name, factor) for name in PARAMETERS]
        rows.append([entry.path.name, *cells, "" if entry.found is None else entry.found.model.name, _state(entry)])
    return rows


def _units(entries: Sequence[Entry]) -> tuple[float, tuple[str, str]]:
    found = [entry.found for entry in entries if entry.trusted] or [entry.found for entry in entries]
    small = all(milli(one) for one in found if one is not None)  # a recording that went wrong chooses no unit
    factor, stiffness = people_unit("N*m/rad", milli=small)
    return factor, (stiffness, people_unit("N*m*s/rad", milli=small)[1])


def _cell(entry: Entry, name: str, factor: float) -> str:
    if entry.found is None or (estimate := entry.estimate(name)) is None:
        return "no result"
    text = " ± ".join(rounded_with_value(estimate.half_width * factor, estimate.value * factor))
    return text if entry.found.trusted(name) else f"{text} (not trusted)"


def _state(entry: Entry) -> str:
    if entry.found is None:
        return "no result"
    doubtful = [name for name in PARAMETERS if not entry.found.trusted(name)]
    return f"{' and '.join(doubtful)} cannot be trusted" if doubtful else "trusted"


def _diagnostics(entries: Sequence[Entry]) -> list[Diagnostic]:
    """Return the warnings and errors of all recordings, each with the recording's name."""
    found = []
    for entry in entries:
        own = [Diagnostic("unusable", entry.reason, is_error=True)] if entry.found is None else entry.found.diagnostics
        found += [replace(one, message=f"{entry.path.name}: {one.message}") for one in own]
    return found


def _pictures(at: int, entry: Entry) -> list[Picture]:
    """Return the pictures of a recording's fit. at: number of the recording, for the names of the pictures."""
    if entry.found is None:
        return []
    title = f"{entry.path.name}: {headline(entry.found)}"
    return [
        replace(one, name=f"r{at}-{one.name}", heading=f"{title}. {one.heading}") for one in fit_pictures(entry.found)
    ]


def chart(entries: Sequence[Entry]) -> Chart:
    """Return Kc and Bc over the recordings, with their intervals. Values that may not be trusted are listed and not
    drawn.
    """
    factor, units = _units(entries)
    panels = []
    for name, unit in zip(PARAMETERS, units, strict=True):
        good = [entry.found is not None and entry.found.trusted(name) for entry in entries]
        shown = [(at, one) for at, entry in enumerate(entries) if good[at] and (one := entry.estimate(name))]
        bad = {False: " (not trusted)", True: ""}
        names = [f"{entry.path.stem}{bad[known]}" for entry, known in zip(entries, good, strict=True)]
        line = with_intervals([(at, one.value * factor, one.half_width * factor) for at, one in shown])
        panels.append(Panel("", f"{name} [{unit}]", [line], names=names))
    return Chart(panels)


def _json(entry: Entry) -> dict[str, Any]:
    return dict(entry.unusable or {}) if entry.found is None else as_json(entry.found)
