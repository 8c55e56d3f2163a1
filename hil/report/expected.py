"""`hil identify --expect Kc=17.75mN*m/rad:2%`: the values that a result must have, for an automatic check."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from hil.errors import WrongUse, decimal_comma
from hil.units import quantity

if TYPE_CHECKING:
    from hil.identification.result import Identification

_DIMENSIONS = {"Kc": "stiffness", "Bc": "damping"}


class Expected(NamedTuple):
    """The band, SI, in which the value of a parameter and its 95 % interval must lie. text: the expectation as the user
    wrote it.
    """

    name: str
    low: float
    high: float
    text: str


def expectation(text: str) -> Expected:
    """Return the band that NAME=VALUE:PERCENT% states. Raises WrongUse."""
    name, _, stated = text.partition("=")
    value, _, percent = stated.rpartition(":")
    try:
        middle, _ = quantity(value.strip(), _DIMENSIONS[name.strip()])
        share = float(percent.strip().removesuffix("%")) / 100.0
        if not (percent.strip().endswith("%") and 0.0 < share < 1.0 and middle > 0.0):
            raise ValueError
    except (KeyError, ValueError, WrongUse):
        form = ": write a parameter, its value and how far it may be off, as in Kc=17.75mN*m/rad:2%"
        raise WrongUse(f"--expect {text!r}{decimal_comma(text) or form}") from None
    return Expected(name.strip(), middle * (1.0 - share), middle * (1.0 + share), text)


def missed(found: Identification, expected: Sequence[Expected]) -> list[str]:
    """Return a sentence for each expectation that a result does not meet."""
    from hil.report.formatting import engineering

    said = []
    for one in expected:
        estimate = next((other for other in found.estimates if other.name == one.name), None)
        if estimate is None:
            said.append(f"--expect {one.text}: model {found.model.name} has no {one.name}")
            continue
        unit = estimate.unit.replace("*", " ")
        value, *ends = (engineering(number, unit, 4) for number in (estimate.value, *estimate.ci95))
        if not one.low <= estimate.value <= one.high:
            low, high = (engineering(number, unit, 4) for number in (one.low, one.high))
            said.append(f"--expect {one.text}: {one.name} is {value}, which is not within {low} to {high}")
        elif not (one.low <= estimate.ci95[0] and estimate.ci95[1] <= one.high):
            said.append(
                f"--expect {one.text}: the 95 % interval of {one.name}, {ends[0]} to {ends[1]}, is not inside: the "
                "recording does not determine it well enough; record longer or with a larger motion, or allow more"
            )
    return said
