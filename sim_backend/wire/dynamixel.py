"""Emulated DYNAMIXEL servos on a pty: what `hil emulate dynamixel` serves."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from sim_backend.wire.dynamixel_bus import Bus, Timing
from sim_backend.wire.dynamixel_device import Device
from sim_backend.wire.dynamixel_tables import MODELS
from sim_backend.wire.pty_line import PtyLine

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sim_backend.parameters import SimParameters

KNOWN = tuple(sorted(MODELS))
"""The models there are."""


def serve(
    link: Path,
    model: str,
    idents: Iterable[int] = (1,),
    *,
    baudrate: int = 1_000_000,
    parameters: SimParameters | None = None,
    timing: Timing | None = None,
) -> PtyLine:
    """Servos of one model, each with a plant of its own, at `link`, a symlink to a pty.

    `with serve(...) as line:` answers from a thread; `serve(...).serve()` from this one, until an exception or
    `line.stop()`. parameters: the plant; None: the paper's joint on the horn. timing: None answers at once.
    Raises KeyError for a model that is not KNOWN, ValueError for an unknown baud rate, FileExistsError where `link` is
    a file.
    """
    now = time.monotonic()
    devices = [Device(model, ident, baudrate=baudrate, parameters=parameters, now=now) for ident in idents]
    return PtyLine(link, Bus(devices, timing=timing))
