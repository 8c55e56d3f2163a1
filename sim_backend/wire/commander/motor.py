"""What turns behind an emulated SimpleFOC board: the simulator's plant under the library's motion modes.

The library's velocity and angle gains are its user's own; here the loops are closed with gains from the inertia, at
the bandwidth below, a beat a millisecond. Torque needs no beat; the current loop is the plant's.
"""

from __future__ import annotations

import math

from sim_backend.integrator import TIME, integrate, start
from sim_backend.parameters import SimParameters
from sim_backend.plant import MOTOR, TORQUE, VELOCITY, Constants, constants, coupling_torque, packed
from sim_backend.sensors import counted
from sim_backend.wire.loadcell.joint_torque import JointTorque

TORQUE_MODE, VELOCITY_MODE, ANGLE_MODE = range(3)
BEAT = 1e-3
BANDWIDTH = 2.0 * math.pi * 10.0
"""rad/s of the angle loop."""


class CommanderMotor:
    """Plant and motion control. Times are s since it was made; everything is at the motor shaft."""

    def __init__(self, parameters: SimParameters) -> None:
        self.parameters = parameters.resolved()
        self._plant = constants(self.parameters)
        self._packed = packed(self._plant, Constants._fields)
        self._path = start(self._plant)
        self._constant = self.parameters.motor.torque_constant
        self._integral = 0.0
        self._current = 0.0
        self.joint = JointTorque()
        self.enabled = False
        self.mode = TORQUE_MODE
        self.target = 0.0
        self.voltage_limit = 12.0
        self.current_limit = 2.0
        self.velocity_limit = 20.0
        self.clamps = True
        """Whether the current limit bounds a target in torque mode: since library 2.4."""
        self.run(0.0)  # no time passes; the machine code is there before the first command comes

    @property
    def time(self) -> float:
        """How far it has been carried, s."""
        return float(self._path.now[TIME])

    @property
    def angle(self) -> float:
        """rad, in counts of the sensor."""
        return counted(float(self._path.state[MOTOR]), 2.0 * math.pi / self.parameters.sensors.motor_counts)

    @property
    def velocity(self) -> float:
        """rad/s, filtered."""
        return float(self._path.state[VELOCITY])

    @property
    def torque(self) -> float:
        """N m that the current makes."""
        return float(self._path.state[TORQUE])

    @property
    def current(self) -> float:
        """Iq as the board measures it, A, in counts; while the motor is disabled the last is repeated."""
        if self.enabled:
            self._current = counted(self.torque / self._constant, self.parameters.sensors.current_lsb)
        return self._current

    @property
    def voltage(self) -> float:
        """Vq, V."""
        return self.current * self.parameters.motor.winding_resistance + self._constant * self.velocity

    @property
    def coupling_torque(self) -> float:
        """sigma_c, N m."""
        return float(coupling_torque(self._path.state, self._packed[0]))

    def enable(self) -> None:
        """Let current flow."""
        self._integral = 0.0
        self.enabled = True

    def disable(self) -> None:
        """No current from now on: the output stage is open."""
        self._current = self.current  # while it is still measured
        self.enabled = False
        self._path.state[TORQUE] = 0.0

    def run(self, until: float) -> None:
        """Carry plant and control to `until`, s; nothing happens where that is past."""
        while self.time < until:
            beat = min((math.floor(self.time / BEAT + 1e-6) + 1.0) * BEAT, until)
            integrate(self._path, self._demand() if self.enabled else 0.0, beat, self._packed[0])
            self.joint.note(self.time, self.coupling_torque)

    def _demand(self) -> float:
        """N m asked of the current loop in this beat."""
        volts = self.voltage_limit - self._constant * abs(self.velocity)
        ceiling = max(0.0, volts / self.parameters.motor.winding_resistance)
        if self.clamps or self.mode != TORQUE_MODE:
            ceiling = min(ceiling, self.current_limit)
        ceiling *= self._constant
        wanted = self.target * self._constant if self.mode == TORQUE_MODE else self._regulated(ceiling)
        return max(-ceiling, min(ceiling, wanted))

    def _regulated(self, ceiling: float) -> float:
        damping = self._plant.inertia * BANDWIDTH * 3.0
        speed = self.target
        if self.mode == ANGLE_MODE:
            speed = BANDWIDTH / 3.0 * (self.target - self.angle)
        speed = max(-self.velocity_limit, min(self.velocity_limit, speed))
        error = speed - self.velocity
        wanted = damping * error + self._integral
        if abs(wanted) <= ceiling:
            self._integral += damping * BANDWIDTH * error * BEAT
        return wanted
