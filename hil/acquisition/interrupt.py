"""A request to stop a run: Ctrl-C, a closed terminal or a kill only sets a flag, which the run reads."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import ClassVar

from hil.errors import WrongUse

_HARMLESS = ("SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO")  # ignored by default
_NOT_OURS = ("SIGKILL", "SIGSTOP", "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL")  # cannot be handled, or not in Python


def ending() -> list[int]:
    """Return all signals, real-time signals included, that end or stop a process by default and that the process can
    handle.
    """
    others = {getattr(signal, name, None) for name in (*_HARMLESS, *_NOT_OURS)}
    return sorted(int(number) for number in signal.valid_signals() if number not in others)


class StopRequest:
    """Counts the signals received during a run; no signal can prevent the torque-off.

    count: number of signals received. number: the number of the first signal, 0 before any signal. exit_follows:
    whether the process ends after a stopped run. Later signals are then ignored, because a signal during the
    interpreter's shutdown would change the exit status.
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

        A signal that is ignored stays ignored: under nohup, closing the terminal ends no run. goes_on: whether another
        run may follow a stopped run, so that later signals are handled as well. Raises WrongUse outside the main
        thread.
        """
        if threading.current_thread() is not threading.main_thread():
            raise WrongUse(
                "hil was called outside the main thread, where Python receives no signals: Ctrl-C or a kill could not "
                "ramp the torque down, so nothing was driven. Call it in the main thread, or in a process of its own"
            )
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
