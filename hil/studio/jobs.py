"""The command that the page runs: a process in a separate session, stopped by the signal that Ctrl-C sends.

One command runs at a time, because a computation would make a running motor's ticks late. A run in this folder that
another program started, such as a studio that was killed, is shown and stopped in the same way.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from threading import Event
from typing import Any, Final

from hil.child import command, shared_memory
from hil.errors import WrongUse
from hil.recording.integrity import Recorder
from hil.recording.output import part_path
from hil.studio.commands import Line, line_of
from hil.studio.folder import Folder
from hil.studio.growing import Growing, interrupt, is_recording, recorder_of

_SHOWN: Final = 16_384  # bytes of a command's messages
_LARGEST: Final = 1 << 25  # bytes of its JSON
_WATCHED: Final = 5e-3  # s between two looks for the end of the torque
_ENDING: Final = 15.0  # s that a command is given to close its link, on a busy computer
_SOON: Final = 15.0  # s after a stop until which it is looked for
_NUMBERS: Final = itertools.count(1)
_ALARM: Final = "CUT THE POWER"  # in a line of a command or in an event of its recording: the torque may be on


class _Foreign:
    """The process of a run that another program started, with the methods of `subprocess.Popen` that a job needs."""

    def __init__(self, recorder: Recorder, part: Path) -> None:
        self._recorder, self._part, self.pid = recorder, part, recorder.process

    def poll(self) -> int | None:
        return None if is_recording(self._recorder, self._part) else 0

    def send_signal(self, number: int) -> None:
        interrupt(self._recorder, self._part, number)


class Job:
    """A command that runs or has ended. line: its command line. place: the folder in which it runs. recorder: the
    process of a foreign run. Raises WrongUse if it cannot be started.
    """

    def __init__(self, line: Line, place: Path, recorder: Recorder | None = None) -> None:
        self.number = next(_NUMBERS)
        self.line = line
        self.off_after: float | None = None  # s from the stop until the recording says that the torque is off
        self.stops = 0
        self.growing: Growing | None = None
        self.is_ours = recorder is None
        self._part = part_path(place / line.output) if line.kind == "record" and line.output else None
        # memory in place of pipes and files: neither a page that hangs nor a full disk may hold up a recorder
        self._out, self._err = (os.fdopen(shared_memory(0), "rb") for _ in range(2))
        if recorder is not None and self._part is not None:
            self._process: subprocess.Popen[bytes] | _Foreign = _Foreign(recorder, self._part)
            return
        streams: Any = {"stdin": subprocess.DEVNULL, "stdout": self._out, "stderr": self._err}
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own module
                command(line.module, *line.words), cwd=place, start_new_session=True, **streams
            )
        except OSError as error:
            raise WrongUse(f"{line.kind} cannot be started ({error.strerror}): close other programs") from error

    def __del__(self) -> None:  # not before: the stream may read them while the next command starts
        self._out.close()
        self._err.close()

    @property
    def status(self) -> int | None:
        """The exit status of the command, None while it runs."""
        return self._process.poll()

    def state(self) -> dict[str, Any]:
        """Return the job's entries in `Jobs.state`."""
        status = self.status
        return {
            "number": self.number,
            "kind": self.line.kind,
            "command": shlex.join(["hil", *self.line.words]) if self.is_ours else "a run that was started elsewhere",
            "moves": self.line.moves,
            "status": status,
            "process": self._process.pid,
            "output": "" if self.line.output is None else self.line.output.as_posix(),
            "stops": self.stops,
            "off_after": self.off_after,
            "said": self._lines()[-8:],
            "answer": self._answer(ended=status is not None),
            "live": None if self.growing is None else self.growing.figures(),
        }

    def _lines(self) -> list[str]:
        return _end_of(self._err).strip().splitlines()

    @property
    def heard(self) -> int:
        """The number of bytes of its messages so far. A guardian may write some after the command has ended."""
        return os.fstat(self._err.fileno()).st_size

    def alarm(self) -> str:
        """Return the message that the torque may be on and the power must be cut, "" if there is none."""
        events = [] if self.growing is None else self.growing.events()
        return next((text for text in (*self._lines(), *(one for _, one in events)) if _ALARM in text), "")

    def _answer(self, *, ended: bool) -> Any:
        with suppress(ValueError, IndexError):
            if self.line.kind == "readings":
                return json.loads(_end_of(self._out).split("\n")[-2])
            return json.loads(os.pread(self._out.fileno(), _LARGEST, 0)) if ended else None
        return None

    def follow(self) -> Growing | None:
        """Return the recording that the command writes, updated to its newest row; None before there is one."""
        if self.growing is None and self._part is not None and self.status is None:
            with suppress(OSError, KeyError, ValueError):  # not begun yet
                self.growing = Growing(self._part)
        if self.growing is not None:
            self.growing.update()
        return self.growing

    def signal(self) -> None:
        """Send the signal of Ctrl-C: the first lets a run ramp down and stop, the second switches off at once."""
        self.stops += 1
        self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """Ask the command to stop if this page started it, and wait a moment. It is never killed: a run ends under its
        guard.
        """
        if isinstance(self._process, subprocess.Popen):
            if self.status is None:
                self.signal()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=_ENDING)


def _end_of(file: Any) -> str:
    size = os.fstat(file.fileno()).st_size
    return os.pread(file.fileno(), _SHOWN, max(0, size - _SHOWN)).decode(errors="replace")


class Jobs:
    """Holds the page's job, at most one. folder: where the command runs."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.job: Job | None = None
        self._launching, self._unwanted = Event(), Event()  # a stop may come while a thread starts the process
        self._watching: asyncio.Task[None] | None = None  # a task that nothing names may be collected
        self._presses: set[str] = set()
        self._alarm, self._known = "", (0, 0)  # the job and the bytes of its messages in which it was looked for

    @property
    def alarm(self) -> str:
        """The message that the torque may be on and the power must be cut, until it is acknowledged; "" without."""
        job = self.job
        if job is not None and (known := (job.number, job.heard + (job.status is not None))) != self._known:
            self._alarm, self._known = self._alarm or job.alarm(), known
        return self._alarm

    def acknowledge(self) -> None:
        """Take the alarm back, as somebody at the bench says that the power is cut."""
        self._alarm = "" if self.alarm else self._alarm

    def changes(self) -> tuple[object, ...]:
        """Return what the page must hear of at once when it changes."""
        job = self.job
        return () if job is None else (job.number, job.status, job.stops, job.off_after, job.heard, self.alarm)

    def state(self) -> dict[str, Any]:
        """Return what the page shows.

        number, kind, command, output: of the newest command; without any, only number (0), alarm and free. moves:
        whether it may drive the motor. status: its exit status, null while it runs. stops: how many stops it got.
        off_after: s from the first one until the recording says that the torque is off. said: its last messages.
        answer: the JSON of its output, or of the last line while it runs. live: `Growing.figures`. alarm: a message to
        cut the power, "" without one; it stays until POST /api/acknowledge. free: bytes on the disk of the folder.
        """
        alarm = self.alarm
        table = {"number": 0} if self.job is None else self.job.state()
        return table | {"alarm": alarm, "free": shutil.disk_usage(self.folder.place).free}

    @property
    def running(self) -> Job | None:
        """The job that runs now, None without one."""
        return self.job if self.job is not None and self.job.status is None else None

    def find_foreign(self) -> None:
        """Take over a run that another program has started in this folder, if there is one and nothing else runs."""
        for part in self.folder.parts() if self.running is None else ():
            recorder = recorder_of(part)
            if recorder is not None:
                self.end()
                output = part.with_suffix("").relative_to(self.folder.place)
                self.job = Job(Line("record", [], output, moves=True), self.folder.place, recorder)
                return

    def start(self, wanted: Mapping[str, Any]) -> Job:
        """Start a command; live readings are ended first. Raises WrongUse if another command runs, or if a stop
        came.
        """
        self._unwanted.clear()
        self._launching.set()
        try:
            self.find_foreign()
            running = self.running
            if running is not None and running.line.kind != "readings":
                raise WrongUse(f"hil {running.line.kind} is running: wait for its end, or stop it first")
            line = line_of(wanted, self.folder)
            if line.moves and self.alarm:
                raise WrongUse(f"{self.alarm}: nothing moves until this is acknowledged")
            self.end()  # of readings: a drive answers one program at a time
            if self.running is not None:
                raise WrongUse("the live readings have not closed their link yet: try again")
            if self._unwanted.is_set():
                raise WrongUse("it was stopped before it began")
            self.job = job = Job(line, self.folder.place)
        finally:
            self._launching.clear()
        if self._unwanted.is_set():
            job.signal()
        return job

    def end(self) -> None:
        """Ask the present job to stop, and wait a moment."""
        if self.job is not None:
            self.job.end()

    def stop(self, press: str = "") -> dict[str, Any]:
        """Stop the running command with a ramp-down; then check often, to measure when the torque ends. Return the
        answer for the page: the press, and whether a command runs.

        press: identifies a press of STOP. The page sends each press in two ways; the later message with the same
        `press` is ignored. "": every call counts.
        """
        is_launching = self._launching.is_set()  # before the job is looked for, which is there when launching ends
        job = self.running
        if press not in self._presses and (job is not None or is_launching):  # else its other way may find a job
            self._presses |= {press} - {""}
            if is_launching:
                self._unwanted.set()
            if job is not None:
                job.signal()
                if job.stops == 1 and job.line.moves:
                    self._watching = asyncio.get_running_loop().create_task(_time_off(job, time.monotonic()))
        return {"press": press, "running": job is not None}


async def _time_off(job: Job, asked: float) -> None:
    while job.off_after is None and job.status is None and time.monotonic() < asked + _SOON:
        await asyncio.sleep(_WATCHED)
        if job.growing is not None and "torque-off" in dict(job.growing.events()):
            job.off_after = time.monotonic() - asked
