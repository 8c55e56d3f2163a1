"""What turns: the simulator's plant under a servo's own firmware, in the servo's operating modes.

The firmware beats every millisecond. Its loops are not ROBOTIS's, whose gains are in units of their own: current is
what is asked for, and position and velocity are closed with gains from the inertia, at the bandwidth below. In PWM
mode the stall torque is right, kt V/R, and the speed without load is not, since the inertia is not a real gearbox's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_backend.integrator import TIME, integrate, start
from sim_backend.parameters import CouplingParameters, LinkParameters, MotorParameters, SimParameters
from sim_backend.plant import (
    HOUSING,
    MOTOR,
    MOTOR_RATE,
    TORQUE,
    VELOCITY,
    Constants,
    constants,
    coupling_torque,
    packed,
)
from sim_backend.wire.dynamixel.tables import CURRENT, CURRENT_POSITION, POSITION, PWM, SPEED, DynamixelModel

BEAT = 1e-3
COUNT = 2.0 * math.pi / 4096.0
"""rad a count of position."""
BANDWIDTH = 2.0 * math.pi * 10.0
"""rad/s of the position loop."""


def behind(model: DynamixelModel, coupling: CouplingParameters | None = None) -> SimParameters:
    """A plant for a servo that drives the joint directly: eta is 1, and motor and gearbox are the servo's own.

    coupling: the cable, the paper's joint where None. The inertia at the horn is the default motor's at its joint, so
    that the resonance is the same; it is far below that of a real gearbox.
    """
    volts, amperes, torque = model.stall
    motor = MotorParameters(
        gear_ratio=1.0,
        inertia=3.2e-6,
        viscous_friction=1.6e-6,
        torque_constant=torque / amperes,
        winding_resistance=volts / amperes,
    )
    return SimParameters(
        motor=motor, coupling=coupling or CouplingParameters(), link=LinkParameters(lost_reply=0.0, jitter=0.0)
    )


@dataclass(frozen=True, slots=True)
class Goals:
    """What the control table asks of the motor.

    current A (the ceiling in mode 5), velocity rad/s, position rad over any number of turns, duty -1 to 1.
    """

    mode: int = POSITION
    current: float = 0.0
    velocity: float = 0.0
    position: float = 0.0
    duty: float = 0.0


class DynamixelMotor:
    """Plant and regulators of one servo. Times are s since it was made; everything is at the horn."""

    def __init__(self, model: DynamixelModel, parameters: SimParameters) -> None:
        self._plant = constants(parameters)
        self._packed = packed(self._plant, Constants._fields)
        self._path = start(self._plant)
        volts, amperes, torque = model.stall
        self.torque_constant = torque / amperes
        self._stall_torque = torque
        self._supply = volts
        self._resistance = volts / amperes
        self._integral = 0.0
        self.enabled = False
        self.goals = Goals()
        self.run(0.0)  # no time passes; the machine code is there before the first instruction comes

    @property
    def time(self) -> float:
        """How far it has been carried, s."""
        return float(self._path.now[TIME])

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
    def current(self) -> float:
        """A in the winding."""
        return self.torque / self.torque_constant

    @property
    def duty(self) -> float:
        """Share of the supply voltage that is across the motor, -1 to 1."""
        volts = self.current * self._resistance + self.torque_constant * float(self._path.state[MOTOR_RATE])
        return max(-1.0, min(1.0, volts / self._supply))

    @property
    def temperature(self) -> float:
        """degC of the housing, where the servo's sensor is."""
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
        self._integral = 0.0
        self.enabled = True

    def disable(self) -> None:
        """No current from now on: the output stage is open."""
        self.enabled = False
        self._path.state[TORQUE] = 0.0

    def run(self, until: float) -> None:
        """Carry plant and firmware to `until`, s; nothing happens where that is past."""
        constants_ = self._packed[0]
        while self.enabled and self.time < until:
            beat = (math.floor(self.time / BEAT + 1e-6) + 1.0) * BEAT
            integrate(self._path, self._demand(), min(beat, until), constants_)
        integrate(self._path, 0.0, until, constants_)

    def _demand(self) -> float:
        """The torque asked of the current loop in this beat, N m."""
        goals, kt = self.goals, self.torque_constant
        if goals.mode == CURRENT:
            return float(np.clip(goals.current * kt, -self._stall_torque, self._stall_torque))
        if goals.mode == PWM:
            # the back-EMF brakes; stronger than this it would overshoot within a beat on so light a motor
            braking = min(kt**2 / self._resistance, 0.5 * self._plant.inertia / BEAT)
            return kt * goals.duty * self._supply / self._resistance - braking * float(self._path.state[MOTOR_RATE])
        ceiling = abs(goals.current) * kt if goals.mode == CURRENT_POSITION else self._stall_torque
        inertia = self._plant.inertia
        if goals.mode == SPEED:
            error, stiffness, damping = goals.velocity - self.velocity, 0.0, inertia * BANDWIDTH
            wanted = damping * error + self._integral
            growth = damping * BANDWIDTH * error * BEAT
        else:
            error = goals.position - round(self.position / COUNT) * COUNT
            stiffness, damping = inertia * BANDWIDTH**2, 1.4 * inertia * BANDWIDTH
            wanted = stiffness * error - damping * self.velocity + self._integral
            growth = 0.5 * stiffness * BANDWIDTH * error * BEAT
        if abs(wanted) <= ceiling:
            self._integral += growth
        return max(-ceiling, min(ceiling, wanted))
