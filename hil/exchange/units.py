"""Units in options and table headings, as factors to SI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from difflib import get_close_matches
from types import MappingProxyType

from hil.errors import WrongUse

_STANDARD_GRAVITY = 9.80665  # m/s^2, exact by definition (CGPM 1901)
_POUND = 0.45359237  # kg, exact
_INCH = 0.0254  # m, exact
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi}

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
        "torque": {
            "N*m": 1.0,
            "mN*m": 1e-3,
            "uN*m": 1e-6,
            "N*cm": 1e-2,
            "N*mm": 1e-3,
            "kgf*m": _STANDARD_GRAVITY,
            "kgf*cm": _STANDARD_GRAVITY * 1e-2,
            "gf*cm": _STANDARD_GRAVITY * 1e-5,
            "ozf*in": _POUND / 16.0 * _STANDARD_GRAVITY * _INCH,
            "lbf*in": _POUND * _STANDARD_GRAVITY * _INCH,
            "lbf*ft": _POUND * _STANDARD_GRAVITY * _INCH * 12.0,
        },
        "angle": _ANGLES,
        "rate": {f"{unit}/s": factor for unit, factor in _ANGLES.items()} | {"rpm": math.pi / 30.0},
    }
)

_SPELLINGS: Mapping[str, str] = MappingProxyType(
    {
        "µs": "us",
        "kgfcm": "kgf*cm",
        "kgcm": "kgf*cm",
        "gcm": "gf*cm",
        "ozin": "ozf*in",
        "lbin": "lbf*in",
        "inlb": "lbf*in",
        "lbft": "lbf*ft",
        "ftlb": "lbf*ft",
        "radians": "rad",
        "degrees": "deg",
        "°": "deg",
        "turns": "rev",
        "turn": "rev",
        "rotations": "rev",
        "°/s": "deg/s",
        "dps": "deg/s",
        "Hz": "rev/s",
        "turns/s": "rev/s",
        "turn/s": "rev/s",
        "1/min": "rpm",
    }
)
"""Other names of the units above, without the signs between the letters."""


def canonical(dimension: str, unit: str) -> str | None:
    """Return the table's name of a unit, however its factors are joined ("Nm", "N m", "N·m", "N.m"); None: unknown.

    Case matters: a capital letter is another prefix.
    """
    table = UNITS[dimension]
    squeezed = _squeeze(unit)
    for name in table:
        if _squeeze(name) == squeezed:
            return name
    spelled = _SPELLINGS.get(squeezed)
    return spelled if spelled in table else None


def _squeeze(unit: str) -> str:
    joined = re.sub(r"[\s*.·⋅_-]", "", unit.replace("μ", "µ").replace("µN", "uN"))  # Greek mu is not the micro sign
    return re.sub(r"sec(onds)?$", "s", joined)


def factor(dimension: str, unit: str) -> float:
    """Return the factor from `unit` to SI.

    dimension: "time", "torque", "angle" or "rate". Raises WrongUse for an unknown unit.
    """
    name = canonical(dimension, unit)
    table = UNITS[dimension]
    if name is not None:
        return table[name]
    near = get_close_matches(unit, table, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise WrongUse(f"unknown unit of {dimension} {unit!r}: {hint}known are {', '.join(table)}")


def split(title: str) -> tuple[str, str | None]:
    """Return a heading's name and unit: "tau [mN m]" and "tau (mN m)" both have mN m; None where there is none."""
    match = re.fullmatch(r"\s*(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*", title)
    if match is None or not match[1]:
        return title.strip(), None
    return match[1], (match[2] if match[2] is not None else match[3]).strip()


def suffix(dimension: str, title: str) -> str | None:
    """Return the unit at the end of a name such as "torque_mNm" or "angle_deg"; None where the end is no unit."""
    _, line, last = title.rpartition("_")
    return canonical(dimension, last) if line and last else None
