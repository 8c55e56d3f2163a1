"""The destination of a run's rows: a file (`hil.recording.writer.RecordingWriter`) or memory."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.recording.channels import ROW, Row, Rows


class Sink(Protocol):
    """The interface of a receiver of a run's rows and events. `append` is called in the control loop: it must not
    wait.
    """

    def append(self, row: Row) -> None:
        """Add one row. Raises Untrustworthy if the row cannot be stored."""

    def event(self, time: float, code: str, message: str) -> None:
        """Add an event at `time` s: a short code and a sentence. Raises Untrustworthy if the event cannot be stored."""

    def __len__(self) -> int:
        """Return the number of rows so far."""


class Memory:
    """A sink in memory, for short runs that are examined and then discarded."""

    def __init__(self) -> None:
        self._rows: list[Row] = []
        self.events: list[tuple[float, str, str]] = []

    def __len__(self) -> int:
        return len(self._rows)

    def append(self, row: Row) -> None:
        """Add one row."""
        self._rows.append(row)

    def event(self, time: float, code: str, message: str) -> None:
        """Add an event at `time` s: a short code and a sentence."""
        self.events.append((time, code, message))

    def channel(self, name: str) -> NDArray[np.float64]:
        """Return all rows of one channel, (n,) in its SI unit."""
        rows: Rows = np.array(self._rows, dtype=ROW)
        return rows[name].astype(np.float64)
