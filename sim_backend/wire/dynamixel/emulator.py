"""Emulated DYNAMIXEL servos on a pty, as `hil emulate dynamixel` serves them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.dynamixel.tables import BAUD, MODELS, MX_BAUD, MX_MODELS
from sim_backend.wire.packets.bus import PacketBus, PacketServo, PacketTiming
from sim_backend.wire.packets.servos import follow_all, servos
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sim_backend.fault_plan import FaultPlan
    from sim_backend.parameters import SimParameters
    from sim_backend.wire.torque_log import TorqueLog

_MODELS = MODELS | MX_MODELS


def serve(
    link: Path,
    model: str = "xl330-m288",
    idents: Sequence[int] = (1,),
    *,
    baudrate: int = 1_000_000,
    parameters: SimParameters | None = None,
    timing: PacketTiming | None = None,
    log: TorqueLog | None = None,
    faults: FaultPlan | None = None,
) -> PtyLine:
    """Return servos of one model, each with a plant of its own, at `link`, a symlink to a pty.

    `with serve(...) as line:` answers from a thread; `serve(...).serve()` from this one until `line.stop()`.
    parameters: the plant, in which the motor's constant and winding are made the model's; None: the paper's joint on
    the horn. timing: None answers at once. log: of the torque of each. faults: that happen. Raises ValueError for a
    model, an id or a baud rate that cannot be, FileExistsError if `link` is a file.
    """
    mx = model in MX_MODELS
    make: type[PacketServo] = MxDevice if mx else DynamixelDevice
    made = servos(
        make,
        _MODELS,
        model,
        idents,
        highest=252,
        baudrate=baudrate,
        rates=MX_BAUD.values() if mx else BAUD,
        parameters=parameters,
        log=log,
    )
    bus = PacketBus(made, timing=timing, protocol=1 if mx else 2)
    follow_all(faults, bus)
    return PtyLine(link, bus)
