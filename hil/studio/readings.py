"""The live readings of a stand at rest, read in a separate process, which prints one JSON object a line. Nothing is
armed.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from typing import Any

from drivers.servo import BadReply, Command, DriverError, NoReply, Sample
from hil.acquisition.interrupt import StopRequest
from hil.api.runs import opened_stand
from hil.errors import WrongUse
from hil.stand.file import Stand
from hil.stand.opening import open_servo
from hil.stand.transmission import Transmission

_PERIOD = 0.1  # s between two readings
_LONGEST = 600.0  # s; then the port is free again for other programs


def read(stand: Stand, show: Callable[[dict[str, Any]], object]) -> None:
    """Call `show` with one reading after the other until a signal comes, or the program that started this ends.

    A reading has the angles of motor and joint, rad, the torque at the joint, N m, and the temperature, degC; None
    where the drive reports none. Raises DriverError, WrongUse.
    """
    with StopRequest().listening() as stop:
        servo, _ = open_servo(stand, realtime=True)
        try:
            end, parent = servo.clock.now() + _LONGEST, os.getppid()
            while not stop.count and servo.clock.now() < end and os.getppid() == parent:
                try:
                    show(_reading(stand, servo.exchange(Command.rest())))
                except (NoReply, BadReply) as error:
                    show({"lost": str(error)})
                servo.clock.sleep_until(servo.clock.now() + _PERIOD)
        finally:
            servo.close()


def _reading(stand: Stand, sample: Sample) -> dict[str, float | None]:
    cell = stand.stand.torque_source == "joint"
    torque = sample.joint_torque if cell else Transmission.of(stand.stand).torque(sample.motor_torque)
    values = {"motor": sample.motor_position, "joint": sample.joint_position, "torque": torque}
    values["temperature"] = sample.temperature
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def _show(reading: dict[str, Any]) -> None:
    sys.stdout.write(f"{json.dumps(reading)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        read(opened_stand(sys.argv[1], sys.argv[2] or None), _show)
    except (WrongUse, DriverError) as error:
        sys.stderr.write(f"{error}\n")
