"""The noise of the deflection in the result of `hil identify`, as a line of text and as JSON."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from hil.report.formatting import engineering, json_number

if TYPE_CHECKING:
    from hil.identification.result import Deflection

_METHODS = {"instruments": "the command as an instrument", "simulation": "a simulation of the noise"}


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


def deflection_lines(one: Deflection | None) -> list[str]:
    """Return a line about the noise of the deflection and its correction; an empty list if the noise has no effect."""
    if one is None:
        return []
    passed = "" if one.low_pass is None else f", before a low-pass of {one.low_pass:.3g} Hz"
    noise = f"the deflection has noise of {engineering(one.noise, 'rad', 2)}{passed}"
    if one.method == "none":
        left = ", ".join(f"{name} {100.0 * size:+.1g} %" for name, size in one.predicted.items())
        return [f"{noise}; the rest does not matter ({left})"]
    before = ", ".join(f"{name} {100.0 * size:+.2g} %" for name, size in one.before.items() if isfinite(size))
    return [f"{noise}; Kc and Bc are corrected with {_METHODS[one.method]} (before: {before})"]
