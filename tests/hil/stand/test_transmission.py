"""The way from motor to joint, against equation (1) written out."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.servo import Quantity
from hil.stand.file import LimitsTable, StandTable
from hil.stand.transmission import Transmission, Zero

STAND = StandTable(gear_ratio=4.0, motor_inertia=2e-5, motor_damping=1e-5)


def test_the_coupling_torque_is_that_of_equation_1() -> None:
    way = Transmission.of(STAND)
    motor_torque, velocity, acceleration = np.array([0.01, -0.02]), np.array([3.0, -1.0]), np.array([50.0, 20.0])
    coupling = 4.0 * (motor_torque - 2e-5 * acceleration - 1e-5 * velocity)
    share = way.motor_share(way.rate(velocity), acceleration / 4.0)
    np.testing.assert_allclose(way.torque(motor_torque) - share, coupling, rtol=1e-14)


def test_the_deflection_counts_from_the_zero_of_motor_and_joint() -> None:
    way, zero = Transmission.of(STAND), Zero(motor=2.0, joint=-0.5)
    assert way.deflection(2.0, -0.5, zero) == 0.0
    assert way.deflection(2.8, -0.4, zero) == pytest.approx(0.8 / 4.0 - 0.1)


@pytest.mark.parametrize(("mode", "expected"), [(Quantity.TORQUE, 0.0015), (Quantity.POSITION, 7.024)])
def test_a_set_point_at_the_joint_becomes_a_command_at_the_motor(mode: Quantity, expected: float) -> None:
    command = Transmission.of(STAND).commands(mode, Zero(7.0))(0.006)
    assert command.quantity is mode
    assert command.value == pytest.approx(expected)


def test_limits_at_the_joint_become_limits_around_the_rest_of_the_motor() -> None:
    limits = Transmission.of(STAND).motor_limits(LimitsTable(torque=0.5, deflection=0.1, velocity=3.0), zero=1.0)
    assert (limits.torque, limits.velocity, limits.temperature) == (0.125, 12.0, 70.0)
    assert limits.position == pytest.approx((0.6, 1.4))
