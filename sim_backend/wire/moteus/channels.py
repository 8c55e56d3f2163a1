"""The telemetry channels of an emulated moteus, each with the fields that the vendor's tools read.

Source: mjbots/moteus fw/moteus_controller.cc, firmware_info.h, git_info.h and bldc_servo_structs.h for the names.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from sim_backend.wire.moteus.command import TORQUE_CONSTANT, TURN, arrived
from sim_backend.wire.moteus.telemetry import Field

if TYPE_CHECKING:
    from sim_backend.wire.plant_motor import PlantMotor


class Observed(Protocol):
    """The state of a device that its channels show. identity: the values of its registers by number."""

    identity: dict[int, int]
    motor: PlantMotor[Any]
    mode: int
    fault: int

    @property
    def turns(self) -> float:
        """Return the position, turns of the output shaft."""


def _firmware(device: Observed) -> list[Field]:
    words = [device.identity[0x120 + i] for i in range(3)]
    return [
        Field("version", "I", device.identity[0x101]),
        Field("serial_number", "I", words),
        Field("model", "I", device.identity[0x100]),
        Field("family", "B", 0),
    ]


def _git(_device: Observed) -> list[Field]:
    return [Field("hash", "B", [0] * 20), Field("dirty", "?", 0), Field("timestamp", "q", 0)]


def _servo_stats(device: Observed) -> list[Field]:
    motor = device.motor
    return [
        Field("mode", "I", device.mode),
        Field("fault", "I", device.fault),
        Field("q_A", "f", motor.torque / TORQUE_CONSTANT),
        Field("d_A", "f", 0.0),
        Field("fet_temp_C", "f", motor.temperature),
        Field("position", "f", device.turns),
        Field("velocity", "f", motor.velocity / TURN),
        Field("torque_Nm", "f", motor.torque),
        Field("trajectory_done", "?", arrived(device.motor)),
    ]


CHANNELS: dict[str, Callable[[Observed], list[Field]]] = {
    "firmware": _firmware,
    "git": _git,
    "servo_stats": _servo_stats,
}
