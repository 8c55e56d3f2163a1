"""A recording in progress as the page shows it: its rows, its state, its events, and the process that writes it."""

from __future__ import annotations

import os
import signal
import struct
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np

from drivers.servo import Status
from hil.live.state import State
from hil.live.viewer import opened
from hil.recording.integrity import Recorder, intact, recorder
from hil.recording.posix import process_mark

SHOWN: Final = ("time", "command", "torque", "dtheta")
"""The channels in a frame, in this order."""
WINDOW: Final = 20.0
"""The time that the traces show, s."""

_LATE = np.uint64(int(Status.LATE | Status.MISSED))
_RECENT = 500  # rows from which the lateness is taken


class Growing:
    """The recording in progress at `path`, mapped into memory. Raises OSError or KeyError for any other file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        rows, duration, limits = opened(path)
        self._rows = rows
        self._state = State(rows, duration, limits)
        self._late = 0
        self.duration = duration
        with h5py.File(path, "r") as file:
            profile = file["profile"].attrs
            self.rate, self._mode = float(profile.get("rate", 0.0)), str(profile.get("mode", "torque"))
            events = file["live_events"]
            place = {"offset": events.id.get_offset(), "shape": (len(events),), "dtype": events.dtype}
        self._events = np.memmap(path, mode="r", **place)

    def update(self) -> None:
        """Take over the rows that were written since the last call."""
        before = self._state.count
        self._state.update()
        self._late += int(np.count_nonzero(self._rows["status"][before : self._state.count] & _LATE))

    def events(self) -> list[tuple[str, str]]:
        """Return code and message of each event so far."""
        first = self._events[:16]
        return [
            (row["code"].decode(errors="replace"), row["message"].decode(errors="replace"))
            for row in first[intact(first)]
        ]

    def frame(self, first: int) -> tuple[bytes, int]:
        """Return the rows from number `first` on as one frame, and the number of the row after them.

        The frame is the first row's number and the number of rows, two uint32, the first row's time, float64 in s, and
        for each channel of `SHOWN` its values as float32, the time relative to the first. A reader that lags by more
        than the length of the traces gets the newest rows only. An empty frame if there is no new row.
        """
        end = self._state.count
        first = max(first, end - int(WINDOW * (self.rate or 1.0)))
        if first >= end:
            return b"", first
        rows = self._rows[first:end]
        begin = first / self.rate if self.rate else 0.0
        values = np.array([rows["time"] - begin, *(rows[name] for name in SHOWN[1:])], "<f4")
        return struct.pack("<IId", first, end - first, begin) + values.tobytes(), end

    def figures(self) -> dict[str, Any]:
        """Return the numbers that the page shows beside the traces, SI; None for a number that is not known yet."""
        state = self._state
        recent = self._rows[max(0, state.count - _RECENT) : state.count]
        late = recent["time"] - recent["seq"] / self.rate if self.rate and len(recent) else np.full(1, np.nan)
        return {
            "rows": state.count,
            "planned": self.rate,
            "mode": self._mode,
            "rate": _known(state.rate),
            "lateness": _known(float(np.nanquantile(late, 0.99)) if np.isfinite(late).any() else np.nan),
            "late": self._late,
            "lost": state.lost,
            "left": state.left,
            "duration": self.duration,
            "estimate": state.fit.estimate,
            "margins": [asdict(one) | {"used": one.used} for one in state.margins],
        }


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def recorder_of(part: Path) -> Recorder | None:
    """Return the process that records `part`; None if there is none, if the file is no recording of hil, or where the
    system does not tell.
    """
    named = recorder(part)
    return named if named is not None and is_recording(named, part) else None


def is_recording(named: Recorder, part: Path) -> bool:
    """Return whether the process that the recording names still runs, and has the file open for writing.

    A later process with the same id has another mark. Any other writer of the file, such as a copy, is not named in it.
    """
    with suppress(OSError):  # another user's, or ended
        is_same = named.mark != "" and process_mark(named.process) == named.mark
        return is_same and any(_writes(one, part) for one in Path(f"/proc/{named.process}/fd").iterdir())
    return False


def interrupt(named: Recorder, part: Path, number: int) -> None:
    """Send the process that records `part` the signal `number`; no other process gets it."""
    with suppress(OSError):  # it has ended
        process = os.pidfd_open(named.process)  # what gets the number after it is not reached
        try:
            if is_recording(named, part):
                signal.pidfd_send_signal(process, number)
        finally:
            os.close(process)


def _writes(descriptor: Path, path: Path) -> bool:
    with suppress(OSError, StopIteration, ValueError):
        if descriptor.samefile(path):
            lines = (descriptor.parent.parent / "fdinfo" / descriptor.name).read_text().splitlines()
            flags = next(line.split()[1] for line in lines if line.startswith("flags:"))
            return int(flags, 8) & os.O_ACCMODE != os.O_RDONLY
    return False
