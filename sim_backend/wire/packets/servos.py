"""Make the emulated servos of one serial line."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from sim_backend.fault_plan import FaultPlan
from sim_backend.parameters import SimParameters
from sim_backend.wire.faults import follow
from sim_backend.wire.packets.bus import PacketBus, PacketServo
from sim_backend.wire.packets.regulator import Stalling, joint_at_horn
from sim_backend.wire.plant_motor import PlantMotor
from sim_backend.wire.torque_log import TorqueLog

Servo = TypeVar("Servo", bound=PacketServo)


class OnLine(NamedTuple):
    """A servo to be emulated. parameters: its plant, whose torque constant and winding are replaced by the model's;
    None: the default joint. turns: by the id of each other servo, its turns for one turn of this servo's locked joint.
    """

    model: str
    ident: int
    parameters: SimParameters | None = None
    turns: Mapping[int, float] = MappingProxyType({})


def servos(
    make: Callable[..., Servo],
    models: Mapping[str, Stalling],
    wanted: Sequence[OnLine],
    *,
    highest: int,
    baudrate: int,
    rates: Collection[int],
    log: TorqueLog | None,
) -> list[Servo]:
    """Return the servos `wanted`, each with its own plant. They are powered now, on the monotonic clock.

    make: a function that makes a servo from model and id, with the keywords baudrate, parameters and now. models: the
    known models. highest: the highest id. rates: the possible baud rates, bit/s. log: where the torque of each servo is
    logged. Raises ValueError for an impossible model, id or baud rate.
    """
    idents = [servo.ident for servo in wanted]
    for model in {servo.model for servo in wanted} - set(models):
        raise ValueError(f"model {model!r} is not known: choose one of {', '.join(sorted(models))}")
    if baudrate not in rates:
        raise ValueError(f"baud rate {baudrate}: choose one of {', '.join(map(str, sorted(rates)))}")
    if len(set(idents)) < len(idents) or not all(0 <= ident <= highest for ident in idents):
        raise ValueError(f"ids must differ and lie between 0 and {highest}")
    now = time.monotonic()
    made = [
        make(
            one.model,
            one.ident,
            baudrate=baudrate,
            parameters=joint_at_horn(models[one.model], one.parameters),
            now=now,
        )
        for one in wanted
    ]
    motors = {one.ident: servo.life.motor for one, servo in zip(wanted, made, strict=True)}
    for ident, motor in motors.items():
        motor.pulled = _pull([(motors[one.ident], one.turns[ident]) for one in wanted if ident in one.turns])
    if log is not None:
        log.watch_all(servo.life for servo in made)
    return made


def _pull(turns: Sequence[tuple[PlantMotor[Any], float]]) -> Callable[[], float]:
    """Return the function that returns the angle, rad, to which other motors' locked joints turn a motor."""
    return lambda: sum((each * other.joint for other, each in turns), 0.0)


def follow_all(plan: FaultPlan | None, bus: PacketBus) -> None:
    """Add the faults of `plan` to a line and its servos; the plan's times count from now. Raises ValueError for a kind
    of fault that the line or its servos cannot have.
    """
    if plan is not None:
        follow(plan, bus.faults, [device.life.motor for device in bus.devices], time.monotonic(), can=False)
