"""Emulated Feetech servos on a pty, as `hil emulate feetech` serves them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim_backend.parameters import SimParameters
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.feetech.tables import BAUD, MODELS
from sim_backend.wire.loadcell.emulator import Pair, with_cell
from sim_backend.wire.packets.bus import PacketBus, PacketTiming
from sim_backend.wire.packets.servos import OnLine, follow_all, servos
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sim_backend.fault_plan import FaultPlan
    from sim_backend.wire.torque_log import TorqueLog


CELL = "+loadcell"
"""Suffix of a model's name that adds a torque cell at the joint of the first servo."""


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
    hand: Sequence[OnLine] = (),
) -> PtyLine | Pair:
    """Return a line with servos, each with its own plant, at `link`, a symlink to a pty.

    model: a model's name; "sts3215+loadcell" adds a torque cell at the joint of the first servo, on a second pty whose
    name is `link` with ".cell" appended. parameters: the plant, whose torque constant and winding are replaced by the
    model's; None: the default joint. timing: durations on the line; None: nothing takes time. log: where
    the torque of each servo is logged. faults: the faults that will happen. hand: the servos, instead of one of `model`
    for each id with the same `parameters`. Raises ValueError for an impossible model, id or baud rate, FileExistsError
    if `link` is a file.
    """
    name = model.removesuffix(CELL)
    if name not in MODELS:
        raise ValueError(f"model {model!r} is not known: choose one of {', '.join(MODELS)}, each also with {CELL}")
    wanted = hand or [OnLine(name, ident, parameters) for ident in idents]
    made = servos(FeetechDevice, MODELS, wanted, highest=253, baudrate=baudrate, rates=BAUD, log=log)
    for servo in made:
        servo.mount_at_middle()
    bus = PacketBus(made, timing=timing, protocol=1)
    follow_all(faults, bus)
    line = PtyLine(link, bus)
    sensors = (parameters or SimParameters()).sensors
    return line if name == model else with_cell(line, made[0], sensors)
