"""Predicted errors against closed forms, and against the spread of exact fits to many made readings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.servo import Quantity
from ga.lad.exact import least_absolute_deviations
from hil.acquisition import excitation
from hil.experiment_design.fisher import Prediction, Readings, mistaken_friction, predict
from hil.experiment_design.response import Joint, Response, respond
from hil.signals.rate.savitzky_golay import local_polynomial
from hil.signals.rate.spectrum import excited_band
from hil.signals.rate.windows import windows

Array = NDArray[np.float64]

RATE = 250.0
JOINT = Joint(stiffness=0.02, damping=2e-4, inertia=3e-6, friction=1e-6)
CELL = Readings(torque_noise=2e-4, torque_lsb=0.0, angle_lsb=1e-5, skew=0.0, motor_side=False)


def moved(kind: str = "chirp", quantity: Quantity = Quantity.POSITION, duration: float = 4.0) -> Response:
    band = (0.5, 10.0) if kind == "chirp" else (2.0, 2.0)
    amplitude = 0.3 if quantity is Quantity.POSITION else 0.005
    profile = excitation.make(
        kind, quantity, amplitude=amplitude, default_amplitude=1.0, duration=duration, band=band, rate=RATE, fade=0.2
    )
    return respond(JOINT, profile, RATE)[0]


def predicted(terms: tuple[str, ...], motion: Response, readings: Readings) -> dict[str, Prediction]:
    return {parameter.name: parameter for parameter in predict(terms, JOINT, motion, readings)}


def test_in_white_noise_the_bound_is_the_textbooks_and_absolute_deviations_cost_the_root_of_half_pi() -> None:
    motion = moved()
    columns = np.stack([motion.dtheta, motion.dtheta_dot], axis=1)
    textbook = 2e-4 * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    found = predicted(("linear",), motion, CELL)
    assert [found["Kc"].bound, found["Bc"].bound] == pytest.approx(textbook, rel=1e-3)
    assert found["Bc"].error / found["Bc"].bound == pytest.approx(math.sqrt(math.pi / 2.0), rel=0.03)


def test_four_times_the_time_halves_the_errors() -> None:
    short, long = (predicted(("linear",), moved(duration=time), CELL) for time in (4.0, 16.0))
    assert short["Kc"].error / long["Kc"].error == pytest.approx(2.0, rel=0.05)


def test_a_late_torque_reading_is_predicted_to_be_taken_for_less_damping() -> None:
    """Kc of the deflection `skew` ago is Kc dtheta - Kc skew dtheta_dot."""
    late = predicted(("linear",), moved("sine"), replace(CELL, skew=1e-3))
    assert late["Bc"].bias == pytest.approx(-0.02 * 1e-3, rel=0.03)
    freed = predicted(("linear", "skew"), moved(), replace(CELL, skew=1e-3))
    assert abs(freed["Bc"].bias) < 0.15 * 0.02 * 1e-3
    assert freed["skew"].rough == 1e-3


def test_a_skew_beside_an_inertia_is_not_told_and_neither_is_the_damping() -> None:
    found = predicted(("linear", "skew", "inertia"), moved(), CELL)
    assert math.isfinite(found["Kc"].error)
    assert [found[name].error for name in ("Bc", "skew", "J")] == [math.inf] * 3


def test_dry_friction_is_told_from_damping_by_a_sweep_and_hardly_by_one_speed() -> None:
    terms = ("linear", "coulomb")
    swept, single = (predicted(terms, moved(kind), CELL)["Bc"].inflation for kind in ("chirp", "sine"))
    assert swept < 0.5 * single
    assert mistaken_friction(terms, JOINT, moved()) == 0.0
    speed = 0.3 * 4.0 * math.pi
    # a square wave's share in the sine of its own period is 4/pi
    assert mistaken_friction(("linear",), JOINT, moved("sine")) == pytest.approx(4.0 / math.pi / speed, rel=0.08)


def spread(columns: Array, clean: Array, noise: list[Array]) -> Array:
    """The standard deviation (p,) of the exact fits to `clean` under each of the noises."""
    genes = np.array([least_absolute_deviations(columns, clean + one).genes for one in noise])
    return np.asarray(genes.std(axis=0, ddof=1))


@pytest.mark.parametrize("lsb", [0.0, 6e-4], ids=["fine counts", "counts of three sigma"])
def test_the_predicted_error_is_the_spread_of_many_fits(lsb: float) -> None:
    motion, rng = moved(), np.random.default_rng(1)
    columns = np.stack([motion.dtheta, motion.dtheta_dot], axis=1)
    clean = columns @ [0.02, 2e-4]

    def read() -> Array:
        seen = clean + rng.normal(scale=2e-4, size=clean.size)
        if not lsb:
            return np.asarray(seen - clean)
        shift = rng.uniform()  # where the counts lie is no part of the motion
        return np.asarray((np.round(seen / lsb + shift) - shift) * lsb - clean)

    found = spread(columns, clean, [read() for _ in range(300)])
    made = predicted(("linear",), motion, replace(CELL, torque_lsb=lsb))
    # rounding to counts above the noise is not quite white, and that is to the good
    assert found == pytest.approx([made["Kc"].error, made["Bc"].error], rel=0.22 if lsb else 0.15)


def test_the_error_is_predicted_where_a_skew_that_the_model_lacks_stands_above_the_noise() -> None:
    motion, rng = moved(), np.random.default_rng(2)
    readings = replace(CELL, torque_noise=5e-5, skew=8e-3)
    columns = np.stack([motion.dtheta, motion.dtheta_dot], axis=1)
    aged = columns @ [0.02, 2e-4] - 8e-3 * (0.02 * motion.dtheta_dot + 2e-4 * motion.acceleration)
    found = spread(columns, aged, [rng.normal(scale=5e-5, size=aged.size) for _ in range(300)])
    made = predicted(("linear",), motion, readings)
    assert found == pytest.approx([made["Kc"].error, made["Bc"].error], rel=0.25)
    assert made["Kc"].error > 1.5 * predicted(("linear",), motion, replace(readings, skew=0.0))["Kc"].error


def test_torque_from_the_motors_side_is_predicted_without_what_the_motor_takes() -> None:
    motion, rng = moved(quantity=Quantity.POSITION), np.random.default_rng(3)
    readings = replace(CELL, motor_side=True)
    slope, curvature = windows(motion.time, excited_band(motion.time, motion.dtheta)[1])
    rate = local_polynomial(motion.time, motion.dtheta, slope, 1)
    acceleration = local_polynomial(motion.time, motion.dtheta, curvature, 2)

    def torque(noise: Array) -> Array:
        return np.asarray(motion.drive + noise - JOINT.inertia * acceleration - JOINT.friction * rate)

    still = torque(np.zeros_like(rate))
    noises = [torque(rng.normal(scale=2e-4, size=rate.size)) - still for _ in range(200)]
    found = spread(np.stack([motion.dtheta, rate], axis=1), still, noises)
    made = predicted(("linear",), motion, readings)
    assert found == pytest.approx([made["Kc"].error, made["Bc"].error], rel=0.15)
    assert made["Kc"].error / made["Kc"].bound == pytest.approx(np.sqrt(np.pi / 2.0), rel=0.05)
