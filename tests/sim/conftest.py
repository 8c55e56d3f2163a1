from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.clock import VirtualClock
from drivers.servo import Limits
from sim_backend.parameters import CouplingParameters, LinkParameters, SensorParameters, SimParameters
from sim_backend.servo import SimServo


@pytest.fixture
def limits() -> Limits:
    return Limits(torque=4e-3, velocity=400.0, temperature=80.0, position=(-3.0, 3.0))


@pytest.fixture
def servo() -> SimServo:
    """The servo the contract is held against: as it comes, imperfections and all."""
    return SimServo(SimParameters(), seed=1, clock=VirtualClock())


@pytest.fixture
def quiet() -> SimParameters:
    """A stand with perfect sensors and a perfect link, for a test to spoil in one place."""
    return SimParameters(
        sensors=SensorParameters(
            motor_counts=2**30,
            joint_counts=2**30,
            velocity_lsb=1e-9,
            current_lsb=1e-12,
            motor_torque_noise=0.0,
            torque_cell_noise=0.0,
            torque_cell_offset=0.0,
            torque_cell_drift=0.0,
            torque_cell_lsb=1e-12,
            motor_torque_delay=0.0,
            joint_position_delay=0.0,
            joint_torque_delay=0.0,
            temperature_lsb=1e-9,
        ),
        link=LinkParameters(jitter=0.0, lost_reply=0.0),
    )


@pytest.fixture
def frictionless(quiet: SimParameters) -> SimParameters:
    return replace(quiet, coupling=CouplingParameters(coulomb_friction=0.0))
