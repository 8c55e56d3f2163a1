"""A servo and a joint sensor on another link as one servo, whose motor angle counts from the stand's zero."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

from drivers.clock import Clock
from drivers.servo import (
    BadReply,
    Command,
    DriverError,
    JointSensor,
    Limits,
    NoReply,
    Quantity,
    Sample,
    Servo,
    ServoInfo,
)

SILENCE = 0.25
"""s without a reading of the joint sensor that are gaps in the data; a longer silence ends the run."""


class StandServo:
    """`servo` with the stand's zero, rad at the motor shaft, and `sensor` at the joint (None: the servo's own).

    A sensor slower than the loop is read again before it has anything new: its last reading is kept, with the time it
    was taken (`Sample.t_joint`). A reading that is lost is NaN in its sample.
    """

    def __init__(self, servo: Servo, zero: float, sensor: JointSensor | None) -> None:
        self._servo = servo
        self._zero = zero
        self._sensor = sensor
        self._seen = servo.clock.now()

    @property
    def inner(self) -> Servo:
        """The servo itself."""
        return self._servo

    @property
    def info(self) -> ServoInfo:
        """The servo's own."""
        return self._servo.info

    @property
    def clock(self) -> Clock:
        """The servo's; the sensor's readings carry its time too."""
        return self._servo.clock

    def arm(self, limits: Limits) -> None:
        """Arm the servo; raises as it does."""
        low, high = limits.position
        self._servo.arm(replace(limits, position=(low + self._zero, high + self._zero)))

    def exchange(self, command: Command) -> Sample:
        """One round trip with the servo, then the sensor's newest reading.

        Raises as the servo does, LinkLost if the sensor is gone, NoReply if it has been silent for `SILENCE`.
        """
        if command.quantity is Quantity.POSITION:
            command = replace(command, value=command.value + self._zero)
        sample = self._servo.exchange(command)
        if self._sensor is None:
            return replace(sample, motor_position=sample.motor_position - self._zero)
        t_joint, torque = self._read(self._sensor)
        return replace(sample, motor_position=sample.motor_position - self._zero, joint_torque=torque, t_joint=t_joint)

    def disarm(self) -> None:
        """Torque off; raises as the servo does."""
        self._servo.disarm()

    def close(self) -> None:
        """Torque off, then close both links. Harmless when already closed."""
        try:
            self._servo.close()
        finally:
            if self._sensor is not None:
                with contextlib.suppress(DriverError):
                    self._sensor.close()

    def _read(self, sensor: JointSensor) -> tuple[float, float]:
        now = self.clock.now()
        try:
            t, torque = sensor.read()
        except (NoReply, BadReply) as error:
            t, torque = math.nan, math.nan
            reason = str(error)
        else:
            self._seen = max(self._seen, t)
            reason = "it repeats an old reading"
        if now - self._seen > SILENCE:
            raise NoReply(f"the joint sensor has given no new reading for {now - self._seen:.2f} s ({reason})")
        return t, torque
