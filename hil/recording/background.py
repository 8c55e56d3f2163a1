"""Write a recording in a second process: the control loop puts its rows into shared memory and never waits for the
disk.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Self

from hil.child import command
from hil.errors import Untrustworthy, WrongUse
from hil.recording.channels import Row
from hil.recording.integrity import EVENT, LIVE, packed, packed_event
from hil.recording.reader import EVENTS
from hil.recording.ring import Ring, Shape
from hil.recording.writer import RecordingWriter

_HELD = 8.0  # s of rows that fit into the ring; the run ends when it is half full
_FEWEST = 256  # rows
_LOOK = 0.02  # s between two looks whether the writing process lives
_START = 30.0  # s that it may take to start on a busy computer
_PATIENCE = 3.0  # s without progress after which a disk is said not to answer
_PAUSE = 2e-3  # s between two looks at its progress
_LAST = packed_event(0.0, "interrupted", "the recorder was killed; every row that it took is here")


class BackgroundWriter:
    """A recording in progress whose rows a second process writes into the file of `recording`.

    This object replaces the `RecordingWriter` given as `recording`, and has the same attributes. rate: of the rows, Hz.
    If the recorder is killed, the second process writes all rows that it received. If the second process is killed, the
    recorder writes these rows. If both are killed, the rows that were not written are lost: those of the last 5 ms on a
    disk that answers. If the disk does not accept rows, `append` raises Untrustworthy once the memory is half full.
    Raises WrongUse if the process cannot be started.
    """

    def __init__(self, recording: RecordingWriter, rate: float) -> None:
        self._recording = recording
        place = recording.place
        rows = max(_FEWEST, int(_HELD * rate))
        shape = Shape(rows, LIVE.itemsize, EVENTS, EVENT.itemsize, place.rows_at, place.events_at)
        try:
            self._ring = Ring.create(shape)
        except OSError as error:
            raise WrongUse(f"there is no memory for the rows of a run ({error.strerror}): make room") from None
        self._ring.set_last_event(_LAST)
        self._half = rows // 2
        self._look = max(1, int(_LOOK * rate))
        self._rows = 0
        self._ended = False
        try:
            self._process = self._start(place.file)
        except BaseException:
            self._ring.close()
            raise

    def _start(self, file: int) -> subprocess.Popen[bytes]:
        words = command("hil.recording.writer_process", str(self._ring.file), str(file))
        process = subprocess.Popen(  # noqa: S603 - our own module
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(self._ring.file, file),
            start_new_session=True,  # which Ctrl-C and a closed terminal do not reach
        )
        assert process.stdout is not None  # noqa: S101 - a pipe
        with process.stdout as ready:
            if select.select([ready], [], [], _START)[0] and ready.read(1):
                return process
        process.kill()
        process.communicate()
        raise WrongUse("the process that writes the recording did not start: see whether the computer is out of memory")

    @property
    def process(self) -> int:
        """Return the id of the writing process."""
        return self._process.pid

    @property
    def path(self) -> Path:
        """Return the path of the `.part` file."""
        return self._recording.path

    @property
    def final(self) -> Path:
        """Return the path of the finished file."""
        return self._recording.final

    @property
    def moved(self) -> str:
        """Return a sentence that says where the recording is, if its file was removed or replaced during the run;
        otherwise "".
        """
        return self._recording.moved

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self._rows

    def append(self, row: Row) -> None:
        """Add one row. Raises Untrustworthy if the disk fails or does not respond, or the writing process is dead."""
        waiting = self._ring.add(packed((row,)))
        self._rows += 1
        if waiting > self._half:
            raise Untrustworthy(
                f"{self.path} cannot be written any further (the disk has not answered while {waiting} rows came): its "
                "rows so far are kept"
            )
        if not self._rows % self._look:
            self._check()

    def _check(self) -> None:
        if self._ring.failure:
            reason = os.strerror(self._ring.failure)
            raise Untrustworthy(f"{self.path} cannot be written any further ({reason}): its rows so far are kept")
        if self._process.poll() is not None:
            raise Untrustworthy(f"the process that writes {self.path} was killed: its rows so far are kept")

    def event(self, time: float, code: str, message: str) -> None:
        """Add an event at `time` s. If the table of events is full, the event is dropped: samples are more
        important.
        """
        self._ring.add_event(packed_event(time, code, message))

    def finish(self, end_reason: str, *, force: bool = False) -> Path:
        """Write all rows and the final file, and return its path. Raises WrongUse, and Untrustworthy if the disk does
        not respond.
        """
        self._end()
        return self._recording.finish(end_reason, force=force)

    def discard(self) -> None:
        """Remove the recording, if it has no row worth keeping. Harmless if already closed."""
        self._end()
        self._recording.discard()

    def close(self) -> None:
        """Close the file and keep it as it is. Harmless if already closed."""
        try:
            self._end()
        finally:
            self._recording.close()

    def _end(self) -> None:
        """Let the second process write the waiting rows and end; write the rows that it did not write. Raises
        Untrustworthy.
        """
        if self._ended:
            return
        self._ended = True
        self._ring.end()
        assert self._process.stdin is not None  # noqa: S101 - a pipe
        self._process.stdin.close()
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGCONT)  # somebody may have stopped it
        while self._process.poll() is None and self._advances():
            pass
        if self._process.poll() is None:
            self._process.returncode = 0  # it is left alone on purpose, of which Popen would warn
            raise Untrustworthy(
                f"the disk does not answer: {self._ring.put - self._ring.taken} of {self._rows} rows are in the memory "
                f"of process {self._process.pid}, which goes on writing them into {self.path} and then ends"
            )
        try:
            self._recording.resume(self._ring)
        finally:
            self._ring.close()

    def _advances(self) -> bool:
        """Wait a moment. Return False if for `_PATIENCE` s no row was written and the process did not end."""
        before, begin = self._ring.taken, time.monotonic()
        while self._process.poll() is None and self._ring.taken == before:
            if time.monotonic() - begin > _PATIENCE:
                return False
            time.sleep(_PAUSE)
        return True
