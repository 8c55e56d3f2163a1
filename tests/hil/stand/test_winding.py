"""The model of a locked rotor's winding, against closed forms and an independent solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from hil.errors import WrongUse
from hil.stand.file import parse
from hil.stand.winding import Temperatures, WindingModel, WindingTable

NAMEPLATE = {
    "torque_constant": 0.0145,
    "resistance": 8.7,
    "thermal_resistance": 5.0,
    "time_constant": 7.0,
    "case_thermal_resistance": 20.0,
    "case_time_constant": 400.0,
}
MEASURED = {"continuous_torque": 0.002, "peak_torque": 0.006, "peak_time": 20.0}
LIMIT = 80.0
sizes = st.floats(0.1, 10.0)


def solved(model: WindingModel, state: Temperatures, square: float, seconds: float) -> Temperatures:
    def rates(_: float, now: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[float]:
        (r1, c1), (r2, c2) = model.winding, model.case
        power = model.heat * square * (1.0 + model.copper * (now[0] - 20.0))
        return [(power - (now[0] - now[1]) / r1) / c1, ((now[0] - now[1]) / r1 - (now[1] - model.air) / r2) / c2]

    end = solve_ivp(rates, (0.0, seconds), state, rtol=1e-9, atol=1e-9, method="LSODA").y[:, -1]
    return Temperatures(float(end[0]), float(end[1]))


@given(st.tuples(sizes, sizes), st.tuples(sizes, st.floats(1.0, 100.0)), st.floats(0.0, 2.0), st.floats(0.01, 300.0))
def test_a_step_of_any_length_is_exact_for_constant_power(
    winding: tuple[float, float], case: tuple[float, float], square: float, seconds: float
) -> None:
    model = WindingModel(3.0, 0.0, winding, case, 25.0)
    begin = Temperatures(60.0, 40.0)
    assert model.after(begin, square, seconds) == pytest.approx(solved(model, begin, square, seconds), abs=1e-4)


def test_short_steps_follow_copper_whose_resistance_grows() -> None:
    model = WindingTable(**NAMEPLATE).model(LIMIT)
    state, square = model.cold, 0.008**2
    for _ in range(3000):
        state = model.after(state, square, 0.1)
    expected = solved(model, model.cold, square, 300.0)
    assert expected.winding > 60.0
    assert state == pytest.approx(expected, rel=2e-3)


def test_a_long_rest_leaves_the_temperature_of_the_air() -> None:
    model = WindingTable(**NAMEPLATE).model(LIMIT)
    assert model.after(Temperatures(200.0, 90.0), 0.0, 1e7) == pytest.approx(model.cold)


def test_the_two_measured_points_are_met() -> None:
    model = WindingTable(**MEASURED).model(LIMIT)
    assert model.after(model.cold, 0.002**2, 1e5).winding == pytest.approx(LIMIT, abs=0.01)
    assert model.after(model.cold, 0.006**2, 20.0).winding == pytest.approx(LIMIT, abs=0.01)
    half = model.air + (LIMIT - model.air) * 9.0 * (1.0 - math.sqrt(8.0 / 9.0))  # closed form at half the time
    assert model.after(model.cold, 0.006**2, 10.0).winding == pytest.approx(half, abs=0.01)


@pytest.mark.parametrize(
    "table",
    [
        {},
        {"torque_constant": 0.01},
        NAMEPLATE | MEASURED,
        MEASURED | {"peak_torque": 0.001},
        MEASURED | {"peak_time": math.inf},
        NAMEPLATE | {"resistance": -1.0},
    ],
)
def test_a_table_that_is_no_motor_is_refused(table: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        WindingTable(**table)


def test_the_stand_file_names_what_is_missing() -> None:
    with pytest.raises(WrongUse, match=r"give either torque_constant, resistance.* or the measured continuous_torque"):
        parse('[stand]\nbackend = "sim"\n[winding]\nresistance = 2.0\n')
