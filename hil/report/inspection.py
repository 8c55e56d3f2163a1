"""The summary of a recording as a table and as a JSON object."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.recording.interval import named
from hil.report.formatting import Section, diagnostics_json, engineering, json_number

if TYPE_CHECKING:
    from hil.signals.inspection import Inspection

_SEEN = 1e-6  # s; nothing is late in virtual time but for rounding
SCHEMA = "hil-inspection/2"
"""The name and version of the JSON object. In version 1 the errors were in the list of warnings."""


def inspection_section(seen: Inspection) -> Section:
    """Return the summary of a recording as a table without headings."""
    rows = {
        "samples": f"{seen.samples} over {seen.duration:.3g} s",
        "rate": f"{seen.rate:.5g} Hz, 99 % of intervals within {engineering(seen.jitter, 's')} of it",
        "lost, NaN, late": f"{seen.lost}, {seen.not_numbers}, {seen.late}; longest gap "
        f"{engineering(seen.longest_gap, 's')}",
        "saturated": f"{seen.saturated} rows",
        "deflection": f"{engineering(seen.deflection, 'rad', 4)} peak to peak, smallest step "
        f"{engineering(seen.deflection_lsb, 'rad', 2)}",
        "torque": f"{engineering(seen.torque, 'N m', 4)} peak to peak, from {seen.torque_from}",
        "torque noise": f"{engineering(seen.torque_noise, 'N m')}; signal to noise {seen.snr:.0f} dB",
        "excited band": f"{seen.band[0]:.3g} to {seen.band[1]:.3g} Hz (99 % of the rate's power)",
        "rate from": f"a local polynomial over {engineering(seen.rate_window, 's')}"
        if seen.rate_window
        else "the file",
    }
    if seen.lateness[2] > _SEEN:
        median, most, largest = (engineering(value, "s", 2) for value in seen.lateness)
        rows["lateness"] = f"median {median}, 99 % within {most}, largest {largest}; {seen.missed} ticks missed"
    if seen.calibrated:
        rows["calibrated"] = ", ".join(f"{name} {date[:10]}" for name, date in seen.calibrated.items())
    heading = f"{named(seen.path, seen.window)}: {seen.kind}, {seen.end_reason}"
    return Section(heading, [("", ""), *rows.items()])


def as_json(seen: Inspection) -> dict[str, Any]:
    """Return the JSON object of `hil inspect --json`, SI units."""
    plain = {name: getattr(seen, name) for name in seen.__slots__ if name not in {"path", "diagnostics"}}
    plain["snr"] = json_number(seen.snr)
    plain["lateness"] = [json_number(value) for value in seen.lateness]
    return {
        "schema": SCHEMA,
        "recording": str(seen.path),
        "usable": seen.usable,
        **plain,
        **diagnostics_json(seen.diagnostics),
    }
