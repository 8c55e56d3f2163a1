"""Read LabVIEW's TDMS files with npTDMS: channels by group, and the times that a waveform states."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hil.exchange.readers.columns import Array, Columns, titled

_CLOCK = ("wf_increment", "wf_start_time", "wf_start_offset")


def read(source: Path) -> Columns:
    """Return the channels, "GROUP/CHANNEL [UNIT]", and "GROUP/time [s]" where they are waveforms.

    Times are from the first start in the file. A channel whose times differ from its group's has "GROUP/CHANNEL/time".
    """
    from nptdms import TdmsFile

    found: dict[str, Callable[[], Any]] = {}
    clocks: dict[str, tuple[Any, ...]] = {}
    channels = [channel for group in TdmsFile.read(source).groups() for channel in group.channels()]
    start = min((one.properties[_CLOCK[1]] for one in channels if _CLOCK[1] in one.properties), default=None)
    for channel in channels:
        name = f"{channel.group_name}/{channel.name}"
        stamps = channel.dtype.kind == "M"
        found[titled(name, {"unit": "s"} if stamps else channel.properties)] = partial(channel.__getitem__, slice(None))
        clock = (*(channel.properties.get(key) for key in _CLOCK), len(channel))
        if clock[0]:
            own = clocks.setdefault(channel.group_name, clock) != clock
            late = 0.0 if clock[1] is None else float((clock[1] - start) / np.timedelta64(1, "s"))
            found[f"{name if own else channel.group_name}/time [s]"] = partial(_times, clock, late)
    return found


def _times(clock: tuple[Any, ...], late: float) -> Array:
    step, _, offset, count = clock
    return np.asarray(late + float(offset or 0.0) + float(step) * np.arange(count), dtype=np.float64)
