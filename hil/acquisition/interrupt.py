"""A request to stop a run: Ctrl-C, a closed terminal or a kill, turned into a flag."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_ENDING = (
    "SIGINT",
    "SIGTERM",
    "SIGHUP",
    "SIGQUIT",
    "SIGTSTP",  # a process that Ctrl-Z stops would leave the last torque on
    "SIGUSR1",
    "SIGUSR2",
    "SIGXCPU",
    "SIGBREAK",
)
"""Signals that end or stop a process by default, by name: not every system has them all."""


class StopRequest:
    """The signals received during a run: none can skip the torque-off. number: the first one, 0 before any."""

    def __init__(self) -> None:
        self.count = 0
        self.number = 0

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.count += 1
        self.number = self.number or number

    @contextmanager
    def listening(self) -> Iterator[StopRequest]:
        """Take the signals that end a process, until the recording is on disk.

        One that is ignored stays so: under nohup a closed terminal ends nothing.
        """
        numbers = [getattr(signal, name) for name in _ENDING if hasattr(signal, name)]
        before = {number: signal.getsignal(number) for number in numbers}
        before = {number: handler for number, handler in before.items() if handler not in {signal.SIG_IGN, None}}
        try:
            for number in before:
                signal.signal(number, self._note)
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
