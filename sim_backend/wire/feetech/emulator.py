"""Emulated Feetech servos on a pty, as `hil emulate feetech` serves them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim_backend.parameters import SimParameters
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.feetech.tables import BAUD, MODELS
from sim_backend.wire.loadcell.emulator import Pair, with_cell
from sim_backend.wire.packets.bus import PacketBus, PacketTiming
from sim_backend.wire.packets.servos import follow_all, servos
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sim_backend.fault_plan import FaultPlan
    from sim_backend.wire.torque_log import TorqueLog


CELL = "+loadcell"
"""Behind a model's name: with a torque cell at the joint of the first servo."""


def serve(
    link: Path,
    model: str = "sts3215",
    idents: Sequence[int] = (1,),
    *,
    baudrate: int = 1_000_000,
    parameters: SimParameters | None = None,
    timing: PacketTiming | None = None,
    log: TorqueLog | None = None,
    faults: FaultPlan | None = None,
) -> PtyLine | Pair:
    """Return servos of one model, each with a plant of its own, at `link`, a symlink to a pty.

    model: "sts3215+loadcell" for a torque cell at the first one's joint on a second pty, named as `link` with ".cell"
    behind it. parameters: the plant, in which the motor's constant and winding are made the model's; None: the paper's
    joint at the output. timing: None answers at once. log: of the torque of each. faults: that happen. Raises
    ValueError for a model, an id or a baud rate that cannot be, FileExistsError if `link` is a file.
    """
    name = model.removesuffix(CELL)
    if name not in MODELS:
        raise ValueError(f"model {model!r} is not known: choose one of {', '.join(MODELS)}, each also with {CELL}")
    made = servos(
        FeetechDevice, MODELS, name, idents, highest=253, baudrate=baudrate, rates=BAUD, parameters=parameters, log=log
    )
    for servo in made:
        servo.write(40, b"\x80")  # mounted at the middle of its turn
    bus = PacketBus(made, timing=timing, protocol=1)
    follow_all(faults, bus)
    line = PtyLine(link, bus)
    sensors = (parameters or SimParameters()).sensors
    return line if name == model else with_cell(line, made[0], sensors)
