"""What turns behind an emulated CAN drive: the simulator's plant under a torque and, where asked, spring and damper.

The firmware's loop beats every millisecond where it regulates on what it measures; a plain torque needs no beat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim_backend.integrator import TIME, integrate, start
from sim_backend.parameters import (
    CouplingParameters,
    DriveParameters,
    FixtureParameters,
    LinkParameters,
    MotorParameters,
    SimParameters,
)
from sim_backend.plant import HOUSING, MOTOR, TORQUE, VELOCITY, Constants, constants, coupling_torque, packed

BEAT = 1e-3


def behind(scale: float, torque_constant: float, resistance: float, *, friction: bool = True) -> SimParameters:
    """The paper's joint with every torque `scale` times as large, driven without a gear.

    The motion is the paper's, so the same chirp suits it; stiffness, damping, inertias and friction are all scaled.
    torque_constant N m/A, resistance Ohm: the motor's. friction: whether the cable has dry friction.
    """
    paper, fixture = CouplingParameters(), FixtureParameters()
    return SimParameters(
        motor=MotorParameters(
            gear_ratio=1.0,
            inertia=3.2e-6 * scale,
            viscous_friction=1.6e-6 * scale,
            torque_constant=torque_constant,
            winding_resistance=resistance,
            winding_heat_capacity=60.0,
            winding_thermal_resistance=1.0,
            housing_heat_capacity=200.0,
            housing_thermal_resistance=3.0,
        ),
        coupling=CouplingParameters(
            stiffness=paper.stiffness * scale,
            damping=paper.damping * scale,
            coulomb_friction=paper.coulomb_friction * scale if friction else 0.0,
            bristle_stiffness=paper.bristle_stiffness * scale,
            bristle_damping=paper.bristle_damping * scale,
        ),
        fixture=FixtureParameters(
            stiffness=fixture.stiffness * scale, damping=fixture.damping * scale, inertia=fixture.inertia * scale
        ),
        drive=DriveParameters(torque_limit=scale),
        link=LinkParameters(lost_reply=0.0, jitter=0.0),
    )


@dataclass(frozen=True, slots=True)
class Law:
    """torque = feedforward + kp (position - measured) + kd (velocity - measured), no more than `ceiling` either way.

    N m, N m/rad, rad, N m s/rad, rad/s.
    """

    feedforward: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    ceiling: float = math.inf


class Motor:
    """Plant and torque law. Times are s since it was made; everything is at the output shaft."""

    def __init__(self, parameters: SimParameters) -> None:
        plant = constants(parameters)
        self._packed = packed(plant, Constants._fields)
        self._path = start(plant)
        self._law = Law()
        self.enabled = False
        self.run(0.0)  # no time passes; the machine code is there before the first frame comes

    @property
    def position(self) -> float:
        """rad."""
        return float(self._path.state[MOTOR])

    @property
    def velocity(self) -> float:
        """rad/s, filtered as the drive does."""
        return float(self._path.state[VELOCITY])

    @property
    def torque(self) -> float:
        """N m that the current makes."""
        return float(self._path.state[TORQUE])

    @property
    def demand(self) -> float:
        """N m asked of the current loop now; 0 while disabled."""
        return self._demand() if self.enabled else 0.0

    @property
    def temperature(self) -> float:
        """degC of the housing."""
        return float(self._path.state[HOUSING])

    @property
    def coupling_torque(self) -> float:
        """sigma_c, N m."""
        return float(coupling_torque(self._path.state, self._packed[0]))

    def warm_to(self, temperature: float) -> None:
        """Heat winding and housing to `temperature` degC at once."""
        self._path.state[HOUSING - 1] = self._path.state[HOUSING] = temperature

    def enable(self) -> None:
        """Let current flow."""
        self.enabled = True

    def disable(self) -> None:
        """No current from now on: the output stage is open."""
        self.enabled = False
        self._law = Law()
        self._path.state[TORQUE] = 0.0

    def follow(self, law: Law) -> None:
        """Take a torque law over."""
        self._law = law

    def run(self, until: float) -> None:
        """Carry the plant to `until`, s; nothing happens where that is past."""
        record = self._packed[0]
        while self.enabled and (self._law.kp or self._law.kd) and self._time < until:
            beat = (math.floor(self._time / BEAT + 1e-6) + 1.0) * BEAT
            integrate(self._path, self._demand(), min(beat, until), record)
        integrate(self._path, self._demand() if self.enabled else 0.0, until, record)

    @property
    def _time(self) -> float:
        return float(self._path.now[TIME])

    def _demand(self) -> float:
        law = self._law
        wanted = law.feedforward + law.kp * (law.position - self.position) + law.kd * (law.velocity - self.velocity)
        return max(-law.ceiling, min(law.ceiling, wanted))
