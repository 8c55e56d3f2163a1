"""Emulated CubeMars AK and Damiao motors on a CAN bus: what `hil emulate mit` serves."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.bus import CanBus, CanTiming
from sim_backend.wire.canbus.serve import Served, served
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.mit.tables import MODELS

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sim_backend.parameters import SimParameters

KNOWN = tuple(sorted(MODELS))
"""The models there are."""


def serve(
    channel: str | Path,
    model: str = "dm-j4310",
    idents: Iterable[int] = (1,),
    *,
    interface: str = "slcan",
    parameters: SimParameters | None = None,
    timing: CanTiming | None = None,
) -> Served:
    """Motors of one model, each with a plant of its own, on a CAN bus.

    interface: "slcan" makes `channel` a symlink to a pty that speaks slcan; any other is python-can's, with its
    channel. `with serve(...)` answers from a thread; `serve(...).serve()` from this one, until an exception or
    `stop()`. parameters: the plant; None: the paper's joint, scaled to the motor. timing: None answers at once.
    Raises ValueError for a model that is not KNOWN, FileExistsError where `channel` is a file, can.CanError where the
    interface cannot be opened.
    """
    if model not in KNOWN:
        raise ValueError(f"no emulated motor is called {model!r}; there are {', '.join(KNOWN)}")
    now = time.monotonic()
    nodes = [MitDevice(model, ident, parameters=parameters, now=now) for ident in idents]
    return served(CanBus(nodes, timing=timing), interface, channel)
