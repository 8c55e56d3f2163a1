"""Emulated ODrive axes on a CAN bus: what `hil emulate odrive` serves."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.bus import CanBus, CanTiming
from sim_backend.wire.canbus.serve import Served, served
from sim_backend.wire.odrive.device import OdriveDevice

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sim_backend.parameters import SimParameters

KNOWN = ("0.5.6", "0.6.10", "0.6.11")
"""The firmwares there are."""


def serve(
    channel: str | Path,
    firmware: str = "0.6.10",
    idents: Iterable[int] = (0,),
    *,
    interface: str = "slcan",
    parameters: SimParameters | None = None,
    timing: CanTiming | None = None,
) -> Served:
    """Axes of one firmware, each with a plant of its own, on a CAN bus.

    interface: "slcan" makes `channel` a symlink to a pty that speaks slcan; any other is python-can's, with its
    channel.
    `with serve(...)` answers from a thread; `serve(...).serve()` from this one, until an exception or `stop()`.
    parameters: the plant; None: the paper's joint, scaled to the motor. timing: None answers at once.
    Raises ValueError for a firmware that is not KNOWN, FileExistsError where `channel` is a file, can.CanError where
    the interface cannot be opened.
    """
    if firmware not in KNOWN:
        raise ValueError(f"no emulated ODrive has firmware {firmware}; there are {', '.join(KNOWN)}")
    now = time.monotonic()
    nodes = [OdriveDevice(ident, firmware=firmware, parameters=parameters, now=now) for ident in idents]
    return served(CanBus(nodes, timing=timing), interface, channel)
