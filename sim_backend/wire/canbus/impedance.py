"""The law by which an emulated CAN drive computes its torque, and the joint that its motor turns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from sim_backend.parameters import (
    CouplingParameters,
    DriveParameters,
    FixtureParameters,
    LinkParameters,
    MotorParameters,
    SimParameters,
)
from sim_backend.wire.plant_motor import PlantMotor


def scaled_joint(scale: float, torque_constant: float, resistance: float, *, friction: bool = True) -> SimParameters:
    """Return the paper's joint with every torque multiplied by `scale`, driven without a gear.

    Stiffness, damping, inertias and friction are all scaled, so the motion is that of the paper's joint and the same
    chirp suits it. torque_constant: N m/A. resistance: Ohm, of the motor's winding. friction: whether the cable has dry
    friction.
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
class Impedance:
    """The demand law torque = feedforward + kp (position - measured) + kd (velocity - measured), with a magnitude of at
    most `ceiling`.

    feedforward, ceiling: N m. kp: N m/rad. kd: N m s/rad. position: rad. velocity: rad/s. fastest: rad/s, limit of the
    speed that position error and velocity command together, as in a cascade; it needs a kd.
    """

    feedforward: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    ceiling: float = math.inf
    fastest: float = math.inf

    def beats(self, enabled: bool) -> bool:
        """Return whether the torque depends on measurements, so that it must be computed again and again."""
        return enabled and bool(self.kp or self.kd)

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque at the motor's present position and velocity, N m."""
        if math.isinf(self.fastest):
            wanted = (
                self.feedforward
                + self.kp * (self.position - motor.position)
                + self.kd * (self.velocity - motor.velocity)
            )
        else:
            speed = self.velocity + self.kp / self.kd * (self.position - motor.position)
            bounded = max(-self.fastest, min(self.fastest, speed))
            wanted = self.feedforward + self.kd * (bounded - motor.velocity)
        return max(-self.ceiling, min(self.ceiling, wanted))

    def at_rest(self, _motor: PlantMotor[Any]) -> Impedance:
        """Return a law without torque."""
        return Impedance()


CanMotor = PlantMotor[Impedance]
