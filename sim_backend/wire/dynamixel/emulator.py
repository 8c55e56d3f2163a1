"""Emulated DYNAMIXEL servos on a pty, as `hil emulate dynamixel` serves them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.dynamixel.tables import BAUD, MODELS, MX_BAUD, MX_MODELS
from sim_backend.wire.packets.bus import PacketBus, PacketServo, PacketTiming
from sim_backend.wire.packets.servos import OnLine, follow_all, servos
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
    hand: Sequence[OnLine] = (),
) -> PtyLine:
    """Return a line with servos, each with its own plant, at `link`, a symlink to a pty.

    `with serve(...) as line:` serves the line in a thread; `serve(...).serve()` serves it in this thread until
    `line.stop()`. parameters: the plant, whose torque constant and winding are replaced by the model's; None: the
    default joint. timing: durations on the line; None: nothing takes time. log: where the torque of each
    servo is logged. faults: the faults that will happen. hand: the servos, instead of one of `model` for each id with
    the same `parameters`. Raises ValueError for an impossible model, id or baud rate, FileExistsError if `link` is a
    file.
    """
    wanted = hand or [OnLine(model, ident, parameters) for ident in idents]
    protocols = {one.model in MX_MODELS for one in wanted}
    if len(protocols) > 1:
        raise ValueError("servos of protocol 1.0 (MX-64, MX-106) and of protocol 2.0 do not share a line")
    mx = protocols == {True}
    make: type[PacketServo] = MxDevice if mx else DynamixelDevice
    rates = MX_BAUD.values() if mx else BAUD
    made = servos(make, _MODELS, wanted, highest=252, baudrate=baudrate, rates=rates, log=log)
    bus = PacketBus(made, timing=timing, protocol=1 if mx else 2)
    follow_all(faults, bus)
    return PtyLine(link, bus)
