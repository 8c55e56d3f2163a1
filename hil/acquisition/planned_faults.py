"""Planned faults of the recording computer: the recorder is killed, or the disk is full or does not respond."""

from __future__ import annotations

import os
import signal

from hil.acquisition.sink import Sink
from hil.errors import Untrustworthy
from hil.recording.background import BackgroundWriter
from hil.recording.channels import Row
from hil.recording.writer import RecordingWriter
from sim_backend.fault_plan import PlannedFault


class FaultyHost:
    """Carries out the planned faults of the recording computer; `FaultyServo` carries out those of the servo."""

    def __init__(self) -> None:
        self._full = False
        self._writer: RecordingWriter | BackgroundWriter | None = None

    def sink(self, writer: RecordingWriter | BackgroundWriter) -> Sink:
        """Return a sink that writes to `writer` until a planned fault fills the disk."""
        self._writer = writer
        return _Disk(self, writer)

    def __call__(self, fault: PlannedFault) -> None:
        """Carry out a fault of the computer."""
        if fault.kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        elif fault.kind == "disk-full":
            self._full = True
        elif isinstance(self._writer, BackgroundWriter):
            os.kill(self._writer.process, signal.SIGSTOP)

    def check(self) -> None:
        """Raise Untrustworthy if the disk is full."""
        if self._full:
            raise Untrustworthy("the disk is full, as planned in the file of --faults: the rows so far are kept")


class _Disk:
    def __init__(self, host: FaultyHost, writer: Sink) -> None:
        self._host, self._writer = host, writer

    def __len__(self) -> int:
        return len(self._writer)

    def append(self, row: Row) -> None:
        self._host.check()
        self._writer.append(row)

    def event(self, time: float, code: str, message: str) -> None:
        self._writer.event(time, code, message)
