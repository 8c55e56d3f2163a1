"""A servo and a joint sensor on another link, combined to one servo; its motor angle is relative to the stand's
zero.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

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
)

SILENCE = 0.25
"""The longest silence of the joint sensor, s, that is recorded as a gap in the data; a longer silence ends the run."""


class StandServo:
    """The servo of a stand: `servo` with the stand's zero and the joint sensor.

    zero: rad at the motor shaft. sensor: at the joint, None without a separate sensor. If the sensor is slower than the
    control loop, its last reading is repeated, with the time at which it was taken (`Sample.t_joint`). A reading that
    is lost is NaN in its sample. inner: the servo without joint sensor and zero.
    """

    def __init__(self, servo: Servo, zero: float, sensor: JointSensor | None) -> None:
        self.info, self.clock, self.inner = servo.info, servo.clock, servo
        self._servo = servo
        self._zero = zero
        self._sensor = sensor
        self._seen = servo.clock.now()

    def arm(self, limits: Limits) -> None:
        """Arm the servo. Raises DriverError."""
        low, high = limits.position
        self._servo.arm(replace(limits, position=(low + self._zero, high + self._zero)))

    def exchange(self, command: Command) -> Sample:
        """Exchange a command and a sample with the servo, and add the joint sensor's newest reading to the sample.

        Raises DriverError: LinkLost also if the connection to the sensor is lost, NoReply also if the sensor has been
        silent for longer than `SILENCE` s.
        """
        if command.quantity is Quantity.POSITION:
            command = replace(command, value=command.value + self._zero)
        sample = self._servo.exchange(command)
        if self._sensor is None:
            return replace(sample, motor_position=sample.motor_position - self._zero)
        t_joint, torque = self._read(self._sensor)
        return replace(sample, motor_position=sample.motor_position - self._zero, joint_torque=torque, t_joint=t_joint)

    def disarm(self) -> None:
        """Switch the torque off. Raises DriverError."""
        self._servo.disarm()

    def close(self) -> None:
        """Switch the torque off, then close both links. Harmless if they are closed already."""
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
