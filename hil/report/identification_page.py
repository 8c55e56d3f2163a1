"""The HTML report of `hil identify`, also for recordings from which nothing could be identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.recording.channels import units_of
from hil.recording.interval import named
from hil.recording.reader import Recording
from hil.report.controller import constant_part_line, controller_section
from hil.report.formatting import Section, capitalised
from hil.report.html_page import Page, Picture, write
from hil.report.identification import (
    bands_section,
    equation,
    estimates_section,
    headline,
    identification_lines,
    meaning,
    milli,
    model_selection_section,
    optimum_lines,
    repeatability_section,
    verdicts,
)
from hil.report.identification_json import as_json
from hil.report.lack_of_fit import lack_of_fit_line
from hil.report.pictures.recording import recording_chart
from hil.report.pictures.result import pictures
from hil.report.provenance import provenance

if TYPE_CHECKING:
    from hil.identification.result import Identification

_MOST = 4_000_000  # rows of a recording that are drawn although nothing came of it


def write_page(found: Identification, path: Path, command: str = "", *, force: bool) -> Path:
    """Write the report of a result to `path` and return the path. command: the command line, for the report. Raises
    WrongUse.
    """
    names = ", ".join(map(named, found.recordings, found.windows))
    answer = headline(found)
    page = Page(
        title=f"{', '.join(recording.name for recording in found.recordings)}: {answer}",
        subject=f"Identification of {names}",
        verdict=verdicts(found),
        diagnostics=found.diagnostics,
        sections=_sections(found),
        pictures=pictures(found),
        provenance=provenance(found.recordings, command),
        table=as_json(found),
    )
    return write(page, path, force=force)


def _sections(found: Identification) -> list[Section]:
    meanings = {one.name: one.meaning for one in (*found.model.linear, *found.model.nonlinear)}
    headings, *numbers = estimates_section(found).rows
    rows = [[*row, meanings.get(one.name, "")] for row, one in zip(numbers, found.estimates, strict=True)]
    model = (f"model: {meaning(found.model)}", equation(found.model))
    fit = lack_of_fit_line(found.lack_of_fit) if found.lack_of_fit else ""
    lines = [*filter(None, (*model, constant_part_line(found), fit)), *identification_lines(found)]
    sections = [Section("Numbers, with 95 % intervals", [[*headings, "meaning"], *rows], lines)]
    others = [controller_section(found, milli=milli(found))]
    others += [model_selection_section(found)] if found.steps else []
    sections += [replace(one, heading=capitalised(one.heading)) for one in others]
    if bands := bands_section(found):
        sections.append(Section("Dynamic stiffness", bands.rows, [bands.heading.partition(", ")[2]]))
    text = f"{len(found.trials.fitness)} independent trials. This is how well the search repeats, and no uncertainty."
    lines = [text, *optimum_lines(found)]
    return [*sections, Section("Optimiser repeatability", repeatability_section(found).rows, lines)]


def write_failure(
    reason: str, recordings: Sequence[Path], table: Mapping[str, Any], path: Path, command: str = "", *, force: bool
) -> Path:
    """Write a report for recordings from which nothing could be identified: `reason`, and pictures of the recordings.
    Raises WrongUse.

    table: the command's JSON object. command: the command line, for the report. force: replace an existing file.
    """
    names = ", ".join(str(recording) for recording in recordings)
    page = Page(
        title=f"{', '.join(recording.name for recording in recordings)}: no result",
        subject=f"Identification of {names}",
        verdict=("Kc and Bc: no result",),
        diagnostics=[Diagnostic("unusable", reason, is_error=True)],
        sections=[],
        pictures=[picture for at, recording in enumerate(recordings) for picture in _seen(at, recording)],
        provenance=provenance(recordings, command),
        table=table,
        failed=True,
    )
    return write(page, path, force=force)


def _seen(at: int, path: Path) -> list[Picture]:
    """Return the picture of a recording, as far as the recording can be read."""
    with suppress(WrongUse, Untrustworthy), Recording(path) as recording:
        if not 1 < len(recording) <= _MOST:
            return []
        channels = {name: recording.channel(name) for name in ("time", "command", "torque", "dtheta")}
        units = units_of(recording.profile.get("mode", "torque"))
        text = f"Command, torque and deflection of {path} over {len(recording)} samples, and torque over deflection."
        return [Picture(f"recording{at}", f"The recording {path.name}", text, lambda: recording_chart(channels, units))]
    return []
