"""The result of `hil hysteresis` as tables, a JSON object, a chart and a page. Nothing is printed here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.hysteresis_curve.measures import UNITS, Measures, Spread
from hil.report.chart import Chart, Line, Panel
from hil.report.formatting import engineering, json_number, plain_table
from hil.report.html_page import Page, Picture, Section, table_rows, write
from hil.report.provenance import provenance

if TYPE_CHECKING:
    from rich.table import Table

SCHEMA = "hil-hysteresis/1"
NO_DAMPING = "Bc cannot come from this: in a slow test friction gives the same loop. Record a chirp for Bc"


def headline(found: Measures) -> str:
    """Return the loading stiffness in the last part of the torque's range, in one line."""
    one, (low, high) = found.loading, found.parts[-1]
    several = f" ({one.low:.4g} to {one.high:.4g} in {one.count} recordings)" if one.count > 1 else ""
    return f"loading stiffness {one.mean:.4g} N m/rad{several}, from {_torque(low)} to {_torque(high)}; no Bc from this"


def tables(found: Measures) -> list[Table]:
    """Return the tables of stiffness, and of lost motion, hysteresis, play and loss."""
    spread = ("mean", "smallest to largest", "number", "s of cycles", "s of recordings")
    stiffness = [
        (f"{branch}, {direction}", f"{low:.3g} to {high:.3g}", *_cells(one))
        for (branch, direction, (low, high)), one in sorted(found.stiffness.items(), key=lambda item: item[0][2])
    ]
    names = {"lost_motion": f"lost motion at +-{_torque(found.at)}", "hysteresis": "hysteresis at 0 N m"}
    loops = [(names.get(name, name), *_cells(one), UNITS[name]) for name, one in found.loops.items()]
    made = [plain_table("stiffness, N m/rad", ("", "part, N m", *spread), stiffness)]
    return [*made, plain_table("loops", ("", *spread, ""), loops)] if loops else made


def _torque(value: float) -> str:
    return engineering(value, "N m")


def _cells(one: Spread) -> list[str]:
    spreads = [f"{value:.2g}" if math.isfinite(value) else "" for value in (one.cycles, one.recordings)]
    return [f"{one.mean:.4g}", f"{one.low:.4g} to {one.high:.4g}", str(one.count), *spreads]


def as_json(found: Measures) -> dict[str, Any]:
    """Return the JSON object of `hil hysteresis --json`, in SI; an unknown value is null."""
    return {
        "schema": SCHEMA,
        "recordings": [one.name for one in found.tests],
        "rated_torque": found.rated,
        "parts": [list(part) for part in found.parts],
        "lost_motion_at": found.at,
        "loading_stiffness": {**_spread(found.loading, "N*m/rad"), "by_recording": dict(found.by_recording)},
        "stiffness": [
            {"branch": branch, "direction": direction, "part": list(part), **_spread(one, UNITS["stiffness"])}
            for (branch, direction, part), one in sorted(found.stiffness.items())
        ],
        **{name: _spread(one, UNITS[name]) for name, one in found.loops.items()},
        "damping": None,
        "note": NO_DAMPING,
    }


def _spread(one: Spread, unit: str) -> dict[str, Any]:
    return {
        "value": one.mean,
        "unit": unit,
        "smallest": one.low,
        "largest": one.high,
        "number": one.count,
        "sd_cycles": json_number(one.cycles),
        "sd_recordings": json_number(one.recordings),
    }


def chart(found: Measures) -> Chart:
    """Return a chart of the loops, torque over angle, with the ends of the last part as dashed lines."""
    colours = ("first", "good", "error", "soft", "ink")
    loops = [
        Line(Path(one.name).name, one.angle - one.angle[0], one.torque, colours[at % len(colours)])
        for at, one in enumerate(found.tests)
    ]
    ends = np.array([min(one.x.min() for one in loops), max(one.x.max() for one in loops)])
    parts = [
        Line("", ends, np.full(2, sign * torque), "soft", width=0.5, dashed=True)
        for sign in (1.0, -1.0)
        for torque in found.parts[-1]
    ]
    return Chart([Panel("angle from the first reading [rad]", "torque [N m]", [*loops, *parts])])


def write_page(found: Measures, paths: Sequence[Path], path: Path, command: str = "", *, force: bool) -> Path:
    """Write the HTML report to `path` and return the path. command: the command line, for the report. Raises
    WrongUse.
    """
    answer = headline(found)
    page = Page(
        title=f"{', '.join(one.name for one in paths)}: {answer}",
        subject=f"Hysteresis of {', '.join(map(str, paths))}",
        verdict=(answer, NO_DAMPING),
        diagnostics=(),
        sections=[Section(f"{table.title}".capitalize(), table_rows(table)) for table in tables(found)],
        pictures=[Picture("loops", "Torque over angle", f"The loops. {answer}", lambda: chart(found))],
        provenance=provenance([one for one in paths if one.suffix in {".h5", ".part"}], command),
        table=as_json(found),
    )
    return write(page, path, force=force)
