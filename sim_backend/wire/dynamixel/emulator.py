"""Emulated DYNAMIXEL servos on a pty, as `hil emulate dynamixel` serves them."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.dynamixel.mx_tables import MX_BAUD, MX_MODELS
from sim_backend.wire.dynamixel.tables import BAUD, MODELS
from sim_backend.wire.packets.bus import PacketBus, PacketTiming
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sim_backend.parameters import SimParameters
    from sim_backend.wire.torque_log import TorqueLog

KNOWN = tuple(sorted(MODELS | MX_MODELS))
"""The models there are; those with protocol 1.0 cannot share a line with the others."""


def serve(
    link: Path,
    model: str = "xl330-m288",
    idents: Sequence[int] = (1,),
    *,
    baudrate: int = 1_000_000,
    parameters: SimParameters | None = None,
    timing: PacketTiming | None = None,
    log: TorqueLog | None = None,
) -> PtyLine:
    """Return servos of one model, each with a plant of its own, at `link`, a symlink to a pty.

    `with serve(...) as line:` answers from a thread; `serve(...).serve()` from this one until `line.stop()`.
    parameters: the plant, in which the motor's constant and winding are made the model's; None: the paper's joint on
    the horn. timing: None answers at once. log: of the torque of each. Raises ValueError for a model, an id or a baud
    rate that cannot be, FileExistsError where `link` is a file.
    """
    if model not in KNOWN:
        raise ValueError(f"model {model!r} is not known: choose one of {', '.join(KNOWN)}")
    rates = sorted(MX_BAUD.values() if model in MX_MODELS else BAUD)
    if baudrate not in rates:
        raise ValueError(f"baud rate {baudrate}: choose one of {', '.join(map(str, rates))}")
    if len(set(idents)) < len(idents) or not all(0 <= ident <= 252 for ident in idents):
        raise ValueError("ids must differ and lie between 0 and 252")
    if parameters is not None:
        volts, amperes, torque = (MODELS | MX_MODELS)[model].stall
        motor = replace(parameters.motor, torque_constant=torque / amperes, winding_resistance=volts / amperes)
        parameters = replace(parameters, motor=motor)
    make = MxDevice if model in MX_MODELS else DynamixelDevice
    now = time.monotonic()
    servos = [make(model, ident, baudrate=baudrate, parameters=parameters, now=now) for ident in idents]
    if log is not None:
        log.watch_all(servos, now)
    return PtyLine(link, PacketBus(servos, timing=timing, protocol=1 if model in MX_MODELS else 2))
