"""Emulated CiA 402 drives on a CAN bus: what `hil emulate cia402` serves."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.bus import CanBus, CanTiming
from sim_backend.wire.canbus.serve import Served, served
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.cia402.tables import MODELS

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sim_backend.parameters import SimParameters


def serve(
    channel: str | Path,
    model: str = "epos4",
    idents: Iterable[int] = (1,),
    *,
    interface: str = "slcan",
    parameters: SimParameters | None = None,
    timing: CanTiming | None = None,
) -> Served:
    """Drives of one model, each with a plant of its own, on a CAN bus.

    interface: "slcan" makes `channel` a symlink to a pty that speaks slcan; any other is python-can's, with its
    channel.
    `with serve(...)` answers from a thread; `serve(...).serve()` from this one, until an exception or `stop()`.
    parameters: the plant; None: the paper's joint, scaled to the motor. timing: None answers at once.
    Raises ValueError for a model that is not of `MODELS` or a node id that is not 1 to 127, FileExistsError where
    `channel` is a file, can.CanError where the interface cannot be opened.
    """
    if model not in MODELS:
        raise ValueError(f"no emulated CiA 402 drive {model}; there are {', '.join(MODELS)}")
    now = time.monotonic()
    nodes = []
    for place, ident in enumerate(idents):
        if not 1 <= ident <= 127:
            raise ValueError(f"node id {ident} is not 1 to 127")
        nodes.append(Cia402Device(model, ident, parameters=parameters, now=now, serial=0x62004411 + place))
    return served(CanBus(nodes, timing=timing), interface, channel)
