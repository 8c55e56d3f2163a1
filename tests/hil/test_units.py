"""Units as people write them: many forms, one meaning, and none where the meaning is not certain."""

from __future__ import annotations

import math

import pytest

from hil.errors import WrongUse
from hil.units import factor, known, quantity

TABLES = {
    ("torque", "kgf*cm"): 0.0980665,
    ("torque", "gf*cm"): 9.80665e-5,
    ("torque", "ozf*in"): 0.00706155,
    ("angle", "deg"): 0.01745329,
    ("torque", "lbf*ft"): 1.3558179,
    ("torque", "N·m"): 1.0,
    ("torque", "N m"): 1.0,
    ("torque", "N*mm"): 1e-3,
    ("torque", "oz-in"): 0.00706155,
    ("torque", "kg*cm"): 0.0980665,
    ("angle", "°"): 0.01745329,
    ("angle", "turns"): 6.28318531,
    ("rate", "rpm"): 0.10471976,
    ("rate", "rad/sec"): 1.0,
    ("time", "us"): 1e-6,
    ("time", "µs"): 1e-6,
    ("time", "msec"): 1e-3,
}


def test_units_are_what_the_tables_of_physics_say() -> None:
    assert {one: factor(*one) for one in TABLES} == pytest.approx(TABLES, rel=1e-6)


FORMS = {
    ("torque", 1.0): "N*m|N m|Nm|N-m|N.m|N·m|N⋅m|newton meter|newton-metres|Newton Meters|nm|NM|N_m",
    ("torque", 1e-3): "mNm|mN m|mN*m|mN·m|N mm|Nmm|mnm|millinewton meter|mN_m",
    ("torque", 0.0980665): "kgf cm|kgfcm|kg-cm|kgcm|kg.cm|kgf_cm",
    ("torque", 0.1129848290276167): "in-lb|inlb|lbf·in|lb in|in-lbf",
    ("angle", math.pi / 180.0): "deg|degree|degrees|Degrees|DEG|Deg|degs|º|°",
    ("angle", 2.0 * math.pi): "rev|revs|revolutions|turn|cycles",
    ("rate", 1.0): "rad/s|rad/sec|radians per second|rad s^-1|rad s-1|rad·s⁻¹|rad.s-1|rad_s|rad_per_s|RAD/S|radps",
    ("rate", math.pi / 30.0): "rpm|RPM|rev/min|1/min|min^-1|r/min",
    ("rate", 2.0 * math.pi): "Hz|rev/s|rps|turns/s",
    ("time", 1e-3): "ms|msec|msecs|milliseconds|Milliseconds",
    ("time", 1.0): "s|S|sec|secs|seconds|SEC",
    ("stiffness", 1e-3): "mN*m/rad|mNm/rad|mN m rad^-1",
    ("stiffness", 0.18 / math.pi): "N*mm/deg|mNm/deg",
    ("damping", 1e-3): "mN*m*s/rad|mNms/rad|mN m s/rad|mNm/(rad/s)",
    ("inertia", 1e-7): "g*cm^2|gcm2|g cm²|g·cm**2",
    ("frequency", 0.5 / math.pi): "rad/s",
}


def test_every_form_of_a_unit_has_its_one_factor() -> None:
    for (dimension, si), forms in FORMS.items():
        units = forms.split("|")
        assert {unit: known(dimension, unit) for unit in units} == pytest.approx(dict.fromkeys(units, si), rel=1e-9)


@pytest.mark.parametrize(
    ("dimension", "unit"),
    [
        ("torque", "MNM"),  # milli or mega?
        ("torque", "mN*M"),
        ("torque", "J"),
        ("torque", "V"),
        ("torque", "N"),
        ("torque", "mNm/rad"),
        ("torque", "0.1 N*m"),
        ("angle", "%"),
        ("angle", "1"),
        ("angle", "counts"),
        ("angle", "rad/s"),
        ("angle", "deg^0"),
        ("angle", "grad"),  # German for degrees, and a four-hundredth of a turn
        ("rate", "1/s"),
        ("rate", "rad"),
        ("time", "MS"),
        ("time", "m"),
        ("time", ""),
        ("time", "s**99999999"),
        ("time", "h^0"),
        ("time", "(" * 30),
        ("time", "__import__('os')"),
        ("time", "s" * 100_000),
    ],
)
def test_what_is_no_certain_unit_of_the_dimension_is_none(dimension: str, unit: str) -> None:
    assert known(dimension, unit) is None
    with pytest.raises(WrongUse, match=f"unknown unit of {dimension}"):
        factor(dimension, unit)


@pytest.mark.parametrize(
    ("text", "dimensions", "value"),
    [
        ("10 deg", ("torque", "angle"), (math.pi / 18.0, "angle")),
        ("30mN*m", ("torque", "angle"), (0.03, "torque")),
        ("0.25", ("torque", "angle"), (0.25, None)),
        ("2 min", ("time",), (120.0, "time")),
        ("-1e-3 N m", ("torque",), (-1e-3, "torque")),
        ("60 degC", ("temperature",), (60.0, "temperature")),
        ("333.15 K", ("temperature",), (60.0, "temperature")),
    ],
)
def test_a_number_may_carry_its_unit(text: str, dimensions: tuple[str, ...], value: tuple[float, str | None]) -> None:
    number, dimension = quantity(text, *dimensions)
    assert number == pytest.approx(value[0])
    assert dimension == value[1]


@pytest.mark.parametrize(
    "text", ["", "x", "10 V", "10 %", "nan", "inf", "1e", "deg", "1 2 deg", "41e3411", "1e308 kN*m"]
)
def test_what_is_no_quantity_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(WrongUse, match=r"such as '10 mN\*m' or '10 mrad'|write '10 mN\*m' or '10 mrad'"):
        quantity(text, "torque", "angle")
