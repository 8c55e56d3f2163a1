"""Units that people write, as factors to SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from difflib import get_close_matches
from types import MappingProxyType

from hil.errors import WrongUse

_STANDARD_GRAVITY = 9.80665  # m/s^2, exact by definition (CGPM 1901)
_POUND = 0.45359237  # kg, exact
_INCH = 0.0254  # m, exact

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
        "torque": {
            "N*m": 1.0,
            "mN*m": 1e-3,
            "uN*m": 1e-6,
            "N*cm": 1e-2,
            "kgf*cm": _STANDARD_GRAVITY * 1e-2,
            "gf*cm": _STANDARD_GRAVITY * 1e-5,
            "ozf*in": _POUND / 16.0 * _STANDARD_GRAVITY * _INCH,
            "lbf*in": _POUND * _STANDARD_GRAVITY * _INCH,
        },
        "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
        "rate": {
            "rad/s": 1.0,
            "mrad/s": 1e-3,
            "deg/s": math.pi / 180.0,
            "rev/s": 2.0 * math.pi,
            "rpm": math.pi / 30.0,
        },
    }
)


def factor(dimension: str, unit: str) -> float:
    """What a number in `unit` is multiplied by to be in SI.

    dimension: "time", "torque", "angle" or "rate". Raises WrongUse for a unit that is not in the table.
    """
    table = UNITS[dimension]
    if unit in table:
        return table[unit]
    near = get_close_matches(unit, table, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise WrongUse(f"unknown unit of {dimension} {unit!r}: {hint}known are {', '.join(table)}")
