"""Format numbers and tables for printing, and make the parts that all JSON objects have in common."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hil import units
from hil.diagnostics import Diagnostic
from hil.signals.constants import UNCERTAIN

if TYPE_CHECKING:
    from hil.recording.channels import TorqueScale

_PLAIN = (1e-3, 1e4)  # numbers between which no power is needed
_PREFIXES = {-9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M"}


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a result, the same for the terminal, a page and a notebook: a heading, a table and lines below it.

    rows: of the table; the first row has the headings. apart: how many of the last rows stand apart from the others.
    """

    heading: str
    rows: Sequence[Sequence[str]] = ()
    lines: Sequence[str] = ()
    apart: int = 0


def people_unit(unit: str, *, milli: bool) -> tuple[float, str]:
    """Return the factor from SI to the printed unit of a parameter, and the printed unit: ms for times; mN m if
    `milli`.

    The unit of a pure number is "".
    """
    if unit == "s":
        return 1e3, "ms"
    if milli and unit.startswith("N*m"):
        return 1e3, units.printed("m" + unit)
    return 1.0, units.printed(unit)


def capitalised(title: str) -> str:
    """Return a title with a capital first letter; the other letters stay, because units and names are among them."""
    return title[:1].upper() + title[1:]


def engineering(value: float, unit: str, digits: int = 3) -> str:
    """Return a value with an engineering prefix: "4.02 ms" for 0.00402 s."""
    rounded = float(f"{value:.{digits}g}")
    exponent = 0 if rounded == 0.0 or not math.isfinite(rounded) else 3 * math.floor(math.log10(abs(rounded)) / 3.0)
    exponent = min(max(exponent, min(_PREFIXES)), max(_PREFIXES))
    return f"{rounded / 10.0**exponent:.6g} {_PREFIXES[exponent]}{unit}"


def duration(seconds: float) -> str:
    """Return a duration as people read it: "20 s", "5 min", "5.6 h"."""
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.4g} s"


def rounded(half: float, *values: float, digits: int = 1) -> list[str]:
    """Return the values and, as the last text, `half`, all rounded to the first digit of `half`, or to its first two.

    half: half width of the interval of the values. digits: of `half`.
    """
    if not (math.isfinite(half) and half > 0.0):
        return [f"{value:.5g}" for value in (*values, half)]
    decimals = -math.floor(math.log10(float(f"{half:.{digits - 1}e}"))) + digits - 1
    return [f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}" for value in (*values, half)]  # without "-0"


def rounded_with_value(half: float, value: float) -> list[str]:
    """Return a value and half its interval, rounded to the first digit of `half`, or to its first two if the interval
    is wide: 2.48 ± 0.97, not 2 ± 1.
    """
    return rounded(half, value, digits=2 if half > UNCERTAIN * abs(value) else 1)


def rounded_in_thousands(half: float, *values: float) -> list[str]:
    """Return the values and `half` as texts, rounded to the first digit of `half`. Small or large values have a common
    power of a thousand: 18.91e-6 and 0.09e-6.
    """
    largest = max((abs(value) for value in (*values, half) if math.isfinite(value)), default=0.0)
    if not (math.isfinite(half) and half > 0.0) or _PLAIN[0] <= largest < _PLAIN[1]:
        return rounded(half, *values)
    exponent = 3 * math.floor(math.log10(largest) / 3.0)
    found = rounded(half / 10.0**exponent, *(value / 10.0**exponent for value in values))
    return [one if one in {"0", "nan"} else f"{one}e{exponent}" for one in found]


def json_number(value: float) -> float | None:
    """Return the value, None if it is not finite, because JSON has no infinite numbers and no NaN."""
    return value if math.isfinite(value) else None


def diagnostics_json(diagnostics: Iterable[Diagnostic]) -> dict[str, list[dict[str, str | None]]]:
    """Return the diagnostics as the two lists "warnings" and "errors" of a JSON object."""
    found: dict[str, list[dict[str, str | None]]] = {"warnings": [], "errors": []}
    for one in diagnostics:
        found["errors" if one.is_error else "warnings"].append(one.as_json())
    return found


def scale_line(scale: TorqueScale, without: str = "") -> str:
    """Return a line about the uncertainty of the torque's scale; "" if the scale is exact, or nothing is known of it.

    without: the result with the intervals that it has if the scale is exact.
    """
    if scale.included:
        return f"torque scale: {scale.source}, {100.0 * scale.included:.3g} % (standard uncertainty){without}"
    if not math.isnan(scale.uncertainty) or not scale.source:
        return ""
    return (
        f"torque scale: neither {scale.source} nor the stand file states an uncertainty, so the scale counts as exact: "
        "give torque_uncertainty in [stand]"
    )


def scale_json(scale: TorqueScale) -> dict[str, Any]:
    """Return the entry "torque_scale" of a JSON object: the relative standard uncertainty, null if not known, and its
    source.
    """
    return {"uncertainty": json_number(scale.uncertainty), "source": scale.source}
