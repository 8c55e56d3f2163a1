"""Conversion of units as people write them to SI: "mNm", "N·m", "oz-in", "deg/s", "rad s^-1"; and of numbers with a
unit, "10 deg".

The registry of `pint` has angle, energy and voltage as dimensions of their own: so a torque is not mistaken for an
energy, nor a percentage for an angle. A frequency is in turns per second, so that rad/s and Hz are converted into each
other correctly.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import islice, product
from types import MappingProxyType
from typing import TYPE_CHECKING

from hil.errors import WrongUse, decimal_comma, unknown

if TYPE_CHECKING:
    from pint import UnitRegistry

SI: Mapping[str, str] = MappingProxyType(
    {
        "time": "s",
        "torque": "N*m",
        "angle": "rad",
        "rate": "rad/s",
        "frequency": "Hz",
        "inertia": "kg*m^2",
        "stiffness": "N*m/rad",
        "damping": "N*m*s/rad",
        "temperature": "degC",
    }
)
"""The dimensions of a recording's channels, and the SI unit of each."""

LEVER: Mapping[str, str] = MappingProxyType({"mass": "kg", "length": "m"})
"""The dimensions, with SI units, of a load on a lever: a calibration needs them, no channel of a recording has them."""

DRIVES: Mapping[str, str] = MappingProxyType(
    {
        "torque constant": "N*m/A",
        "current": "A",
        "voltage": "V",
        "resistance": "ohm",
        "heat capacity": "J/K",
        "thermal resistance": "K/W",
        "temperature difference": "K",
        "cubic stiffness": "N*m/rad^3",
        "integral gain": "N*m/(rad*s)",
        "torque drift": "N*m/s",
    }
)
"""The dimensions, with SI units, that only parameters of a drive or of its simulation have."""

COMMON: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "time": ("s", "ms", "us", "ns", "min"),
        "torque": ("N*m", "mN*m", "uN*m", "N*cm", "N*mm", "kgf*m", "kgf*cm", "gf*cm", "ozf*in", "lbf*in", "lbf*ft"),
        "angle": ("rad", "mrad", "deg", "rev"),
        "rate": ("rad/s", "mrad/s", "deg/s", "rev/s", "rpm"),
        "frequency": ("Hz", "mHz", "kHz", "rad/s"),
        "inertia": ("kg*m^2", "g*cm^2", "kg*cm^2", "g*mm^2"),
        "stiffness": ("N*m/rad", "mN*m/rad", "mN*m/deg", "N*mm/deg"),
        "damping": ("N*m*s/rad", "mN*m*s/rad"),
        "temperature": ("degC", "K"),
        "mass": ("kg", "g", "mg", "lb", "oz"),
        "length": ("m", "mm", "cm", "in"),
        "torque constant": ("N*m/A", "mN*m/A"),
        "current": ("A", "mA"),
        "voltage": ("V", "mV"),
        "resistance": ("ohm", "mohm"),
        "heat capacity": ("J/K", "mJ/K"),
        "thermal resistance": ("K/W", "K/mW"),
        "temperature difference": ("K", "mK"),
        "cubic stiffness": ("N*m/rad^3", "mN*m/rad^3"),
        "integral gain": ("N*m/(rad*s)", "mN*m/(rad*s)"),
        "torque drift": ("N*m/s", "mN*m/s"),
    }
)
"""The units that a message proposes for each dimension."""

NO_UNIT = "1"
"""The text in files and JSON for the unit of a pure number."""

_ALL: Mapping[str, str] = MappingProxyType({**SI, **LEVER, **DRIVES})

_DEFINITIONS = """
kilo- = 1e3 = k-
centi- = 1e-2 = c-
milli- = 1e-3 = m-
micro- = 1e-6 = u- = µ- = μ-
nano- = 1e-9 = n-
meter = [length] = m = metre
second = [time] = s = sec
kilogram = [mass] = kg
radian = [angle] = rad
kelvin = [temperature] = K
degree_Celsius = kelvin; offset: 273.15 = degC = °C = celsius
gram = 1e-3 * kilogram = g
inch = 0.0254 * meter = in
foot = 12 * inch = ft = feet
pound = 0.45359237 * kilogram = lb = lbs
ounce = pound / 16 = oz
minute = 60 * second = min
hour = 60 * minute = h = hr
day = 24 * hour = d
degree = 0.017453292519943295 * radian = deg = °
arcminute = degree / 60 = arcmin
arcsecond = arcminute / 60 = arcsec
turn = 6.283185307179586 * radian = rev = revolution = rotation = cycle
hertz = turn / second = Hz
rpm = turn / minute
rps = turn / second
dps = degree / second
newton = kilogram * meter / second ** 2 = N
kilogram_force = 9.80665 * newton = kgf = kilopond = kp
gram_force = kilogram_force / 1000 = gf
pound_force = 0.45359237 * kilogram_force = lbf
ounce_force = pound_force / 16 = ozf
ampere = [current] = A
volt = [voltage] = V
ohm = volt / ampere = _ = Ohm
joule = [energy] = J
watt = joule / second = W
"""
_OTHER_NAMES = {"1/min": "rpm", "min-1": "rpm", "min^-1": "rpm", "r/min": "rpm", "U/min": "rpm"}
_STANDARD_GRAVITY = 9.80665  # m/s^2, exact by definition (CGPM 1901)
_WORD = re.compile(r"[A-Za-zµμ°]+")
_EXPONENT = re.compile(r"(?<=[A-Za-z])\s*(?:\^|\*\*)?\s*([-+]?\d)(?![\d.])")
_FACTOR = r"\(*[A-Za-zµμ°]+(?:\^\([-+]?\d\))?\)*"
_EXPRESSION = re.compile(rf"{_FACTOR}(?:[*/]{_FACTOR})*")  # no numbers: "0.1 deg" would be a scale, not a unit
_SPLIT_POWER = re.compile(r"\(([^()]*)\)\^(\([-+]?\d\))")  # the power of "kgm2" is that of its last part
_SIGNS = str.maketrans(
    {"⁻": "-", "⁰": "0", "¹": "1", "²": "2", "³": "3", "\u2212": "-", "º": "°", "˚": "°", "·": "*", "⋅": "*", "•": "*"}
    | dict.fromkeys("\u2219\u00d7\u30fb\uff65", "*")
)
_TIMED = re.compile(r"\b\w?s\b")
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
_LONGEST = 40  # characters of a unit; what is longer is no unit
_MOST_READINGS = 512  # of one text
_SHORT = 4  # letters: what is longer is a word, such as "milliseconds", which small letters do not change


def with_unit(number: str, unit: str) -> str:
    """Return a number with its unit as people read it: "3 N m/rad". A pure number (unit "1" or "") is printed alone."""
    read = printed(unit)
    return f"{number} {read}" if read else number


def printed(unit: str) -> str:
    """Return a unit as people read it: "N m/rad" for "N*m/rad", and "" for the unit of a pure number."""
    return "" if unit == NO_UNIT else unit.replace("*", " ")


def factor(dimension: str, unit: str) -> float:
    """Return the factor from `unit` to SI. Raises WrongUse for an unknown or ambiguous unit.

    dimension: one of SI, LEVER or DRIVES.
    """
    found = known(dimension, unit)
    if found is None:
        raise unknown(f"unit of {dimension}", unit, COMMON[dimension])
    return found


@lru_cache(maxsize=1024)
def known(dimension: str, unit: str) -> float | None:
    """Return the factor from `unit` to SI; None if the text is not a unit of the dimension, or can mean two different
    units.

    Case matters, because a capital letter is another prefix. Only a text entirely in small letters, or in capitals and
    without a prefix, is read without regard to case: "torque_mnm" and "TIME_S" are certain, "MNM" is not. Where a force
    is needed, a mass means its weight (kg*cm).
    """
    if not unit or len(unit) > _LONGEST:
        return None
    for expressions in (_readings(unit), _readings_in_other_case(unit)):
        factors = [found for one in expressions if (found := _factor(dimension, one)) is not None]
        if factors and math.isclose(min(factors), max(factors), rel_tol=1e-9):
            return factors[0]
        if factors:
            return None
    return None


def dimension_of(unit: str) -> str:
    """Return the dimension whose SI unit is `unit`."""
    return next(dimension for dimension, si in _ALL.items() if si == unit)


def quantity(text: str, *dimensions: str) -> tuple[float, str | None]:
    """Return the number in a text such as "10 deg" or "10", in SI, and its dimension, which is None if the text has no
    unit.

    dimensions: the allowed dimensions. Raises WrongUse for any other text.
    """
    if comma := decimal_comma(text):
        raise WrongUse(f"{text!r}{comma}")
    found = _QUANTITY.fullmatch(text)
    if found is None:
        raise WrongUse(f"{text!r} is not a number, nor a number with a unit such as {_example(dimensions)}")
    number, dimension = _in_si(text, float(found[1]), found[2], dimensions)
    if not math.isfinite(number):
        raise WrongUse(f"{text!r} is too large a number; write one such as {_example(dimensions)}")
    return number, dimension


def _in_si(text: str, number: float, unit: str, dimensions: tuple[str, ...]) -> tuple[float, str | None]:
    """Return the number in SI, and the first of `dimensions` that has the unit; the dimension is None if there is no
    unit.
    """
    if not unit:
        return number, None
    for dimension in dimensions:
        if dimension == "temperature" and unit in {"degC", "°C", "celsius"}:
            return number, dimension
        if (scale := known(dimension, unit)) is not None:
            return number * scale - (273.15 if dimension == "temperature" else 0.0), dimension
    raise WrongUse(f"{text!r}: {unit!r} is not a unit of {' or '.join(dimensions)}; write {_example(dimensions)}")


def _example(dimensions: tuple[str, ...]) -> str:
    return " or ".join(f"'{'40' if one == 'temperature' else '10'} {COMMON[one][1]}'" for one in dimensions[:2])


@lru_cache(maxsize=1)
def _registry() -> UnitRegistry:
    import pint

    registry: UnitRegistry = pint.UnitRegistry(None)
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


_NOT_PARSED = (
    TypeError,
    ValueError,
    SyntaxError,
    AttributeError,
    ArithmeticError,
    LookupError,
    RecursionError,
)  # of pint's parser, beside its own


def _factor(dimension: str, expression: str) -> float | None:
    """Return the factor from an expression that `pint` can parse to SI, None if the expression has another
    dimension.
    """
    import pint

    registry = _registry()
    try:
        unit, wanted = registry.Unit(expression), registry.Unit(_ALL[dimension].replace("^", "**"))
    except (pint.PintError, *_NOT_PARSED):
        return None
    weight = 1.0
    if unit.dimensionality != wanted.dimensionality and not _TIMED.search(expression):  # N*s*s is no mass on a lever
        unit, weight = unit * registry.meter / registry.second**2, _STANDARD_GRAVITY
    if unit.dimensionality != wanted.dimensionality:
        return None
    wanted = registry.kelvin if dimension == "temperature" else wanted
    scales = [float(str(registry.get_base_units(one)[0])) for one in (unit, wanted)]
    return weight * scales[0] / scales[1]


def _readings(unit: str) -> Iterator[str]:
    """Yield the possible meanings of a text, as expressions: "mN*m/rad" for "mNm/rad", "rad*s" and "rad/s" for
    "rad_s".
    """
    text = _plain(unit)
    joined = re.sub(r"(?<=[^\s*._/(-])[\s*._-]+(?=[^\s*._/)-])", "*", text)
    texts = [joined]
    if re.fullmatch(r"[^_/]+_[^_/]+", text):  # a heading cannot always have a slash: velocity_rad_s
        texts.append("/".join(text.split("_")))
    if compact := re.fullmatch(r"([a-z]+)p([a-z]+)", text):  # degps
        texts.append("/".join(compact.groups()))
    for one in texts:
        words, gaps = _WORD.findall(one), _WORD.split(one)
        for chosen in islice(product(*(_spellings(word) for word in words)), _MOST_READINGS):
            expression = gaps[0] + "".join(word + gap for word, gap in zip(chosen, gaps[1:], strict=True))
            expression = _SPLIT_POWER.sub(r"(\1^\2)", expression)
            if _EXPRESSION.fullmatch(expression) and expression.count("(") == expression.count(")"):
                yield expression.replace("^", "**")


def _plain(unit: str) -> str:
    """Return the text of a unit in ASCII, with / for "per" and a power written as in s^(-1)."""
    text = unit.strip().translate(_SIGNS)
    text = _OTHER_NAMES.get(text, text)
    text = re.sub(r"(?<![A-Za-z])per(?![A-Za-z])", "/", text)
    text = _EXPONENT.sub(r"^(\1)", text)
    return re.sub(r"[\s_]*/[\s_]*", "/", text)


def _readings_in_other_case(unit: str) -> Iterator[str]:
    """Yield the possible meanings of a text whose case cannot be trusted: in small letters, in capitals or "Like
    This".
    """
    if unit == unit.lower():
        yield from _readings(unit.replace("hz", "Hz"))
        for at in (match.start() for match in re.finditer("n", unit)):  # the newton of "mnm"
            yield from _readings(f"{unit[:at]}N{unit[at + 1 :]}")
    elif unit == unit.title() and len(unit) > _SHORT:
        yield from _readings(unit.lower())
    elif unit == unit.upper() or unit == unit.title():
        for small in (unit.lower(), unit.lower().replace("n", "N")):
            yield from (one for one in _readings(small) if not any(map(_prefixed, _WORD.findall(one))))


@lru_cache(maxsize=1024)
def _spellings(word: str) -> tuple[str, ...]:
    """Return the word if it is a unit. Otherwise return its two or three units joined with *: "oz*in" for "ozin"."""
    if _is_unit(word):
        return (word,)
    pairs = [
        f"({word[:at]}*{rest})"
        for at in range(1, len(word))
        if _is_unit(word[:at])
        for rest in ([word[at:]] if _is_unit(word[at:]) else _pairs(word[at:]))
    ]
    return tuple(pairs)


def _pairs(word: str) -> list[str]:
    return [f"{word[:at]}*{word[at:]}" for at in range(1, len(word)) if _is_unit(word[:at]) and _is_unit(word[at:])]


@lru_cache(maxsize=4096)
def _is_unit(word: str) -> bool:
    """Return whether `pint` knows the word. A plural "s" is accepted for names such as "meters", not for symbols."""
    found = _registry().parse_unit_name(word)
    return any(
        not plural or len(word) > _SHORT or word in {"degs", "rads", "revs", "secs", "mins"} for *_, plural in found
    )


def _prefixed(word: str) -> bool:
    return word in {"kg"} or all(prefix for prefix, *_ in _registry().parse_unit_name(word))
