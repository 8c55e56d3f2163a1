"""Numbers as they are printed."""

from __future__ import annotations

import math

import pytest

from hil.report.formatting import duration, engineering, people_unit, rounded, rounded_in_thousands, rounded_with_value
from hil.units import with_unit


@pytest.mark.parametrize(
    ("seconds", "printed"), [(0.49, "0.49 s"), (20.0, "20 s"), (119.0, "119 s"), (300.0, "5 min"), (19998.0, "5.55 h")]
)
def test_a_duration_has_a_unit_of_its_size(seconds: float, printed: str) -> None:
    assert duration(seconds) == printed


@pytest.mark.parametrize("milli", [False, True])
def test_a_pure_number_has_no_unit(*, milli: bool) -> None:
    assert people_unit("1", milli=milli) == (1.0, "")
    assert with_unit("0.18", "1") == with_unit("0.18", "") == "0.18"
    assert with_unit("3", "N*m*s/rad") == "3 N m s/rad"


@pytest.mark.parametrize(
    ("value", "unit", "printed"),
    [
        (0.00402, "s", "4.02 ms"),
        (9.996e-4, "s", "1 ms"),
        (-2.5e-6, "rad", "-2.5 urad"),
        (1500.0, "Hz", "1.5 kHz"),
        (0.0, "s", "0 s"),
        (3e-15, "N m", "3e-06 nN m"),
        (math.inf, "s", "inf s"),
    ],
)
def test_a_value_has_an_engineering_prefix(value: float, unit: str, printed: str) -> None:
    assert engineering(value, unit) == printed


@pytest.mark.parametrize(
    ("half", "value", "printed"),
    [
        (0.0163, 17.7754, ["17.78", "0.02"]),
        (0.096, 17.7754, ["17.8", "0.1"]),
        (230.0, 17775.0, ["17800", "200"]),
        (0.0, 1 / 3, ["0.33333", "0"]),
        (math.inf, 1 / 3, ["0.33333", "inf"]),
        (0.1, -0.02, ["0.0", "0.1"]),
        (2.0, math.nan, ["nan", "2"]),
    ],
)
def test_a_value_is_rounded_to_the_first_digit_of_its_uncertainty(
    half: float, value: float, printed: list[str]
) -> None:
    assert rounded(half, value) == printed


def test_a_value_with_a_wide_interval_keeps_two_digits_of_it() -> None:
    assert [rounded_with_value(*pair)[1] for pair in ((0.97, 2.484), (0.0163, 17.78))] == ["0.97", "0.02"]


@pytest.mark.parametrize(
    ("half", "value", "printed"),
    [
        (9.2e-8, 1.891e-5, ["18.91e-6", "0.09e-6"]),
        (1e-4, 1e-5, ["0", "100e-6"]),
        (3700.0, 10400.0, ["10e3", "4e3"]),
        (0.0163, 17.7754, ["17.78", "0.02"]),
        (0.0, 1e-5, ["1e-05", "0"]),
    ],
)
def test_a_small_or_large_value_has_a_power_of_a_thousand(half: float, value: float, printed: list[str]) -> None:
    assert rounded_in_thousands(half, value) == printed


def test_delays_are_printed_in_milliseconds_on_any_joint() -> None:
    assert people_unit("s", milli=False) == people_unit("s", milli=True) == (1e3, "ms")
