"""Make several emulated servos of one model for one serial line."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from sim_backend.fault_plan import FaultPlan
from sim_backend.parameters import SimParameters
from sim_backend.wire.faults import follow
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.packets.regulator import Stalling, joint_at_horn
from sim_backend.wire.torque_log import TorqueLog, Watched

Servo = TypeVar("Servo", bound=Watched)


def servos(
    make: Callable[..., Servo],
    models: Mapping[str, Stalling],
    model: str,
    idents: Sequence[int],
    *,
    highest: int,
    baudrate: int,
    rates: Collection[int],
    parameters: SimParameters | None,
    log: TorqueLog | None,
) -> list[Servo]:
    """Return servos of `model`, each with its own plant. They are powered now, on the monotonic clock.

    make: a function that makes a servo from model and id, with the keywords baudrate, parameters and now. models: the
    known models. highest: the highest id. rates: the possible baud rates, bit/s. parameters: the plant, whose torque
    constant and winding are replaced by the model's; None: the paper's joint at the horn. log: where the torque of each
    servo is logged. Raises ValueError for an impossible model, id or baud rate.
    """
    if model not in models:
        raise ValueError(f"model {model!r} is not known: choose one of {', '.join(sorted(models))}")
    if baudrate not in rates:
        raise ValueError(f"baud rate {baudrate}: choose one of {', '.join(map(str, sorted(rates)))}")
    if len(set(idents)) < len(idents) or not all(0 <= ident <= highest for ident in idents):
        raise ValueError(f"ids must differ and lie between 0 and {highest}")
    if parameters is None:
        plant = joint_at_horn(models[model])
    else:
        volts, amperes, torque = models[model].stall
        motor = replace(parameters.motor, torque_constant=torque / amperes, winding_resistance=volts / amperes)
        plant = replace(parameters, motor=motor)
    now = time.monotonic()
    made = [make(model, ident, baudrate=baudrate, parameters=plant, now=now) for ident in idents]
    if log is not None:
        log.watch_all(made, now)
    return made


def follow_all(plan: FaultPlan | None, bus: PacketBus) -> None:
    """Add the faults of `plan` to a line and its servos; the plan's times count from now. Raises ValueError for a kind
    of fault that the line or its servos cannot have.
    """
    if plan is not None:
        follow(plan, bus.faults, [device.motor for device in bus.devices], time.monotonic(), can=False)
