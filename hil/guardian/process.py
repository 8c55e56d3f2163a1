"""The guardian's process, started by `hil.guardian.handle` before the motor is armed.

Before a fault occurs, the guardian has everything it needs: an open link, the frames that switch the torque off, and
the time at which the guarded process must give its next sign of life. The guardian sends these frames if the guarded
process has ended, is stopped, is late, or runs longer than its profile. A guarded process that continues later reads in
`Word.FIRED` that it must not drive the motor any more. The module uses the standard library only. The process has its
own session and ignores the signals of a terminal.
"""

from __future__ import annotations

import contextlib
import gc
import json
import math
import os
import select
import signal
import sys
import time
from typing import Any

from hil.guardian.link import Send, discard_unsent, opened
from hil.guardian.words import Reason, Word, Words, now

_LOOK = 5e-3  # s between two looks at the guarded process
_BURST = 0.2  # s during which torque-off is sent after the guarded process has ended
_SETTLE = 0.05  # s until settings are restored; a drive that writes its flash takes its time for each
_ENDING = 0x604  # PF_SIGNALED, PF_DUMPCORE, PF_EXITING of include/linux/sched.h
_UNKNOWN = [b"?"] + [b"0"] * 6
_PRIORITY = 60  # of SCHED_FIFO, above any control loop

_WHY = {
    Reason.GONE: "the process that drove the motor ended without switching it off",
    Reason.STOPPED: "the process that drove the motor was stopped",
    Reason.LATE: "the process that drove the motor gave no sign of life in time",
    Reason.TOO_LONG: "the run lasted longer than its profile",
    Reason.ASKED: "the drive did not confirm that its torque is off",
}


class StandDown(Exception):
    """Raised when the guarded process has switched the torque off and needs no guardian any more."""


class Parent:
    """The state of the guarded process, and the commands that it sends.

    gone: whether the process has ended. commands: the read end of the pipe from it.
    """

    def __init__(self, pid: int, commands: int) -> None:
        self.gone = False
        self._pid = pid
        self._commands = commands
        self._text = b""
        self._poll = select.poll()
        self._poll.register(commands, select.POLLIN | select.POLLHUP)
        with contextlib.suppress(AttributeError, OSError):  # an older kernel, or not Linux: `_look` finds out
            self._poll.register(os.pidfd_open(pid), select.POLLIN)
        try:
            self._state = os.open(f"/proc/{pid}/stat", os.O_RDONLY)
        except OSError:
            self._state = -1

    def listen(self, seconds: float) -> list[dict[str, Any]]:
        """Wait for up to `seconds` s and return the commands that have come. Sets `gone` if the guarded process has
        ended.
        """
        out: list[dict[str, Any]] = []
        for descriptor, _ in self._poll.poll(max(0.0, seconds) * 1e3):
            received = os.read(descriptor, 1 << 16) if descriptor == self._commands else b""
            if not received:
                self.gone = True
                self._poll.unregister(descriptor)
            *lines, self._text = (self._text + received).split(b"\n")
            out += [json.loads(line) for line in lines]
        self.gone = self.gone or os.getppid() != self._pid
        return out

    def stands_still(self) -> bool:
        """Return whether the guarded process is stopped by a signal or a debugger; False if the system does not say."""
        return self._stat()[0] in {b"T", b"t"}

    def ends(self) -> bool:
        """Return whether the guarded process is about to end: a killed process first frees its memory, which takes
        time.
        """
        return bool(int(self._stat()[6]) & _ENDING)

    def _stat(self) -> list[bytes]:
        """Return the fields after the name in /proc/PID/stat of the guarded process (manual page proc(5))."""
        if self._state < 0:
            return _UNKNOWN
        try:
            stat = os.pread(self._state, 512, 0)
        except OSError:
            return _UNKNOWN
        return stat[stat.rfind(b")") + 1 :].split()


class Guardian:
    """Watches the guarded process `parent` and switches the torque off in its place.

    way: fields of the `OffPath`, from JSON. send: function that sends a packet to the drive. words: the shared memory.
    """

    def __init__(self, way: dict[str, Any], send: Send, parent: Parent, words: Words) -> None:
        self._send = send
        self._parent = parent
        self._words = words
        self._descriptor = -1 if way["to"] is not None else int(way["descriptor"])
        self._interval = float(way["interval"])
        self._resync = bytes.fromhex(way["resync"])
        self._off = [bytes.fromhex(packet) for packet in way["off"]]
        self._restore = [bytes.fromhex(packet) for packet in way["restore"]]
        self._asked = False
        self._still_since_due = -1
        self._sent = self._said = False
        self._error = ""

    def watch(self) -> Reason:
        """Wait until the torque must be switched off, and return the reason. Raises StandDown if the guardian is not
        needed any more.
        """
        while True:
            looked = self._words[Word.ALIVE] = now()
            due = self._words[Word.DUE]
            self._hear(_LOOK if not due else min(_LOOK, (due - looked) * 1e-9))
            reason = self._reason(now())
            if reason is not None:
                return reason

    def _reason(self, looked: int) -> Reason | None:
        """Return why the torque must be switched off, None if it need not be.

        looked: the present time, read before the shared memory, so that a sign of life that comes meanwhile is not
        missed.
        """
        if self._parent.gone or self._parent.ends():
            return Reason.GONE
        if self._asked:
            return Reason.ASKED
        due, latest = self._words[Word.DUE], self._words[Word.LATEST]
        if not due:
            return None
        if looked > due and due == self._words[Word.DUE]:
            return Reason.LATE
        if latest and looked > latest:
            return Reason.TOO_LONG
        return Reason.STOPPED if self._stays_still(due) else None

    def _stays_still(self, due: int) -> bool:
        """Return whether the guarded process was stopped at this check and at the previous one, without a sign of life
        in between. due: when the next sign of life is due, ns. One check is not enough: a tracer stops a process
        briefly.
        """
        before, self._still_since_due = self._still_since_due, due if self._parent.stands_still() else -1
        return before == due == self._still_since_due

    def fire(self, reason: Reason) -> None:
        """Send torque-off again and again until the guarded process has ended, then restore the drive's settings.

        A process that was stopped may come back and send one stale set-point. Raises StandDown if the guarded process
        takes over.
        """
        self._words[Word.FIRED] = int(reason)
        if self._descriptor >= 0:
            discard_unsent(self._descriptor)
        end = math.inf
        while time.monotonic() < end:
            if self._parent.gone:
                reason, end = Reason.GONE, min(end, time.monotonic() + _BURST)
            self._sent = self._try([self._resync, *self._off]) or self._sent
            if not self._said and reason is not Reason.LATE:  # a process that was late reports it
                self._say(reason)
            self._hear(self._interval)
        self._hear(_SETTLE)
        for packet in self._restore:
            self._try([packet])
            self._hear(_SETTLE)

    def _try(self, packets: list[bytes]) -> bool:
        try:
            for packet in packets:
                if packet:
                    self._send(packet)
        except OSError as error:
            self._error = str(error)
            return False
        return True

    def _hear(self, seconds: float) -> None:
        """Wait up to `seconds` s, and carry out the commands of the guarded process. Raises StandDown."""
        for said in self._parent.listen(seconds):
            if "restore" in said:
                self._restore = [bytes.fromhex(packet) for packet in said["restore"]]
            self._asked = self._asked or "fire" in said
            self._said = self._said or "tried" in said
            if "stand_down" in said:
                raise StandDown

    def _say(self, reason: Reason) -> None:
        """Print at the terminal why the torque was switched off: the guarded process may be unable to print it."""
        self._said = True
        text = f"CUT THE POWER: torque-off failed ({self._error})"
        if self._sent:
            text = "the guardian sent torque-off; if the motor still pulls, cut its power"
        with contextlib.suppress(OSError, ValueError):
            if select.select([], [2], [], 0.0)[1]:  # a terminal that was stopped must not stop the frames
                os.write(2, f"hil: {_WHY[reason]}: {text}\n".encode("utf-8", "replace"))


def main() -> None:
    """Guard the process that started this one, until that process ends the guardian."""
    _be_undisturbed()
    way = json.loads(sys.argv[1])
    try:
        send = opened(way)
    except (OSError, ImportError) as error:
        _answer(str(error))
        return
    words = Words(way["words"])
    guardian = Guardian(way, send, Parent(way["parent"], 0), words)
    words[Word.ALIVE] = now()  # before the answer: from then on the guarded process counts a guardian that is frozen
    _answer("ready")
    with contextlib.suppress(StandDown):
        guardian.fire(guardian.watch())


def _answer(text: str) -> None:
    os.write(1, f"{text}\n".encode("utf-8", "replace"))


def _be_undisturbed() -> None:
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGPIPE", "SIGUSR1", "SIGUSR2", "SIGALRM"):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    gc.collect()
    gc.disable()
    with contextlib.suppress(OSError, AttributeError):  # where it is permitted
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))


if __name__ == "__main__":
    main()
