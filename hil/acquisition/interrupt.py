"""A request to stop a run: Ctrl-C, a closed terminal or a kill, turned into a flag."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import ClassVar

_HARMLESS = ("SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO")  # ignored by default
_NOT_OURS = ("SIGKILL", "SIGSTOP", "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL")  # cannot be handled, or not in Python


def ending() -> list[int]:
    """Return every signal that ends or stops a process by default and can be handled, real-time signals included."""
    others = {getattr(signal, name, None) for name in (*_HARMLESS, *_NOT_OURS)}
    return sorted(int(number) for number in signal.valid_signals() if number not in others)


class StopRequest:
    """The signals received during a run; none of them can skip the torque-off. number: the first one, 0 before any.

    exit_follows: whether the process ends after a stopped run. Later signals are then ignored: one that arrives during
    the interpreter's shutdown would change the exit status.
    """

    exit_follows: ClassVar[bool] = False

    def __init__(self) -> None:
        self.count = 0
        self.number = 0

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.count += 1
        self.number = self.number or number

    @contextmanager
    def listening(self, *, goes_on: bool = False) -> Iterator[StopRequest]:
        """Handle the signals that end a process, until the recording is on disk.

        Signals that are ignored stay ignored: under nohup a closed terminal ends nothing. goes_on: whether another run
        may follow a stopped one, so that later signals count.
        """
        before = {number: signal.getsignal(number) for number in ending()}
        before = {number: handler for number, handler in before.items() if handler not in {signal.SIG_IGN, None}}
        try:
            for number in before:
                signal.signal(number, self._note)
            yield self
        finally:
            ignored = self.count and self.exit_follows and not goes_on
            for number, handler in before.items():
                signal.signal(number, signal.SIG_IGN if ignored else handler)
