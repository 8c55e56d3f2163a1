"""The command registers of an emulated moteus, and the demand law that they give in each mode.

Source: mjbots/moteus docs/protocol/registers.md and fw/bldc_servo_control.h.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sim_backend.wire.canbus.impedance import Impedance
from sim_backend.wire.moteus.laws import Guided, Within
from sim_backend.wire.moteus.registers import UNSET

if TYPE_CHECKING:
    from sim_backend.wire.moteus.console import Console
    from sim_backend.wire.plant_motor import PlantMotor

TURN = 2.0 * math.pi
TORQUE_CONSTANT = 0.05
"""N m/A of the emulated motor."""
RESISTANCE = 0.1
"""Ohm, resistance of the emulated motor's winding."""
VOLTAGE_DQ, CURRENT, POSITION, TIMEOUT, ZERO_VELOCITY, STAY_WITHIN, BRAKE = 8, 9, 10, 11, 12, 13, 15
RUNNING = frozenset({VOLTAGE_DQ, CURRENT, POSITION, ZERO_VELOCITY, STAY_WITHIN, BRAKE})
"""The modes in which current flows."""
TIMED = frozenset({POSITION, STAY_WITHIN})
"""The modes that end when the watchdog trips."""


class Command:
    """The command registers, and the state that lasts from one command to the next. config: the controller's console,
    which holds the configuration.
    """

    def __init__(self, config: Console) -> None:
        self._config = config
        self.clear()
        self.forget()

    def clear(self) -> None:
        """Set every command register to its default, the value that it has if a frame does not write it."""
        self.values = dict(UNSET)

    def forget(self) -> None:
        """Discard the held position and the trajectory to it."""
        self._held = math.nan
        self._goal: tuple[float, ...] = ()

    def law(self, mode: int, motor: PlantMotor[Any], offset: float) -> Any:
        """Return the demand law of `mode`. offset: rad, the motor's angle at which the controller's position is
        zero.
        """
        commands, values = self.values, self._config.values
        most = values["servo.max_current_A"] * TORQUE_CONSTANT
        if mode == CURRENT:
            return Impedance(feedforward=commands[0x01C] * TORQUE_CONSTANT, ceiling=most)
        if mode in {VOLTAGE_DQ, BRAKE}:
            volts = commands[0x01B] if mode == VOLTAGE_DQ else 0.0
            braking = TORQUE_CONSTANT**2 / RESISTANCE
            return Impedance(volts / RESISTANCE * TORQUE_CONSTANT, kd=braking, ceiling=most)
        if mode == ZERO_VELOCITY:
            kd = values["servo.pid_position.kd"] * commands[0x024] / TURN
            return Impedance(kd=kd, ceiling=values["servo.timeout_max_torque_Nm"])
        if mode == STAY_WITHIN:
            bounds = [commands[number] * TURN + offset for number in (0x040, 0x041)]
            return Within(self._about(0.0, motor, offset), *bounds)
        return self._positioned(motor, offset)

    def _about(self, position: float, motor: PlantMotor[Any], offset: float) -> Impedance:
        """Return the demand law that controls to `position`, rev, with the gains and limits of the command."""
        values, commands = self._config.values, self.values
        kp_scale = commands[0x023]
        return Impedance(
            feedforward=commands[0x022],
            kp=values["servo.pid_position.kp"] * kp_scale / TURN,
            kd=values["servo.pid_position.kd"] * min(kp_scale, commands[0x024]) / TURN,
            position=position * TURN + offset,
            velocity=commands[0x021] * TURN if math.isfinite(commands[0x021]) else 0.0,
            ceiling=self.ceiling() * self.derated(motor),
        )

    def _positioned(self, motor: PlantMotor[Any], offset: float) -> Any:
        """Return the demand law of the position mode. If limits of speed or acceleration are set, a trajectory leads to
        a new position.
        """
        commands = self.values
        before, turns = self._held, (motor.position - offset) / TURN
        if not math.isnan(commands[0x020]):
            self._held = commands[0x020]
        elif math.isnan(before):
            self._held = turns
        law = self._about(self._held, motor, offset)
        limits = [
            self._limited(0x028, "servo.default_velocity_limit"),
            self._limited(0x029, "servo.default_accel_limit"),
        ]
        goal = (self._held, *limits)
        if all(math.isinf(limit) for limit in limits):
            self._goal = ()
            return law
        if goal == self._goal and isinstance(motor.law, Guided):
            return replace(motor.law, law=law)
        self._goal = goal
        start = turns if math.isnan(before) else before
        return Guided(law, motor.time, start * TURN + offset, limits[0] * TURN, limits[1] * TURN)

    def _limited(self, number: int, name: str) -> float:
        """Return the limit in register `number`, or else the setting `name` of the configuration; infinity if neither
        is set.
        """
        for value in (self.values[number], self._config.values[name]):
            if not math.isnan(value):
                return value if value >= 0.0 else math.inf
        return math.inf

    def ceiling(self) -> float:
        """Return the highest torque that the command allows, N m."""
        most = self._config.values["servo.max_current_A"] * TORQUE_CONSTANT
        asked = self.values[0x025]
        return most if math.isnan(asked) else min(most, asked)

    def derated(self, motor: PlantMotor[Any]) -> float:
        """Return the factor on the torque limit at the motor's speed: 1 up to servo.max_velocity, then falling to 0."""
        over = abs(motor.velocity) / TURN - self._config.values["servo.max_velocity"]
        derate = self._config.values["servo.max_velocity_derate"]
        return max(0.0, min(1.0, 1.0 - over / derate)) if derate > 0.0 else float(over <= 0.0)


def arrived(motor: PlantMotor[Any]) -> bool:
    """Return whether the trajectory to the commanded position has ended."""
    law = motor.law
    return not isinstance(law, Guided) or motor.time >= law.begin + law.duration
