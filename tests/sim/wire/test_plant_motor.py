"""The motor of an emulated drive under demand laws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from sim_backend.parameters import FixtureParameters
from sim_backend.wire.canbus.impedance import CanMotor, Impedance
from sim_backend.wire.default_joint import fitting_joint, scaled_joint
from sim_backend.wire.mit.device import KD_MOST, KP_MOST
from sim_backend.wire.mit.tables import MODELS as MIT
from sim_backend.wire.robstride.tables import MODELS as ROBSTRIDE


@pytest.mark.parametrize(
    "law",
    [
        Impedance(math.nan, ceiling=1.0),
        Impedance(math.inf, ceiling=1.0),
        Impedance(1.0, ceiling=math.nan),
        Impedance(kp=math.nan, ceiling=1.0),
        Impedance(kp=1.0, kd=1.0, position=math.nan, ceiling=1.0, fastest=1.0),
    ],
)
def test_a_set_point_that_is_not_finite_gives_no_torque(law: Impedance) -> None:
    motor = CanMotor(fitting_joint(1.0, 0.05, 0.1), Impedance())
    motor.enable()
    motor.follow(law)
    motor.run(0.01)
    assert motor.commanded == 0.0
    assert motor.rate == 0.0


ALL: list[tuple[str, Any, float, float]] = [(name, model, KP_MOST, KD_MOST) for name, model in MIT.items()]
ALL += [(name, model, *model.span[2:]) for name, model in ROBSTRIDE.items()]


def scale_of(model: Any) -> float:
    """Torque at the joint of a model over that at the paper's joint."""
    return 10.0 * float(model.span[2 if len(model.span) == 3 else 1])


def closed_form(model: Any, law: Impedance, times: np.ndarray) -> np.ndarray:
    """Angles of the motor, rad, after a law begins at rest: the linear equations of rotor, joint and current loop."""
    fixture, scale, j, lag = FixtureParameters(), scale_of(model), model.inertia, 1.0 / (2.0 * math.pi * 1000.0)
    k, b, drag = 17.75e-3 * scale, 0.19e-3 * scale, 1.6e-6 * scale
    ground = np.array([fixture.stiffness, fixture.damping, fixture.inertia]) * scale
    a = np.zeros((6, 6))  # angle, rate, joint's angle, joint's rate, torque, one
    a[0, 1] = a[2, 3] = 1.0
    a[1] = np.array([-k, -b - drag, k, b, 1.0, 0.0]) / j
    a[3] = np.array([k, b, -k - ground[0], -b - ground[1], 0.0, 0.0]) / ground[2]
    a[4] = np.array([-law.kp, -law.kd - law.kp * lag, 0.0, 0.0, -1.0, law.feedforward + law.kp * law.position]) / lag
    return np.array([(expm(a * t) @ [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])[0] for t in times])


@pytest.mark.parametrize(("name", "model", "kp", "kd"), ALL, ids=[row[0] for row in ALL])
@pytest.mark.parametrize("share", [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0), (0.04, 0.2), (0.5, 0.02)])
def test_every_gain_moves_the_motor_as_the_closed_form_says(
    name: str, model: Any, kp: float, kd: float, share: tuple[float, float]
) -> None:
    law = Impedance(1e-4 * scale_of(model), share[0] * kp, share[1] * kd, 1e-4)
    joint = scaled_joint(
        scale_of(model), model.torque_constant, model.resistance, friction=False, inertia=model.inertia
    )
    motor, times = CanMotor(joint, Impedance()), np.linspace(0.0, 0.05, 26)[1:]
    motor.enable()
    motor.follow(law)
    angles = []
    for t in times:
        motor.run(float(t))
        angles.append(motor.position)
    wanted = closed_form(model, law, times)
    assert np.max(np.abs(angles - wanted)) < 0.01 * np.max(np.abs(wanted)), name


def test_the_gains_of_openarm_hold_the_target() -> None:
    model = MIT["dm-j8009"]
    joint = fitting_joint(model.span[2], model.torque_constant, model.resistance, inertia=model.inertia)
    motor = CanMotor(joint, Impedance())
    motor.enable()
    motor.follow(Impedance(kp=240.0, kd=5.0, position=0.1, ceiling=model.span[2]))
    motor.run(1.0)
    assert abs(motor.torque) < 0.1 * model.span[2]
    assert motor.position == pytest.approx(0.1 * 240.0 / (240.0 + 0.4 * model.span[2]), rel=0.02)
