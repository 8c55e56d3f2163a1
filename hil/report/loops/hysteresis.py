"""The result of `hil hysteresis` as tables, a JSON object, a chart and a page. Nothing is printed here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.hysteresis_curve.measures import UNITS, Measures, Spread
from hil.report.chart import Chart, Line, Panel
from hil.report.formatting import Section, capitalised, json_number, people_unit, scale_json, scale_line
from hil.report.html_page import Page, Picture, write
from hil.report.provenance import provenance

if TYPE_CHECKING:
    from hil.recording.channels import TorqueScale

SCHEMA = "hil-hysteresis/1"
NO_DAMPING = "Bc cannot come from this: in a slow test friction gives the same loop. Record a chirp for Bc"


def answers(found: Measures) -> list[str]:
    """Return a line with the loading stiffness in the last part of the torque's range, and one with the measures of the
    loops, if there are loops.
    """
    one, (low, high) = found.loading, found.parts[-1]
    (factor, unit), (size, torque) = _unit(found, "N*m/rad"), _unit(found, "N*m")
    several = f" ({_range(one, factor)} in {one.count} recordings)" if one.count > 1 else ""
    stiffness = f"loading stiffness {factor * one.mean:.4g} {unit}{several} from {_span(low, high, size)} {torque}"
    loops = [f"{name} {of * spread.mean:.4g} {unit}" for name, spread, of, unit in _loops(found)]
    return [stiffness, *filter(None, [", ".join(loops)])]


def tables(found: Measures) -> list[Section]:
    """Return the tables of lost motion, hysteresis, play and loss, if there are loops, and of the stiffness."""
    spread = ("mean", "smallest to largest", "number", "s of cycles", "s of recordings")
    (factor, unit), (size, torque) = _unit(found, "N*m/rad"), _unit(found, "N*m")
    stiffness = [
        (f"{branch}, {direction}", _span(low, high, size), *_cells(one, factor))
        for (branch, direction, (low, high)), one in sorted(found.stiffness.items(), key=lambda item: item[0][2])
    ]
    loops = [(name, *_cells(one, of), unit) for name, one, of, unit in _loops(found)]
    made = [Section("lost motion, play, hysteresis, loss", [("", *spread, ""), *loops])] if loops else []
    return [*made, Section(f"stiffness, {unit}", [("", f"part, {torque}", *spread), *stiffness])]


def _loops(found: Measures) -> list[tuple[str, Spread, float, str]]:
    """Return each measure of the loops in words, with the factor from SI to its printed unit, and the printed unit."""
    factor, unit = _unit(found, "N*m")
    names = {
        "lost_motion": f"lost motion at ±{factor * found.at:.3g} {unit}",
        "play": "play",
        "hysteresis": f"hysteresis at 0 {unit}",
        "loss": "loss",
    }
    known = {name: text for name, text in names.items() if name in found.loops}
    return [(text, found.loops[name], *_unit(found, UNITS[name])) for name, text in known.items()]


def _unit(found: Measures, unit: str) -> tuple[float, str]:
    """Return the factor from SI to the printed unit, and the printed unit: all torques of a page have one prefix."""
    if unit in {"rad", "J"}:
        return 1e3, f"m{unit}"
    return people_unit(unit, milli=found.rated < 1.0)


def _span(low: float, high: float, factor: float) -> str:
    return f"{factor * low:.3g} to {factor * high:.3g}"


def _range(one: Spread, factor: float) -> str:
    return f"{factor * one.low:.4g} to {factor * one.high:.4g}"


def _cells(one: Spread, factor: float) -> list[str]:
    sizes = (factor * one.cycles, factor * one.recordings)
    spreads = [f"{float(f'{size:.2g}'):g}" if math.isfinite(size) else "" for size in sizes]
    return [f"{factor * one.mean:.4g}", _range(one, factor), str(one.count), *spreads]


def as_json(found: Measures, scale: TorqueScale) -> dict[str, Any]:
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
        "torque_scale": scale_json(scale),
        "damping": None,
        "note": NO_DAMPING,
        "warnings": _warnings(found),
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
    factor, unit = _unit(found, "N*m")
    loops = [
        Line(Path(one.name).name, one.angle - one.angle[0], factor * one.torque, colours[at % len(colours)])
        for at, one in enumerate(found.tests)
    ]
    ends = np.array([min(one.x.min() for one in loops), max(one.x.max() for one in loops)])
    parts = [
        Line("", ends, np.full(2, sign * factor * torque), "soft", width=0.5, dashed=True)
        for sign in (1.0, -1.0)
        for torque in found.parts[-1]
    ]
    return Chart([Panel("angle from the first reading [rad]", f"torque [{unit}]", [*loops, *parts])])


def _warnings(found: Measures) -> list[str]:
    if "lost_motion" not in found.loops or found.noise <= found.at:
        return []
    factor, unit = _unit(found, "N*m")
    return [
        f"the torque's noise is {factor * found.noise:.3g} {unit} (standard deviation), more than the "
        f"{factor * found.at:.3g} {unit} at which lost motion is read. It hides part of a gap: lost motion and "
        "hysteresis may be half of what they are. Average several readings of the torque, or read lost motion at a "
        "larger torque with --lost-motion"
    ]


def marked(found: Measures) -> list[str]:
    """Return the warnings, as lines below the answer."""
    return [f"warning: {one}" for one in _warnings(found)]


def notes(scale: TorqueScale) -> list[str]:
    """Return the lines below the tables: what the numbers do not contain."""
    line = scale_line(scale, ", to which every stiffness is proportional; it is not in these numbers")
    return [NO_DAMPING, *filter(None, [line])]


def write_page(
    found: Measures, scale: TorqueScale, paths: Sequence[Path], path: Path, command: str = "", *, force: bool
) -> Path:
    """Write the HTML report to `path` and return the path. command: the command line, for the report. Raises
    WrongUse.
    """
    said = answers(found)
    shown = [replace(one, heading=capitalised(one.heading)) for one in tables(found)]
    shown[-1] = replace(shown[-1], lines=notes(scale))
    page = Page(
        title=f"{', '.join(one.name for one in paths)}: {said[0]}",
        subject=f"Hysteresis of {', '.join(map(str, paths))}",
        verdict=(*said, *marked(found)),
        diagnostics=(),
        sections=shown,
        pictures=[Picture("loops", "Torque over angle", f"The loops: {'; '.join(said)}.", lambda: chart(found))],
        provenance=provenance([one for one in paths if one.suffix in {".h5", ".part"}], command),
        table=as_json(found, scale),
        unfolded=len(shown),
    )
    return write(page, path, force=force)
