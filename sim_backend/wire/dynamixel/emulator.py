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
    """Return a line with servos of one model, each with its own plant, at `link`, a symlink to a pty.

    `with serve(...) as line:` serves the line in a thread; `serve(...).serve()` serves it in this thread until
    `line.stop()`. parameters: the plant, whose torque constant and winding are replaced by the model's; None: the
    paper's joint at the horn. timing: durations on the line; None: nothing takes time. log: where the torque of each
    servo is logged. faults: the faults that will happen. Raises ValueError for an impossible model, id or baud rate,
    FileExistsError if `link` is a file.
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
