"""What Kc and Bc mean for a controller, against a numerical solution of the loop and drawn values of Kc and Bc."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import hil as api
from ga.model.coupling import parse
from hil.diagnostics import Diagnostic
from hil.exchange.coupling import of_json
from hil.exchange.models import c_header
from hil.identification.result import Identification
from hil.report.controller import controller, controller_json, controller_line, controller_section

RATIO, INERTIA, DAMPING = 4.0, 5e-7, 1e-6
STAND = f"""[stand]
torque_source = "joint"
gear_ratio = {RATIO}
motor_inertia = {INERTIA}
motor_damping = {DAMPING}
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    stand, time = tmp_path_factory.mktemp("stand") / "stand.toml", np.arange(2000) / 500.0
    stand.write_text(STAND)
    dtheta = 0.2 * np.sin(8.2 * time) + 0.1 * np.sin(44.6 * time)
    torque = 0.02 * dtheta + 2e-4 * np.gradient(dtheta, time) + 1e-3 * np.random.default_rng(0).standard_normal(2000)
    return api.identify(time=time, dtheta=dtheta, torque=torque, stand=stand, model="linear", trials=1).identification


def margin(gain: float, found: Identification) -> tuple[float, float]:
    """Return phase margin, rad, and crossover frequency, Hz, of the loop, from its frequency response."""
    square = RATIO**2
    plant = signal.TransferFunction([gain], [square * INERTIA, found["Bc"].value + square * DAMPING, found["Kc"].value])
    rate = np.geomspace(1.0, 1e4, 400_001)
    _, response = signal.freqresp(plant, rate)
    last = np.flatnonzero(np.abs(response) >= 1.0)[-1]
    return math.pi + float(np.angle(response[last])), float(rate[last]) / (2.0 * math.pi)


@pytest.mark.parametrize("degrees", [20.0, 60.0, 90.0])
def test_the_stiffest_loop_has_the_stated_phase_margin(found: Identification, degrees: float) -> None:
    made = controller(found, math.radians(degrees))
    assert made is not None
    stiffness = made["loop_stiffness"].value
    phase, crossover = margin(stiffness, found)
    assert math.degrees(phase) == pytest.approx(degrees, abs=0.02)
    assert made["loop_bandwidth"].value == pytest.approx(crossover, rel=1e-3)
    assert margin(1.05 * stiffness, found)[0] < phase < margin(0.98 * stiffness, found)[0]


def test_resonance_and_damping_ratio_are_those_of_the_poles(found: Identification) -> None:
    made, square = controller(found), RATIO**2
    assert made is not None
    poles = np.roots([square * INERTIA, found["Bc"].value + square * DAMPING, found["Kc"].value])
    assert made["resonance_frequency"].value == pytest.approx(abs(poles[0]) / (2.0 * math.pi))
    assert made["damping_ratio"].value == pytest.approx(-poles[0].real / abs(poles[0]))
    assert made["corner_frequency"].value == pytest.approx(found["Kc"].value / (2.0 * math.pi * found["Bc"].value))


def test_the_intervals_are_those_of_drawn_stiffness_and_damping(found: Identification) -> None:
    alike = replace(found["Kc"], correlation={"Kc": 1.0, "Bc": 0.9})
    other = replace(found["Bc"], correlation={"Kc": 0.9, "Bc": 1.0})
    for one in (found, replace(found, estimates=(alike, other))):
        made, centre = controller(one), [one["Kc"].value, one["Bc"].value]
        drawn = np.random.default_rng(0).multivariate_normal(centre, one.covariance, size=400)
        several = []
        for kc, bc in drawn.tolist():
            exact = replace(alike, value=kc, ci95=(kc, kc)), replace(other, value=bc, ci95=(bc, bc))
            several.append(controller(replace(one, estimates=exact)))
        assert made is not None
        for quantity in made.quantities:
            values = [each[quantity.name].value for each in several if each is not None]
            low, high = quantity.ci95
            assert np.std(values) == pytest.approx((high - low) / 3.92, rel=0.12)


def test_what_may_not_be_trusted_or_is_not_known_gives_no_number(found: Identification) -> None:
    wrong = replace(found, diagnostics=(Diagnostic("misfit", "wrong", "Bc", is_error=True),))
    assert controller(wrong) is None
    assert controller_json(wrong) is None
    assert controller_section(wrong, milli=True).rows == ()
    assert "may not be trusted" in controller_line(wrong)
    unknown = controller(replace(found, signals=replace(found.signals, motor=(0.0, 0.0))))
    assert unknown is not None
    assert [one.name for one in unknown.quantities] == ["corner_frequency"]
    spans = replace(found, estimates=(replace(found["Kc"], depends_on="amplitude"), found["Bc"]))
    assert "Kc depends on the amplitude: the middle" in controller_line(spans)
    stiffening = replace(found, model=parse("linear+offset+cubic"))
    said = "Kc is its constant part, the factor of x in the model: tau = Kc*x + Bc*v + tau0 + K3*x^3"
    assert said in controller_line(stiffening)
    assert "Kc" not in controller_line(replace(found, model=parse("linear+offset+coulomb")))
    for angle in (0.0, 2.0, math.nan):
        with pytest.raises(api.WrongUse, match="give an angle above 0"):
            controller(found, angle)


def test_json_and_c_carry_the_numbers_with_their_intervals(found: Identification) -> None:
    table = api.IdentificationResult(found).as_json()
    made = controller(found)
    assert made is not None
    for one in made.quantities:
        assert table["controller"][one.name] == {"value": one.value, "unit": one.unit, "ci95": list(one.ci95)}
    text = c_header(of_json(table, "a.json"))
    low, high = made["loop_bandwidth"].ci95
    comment = f"/* Hz, 95 % interval {low:.6g} to {high:.6g} */"
    assert f"#define HIL_LOOP_BANDWIDTH {made['loop_bandwidth'].value!r} {comment}" in text
    assert of_json({**table, "controller": None}, "b.json").controller == {}
