"""The shared memory through which rows and events pass from the control loop to the writing process.

The control loop puts rows, the writing process takes rows, and neither waits for the other. The memory has a name, so
the rows are kept if both processes die: `Ring.left` finds them. The module does not import numpy, so that the writing
process starts quickly.
"""

from __future__ import annotations

import errno
import mmap
import os
import stat
import tempfile
import time
import uuid
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Self

from hil.recording.posix import lock

_HEADER = 128  # bytes, of 8 each
_SHARED = "/dev/shm"  # noqa: S108 - memory
_KEPT = 7 * 86400.0  # s that rows which nobody recovers stay in memory
_PUT, _TAKEN, _EVENTS_PUT, _EVENTS_TAKEN, _CLOSED, _FAILURE, _SHAPE = range(7)


class Shape(NamedTuple):
    """The sizes of a ring and of the file that its rows are written to.

    rows, row: number of rows that the ring has room for, and bytes of a row. events, event: number of events, and bytes
    of an event. rows_at, events_at: byte offsets of the first row and of the first event in the file. The last event is
    the one that the writing process adds if the recorder dies.
    """

    rows: int
    row: int
    events: int
    event: int
    rows_at: int
    events_at: int

    @property
    def size(self) -> int:
        """Return the size of the shared memory, bytes."""
        return _HEADER + self.rows * self.row + self.events * self.event


class Ring:
    """A ring buffer in shared memory: the open `file` with the name `path`. The file is locked while a process has it
    open.
    """

    def __init__(self, file: int, path: Path) -> None:
        self.file = file
        self.path = path
        self._memory = mmap.mmap(file, 0)
        self._numbers = memoryview(self._memory)[:_HEADER].cast("Q")
        self.shape = Shape(*self._numbers[_SHAPE : _SHAPE + len(Shape._fields)])
        self._events = _HEADER + self.shape.rows * self.shape.row

    @classmethod
    def create(cls, shape: Shape, uid: str) -> Self:
        """Return a new, empty ring for the recording `uid`. Raises OSError if there is no room for it.

        Rings of old runs that nobody has recovered are removed.
        """
        folders = _folders()
        for folder in folders:
            cls._remove_old(folder)
            path = _path(folder, uid)
            with suppress(OSError):
                file = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
                try:
                    return cls._filled(file, path, shape)
                except OSError:
                    path.unlink()
                    os.close(file)
        raise OSError(errno.ENOSPC, f"no room for {shape.size} bytes in {' or '.join(folders)}")

    @classmethod
    def _filled(cls, file: int, path: Path, shape: Shape) -> Self:
        lock(file, shared=True)
        head = memoryview(bytearray(_HEADER)).cast("Q")
        for place, number in enumerate(shape, _SHAPE):
            head[place] = number
        data = bytes(head) + bytes(shape.size - _HEADER)
        if os.write(file, data) != len(data):  # all of it now: memory that is full would end the process later
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return cls(file, path)

    @classmethod
    def _remove_old(cls, folder: str) -> None:
        for path in Path(folder).glob(_name("*")):
            with suppress(OSError):
                old = time.time() - path.stat().st_mtime > _KEPT
                if old and (ring := cls.left(path.stem.partition("-")[2])):
                    ring.remove()
                    ring.close()

    @classmethod
    def left(cls, uid: str) -> Self | None:
        """Return the ring of the recording `uid` if its two processes were killed; None if there is no such ring."""
        for folder in _folders():
            with suppress(OSError, ValueError):  # none; somebody else's; one that a process has; a name that is none
                path = _path(folder, uid)
                file = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
                try:
                    status = os.fstat(file)
                    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid():
                        raise PermissionError(errno.EPERM, f"{path} is not ours")
                    lock(file, shared=False)
                    return cls(file, path)
                except BaseException:
                    os.close(file)
                    raise
        return None

    @property
    def put(self) -> int:
        """Return the number of rows put so far."""
        return self._numbers[_PUT]

    @property
    def taken(self) -> int:
        """Return the number of rows taken so far; the operating system has these rows."""
        return self._numbers[_TAKEN]

    @property
    def events_taken(self) -> int:
        """Return the number of events taken so far; the operating system has these events."""
        return self._numbers[_EVENTS_TAKEN]

    @property
    def failure(self) -> int:
        """Return the number of the system error that ended the writing, 0 without an error."""
        return self._numbers[_FAILURE]

    @failure.setter
    def failure(self, number: int) -> None:
        self._numbers[_FAILURE] = number

    @property
    def closed(self) -> bool:
        """Return whether the control loop has declared that it puts nothing more."""
        return bool(self._numbers[_CLOSED])

    def end(self) -> None:
        """Declare that the control loop puts nothing more."""
        self._numbers[_CLOSED] = 1

    def add(self, row: bytes) -> int:
        """Put a row; return the number of rows that wait. If there is no room, the row is lost."""
        put = self._numbers[_PUT]
        waiting = put - self._numbers[_TAKEN]
        if waiting < self.shape.rows:
            at = _HEADER + put % self.shape.rows * self.shape.row
            self._memory[at : at + self.shape.row] = row
            self._numbers[_PUT] = put + 1  # last, so that the row is whole when it is seen
        return waiting + 1

    def add_event(self, event: bytes) -> None:
        """Put an event. If there is no room, the event is lost; the last place is reserved for `set_last_event`."""
        put = self._numbers[_EVENTS_PUT]
        if put < self.shape.events - 1:
            self._set_event(put, event)
            self._numbers[_EVENTS_PUT] = put + 1

    def set_last_event(self, event: bytes) -> None:
        """Set the event that the writing process adds if the recorder dies."""
        self._set_event(self.shape.events - 1, event)

    def _set_event(self, place: int, event: bytes) -> None:
        at = self._events + place * self.shape.event
        self._memory[at : at + self.shape.event] = event

    def event(self, place: int) -> bytes:
        """Return the event number `place`, from 0 in the order of putting; -1 is the reserved last event."""
        at = self._events + place % self.shape.events * self.shape.event
        return self._memory[at : at + self.shape.event]

    def waiting(self) -> bytes:
        """Return the bytes of the rows that were put and not taken; where the ring wraps around, only those before the
        wrap.
        """
        taken, put = self._numbers[_TAKEN], self._numbers[_PUT]
        place = taken % self.shape.rows
        count = min(put - taken, self.shape.rows - place)
        at = _HEADER + place * self.shape.row
        return self._memory[at : at + count * self.shape.row]

    def take(self, rows: int) -> None:
        """Declare that the operating system has the first `rows` rows of `waiting`."""
        self._numbers[_TAKEN] += rows

    def events_waiting(self) -> list[bytes]:
        """Return the events that were put and not taken."""
        return [self.event(place) for place in range(self._numbers[_EVENTS_TAKEN], self._numbers[_EVENTS_PUT])]

    def take_events(self, events: int) -> None:
        """Declare that the operating system has the first `events` events of `events_waiting`."""
        self._numbers[_EVENTS_TAKEN] += events

    def remove(self) -> None:
        """Remove the name of the shared memory, when the operating system has everything. Harmless if it has no
        name.
        """
        self.path.unlink(missing_ok=True)

    def close(self) -> None:
        """Release the shared memory."""
        self._numbers.release()
        self._memory.close()
        os.close(self.file)


def _folders() -> list[str]:
    """Return the folders for a ring: first one in memory, then one on a disk, where writing a row may have to wait."""
    with suppress(OSError):  # no folder for temporary files can be written
        return [_SHARED, tempfile.gettempdir()]
    return [_SHARED]


def _path(folder: str, uid: str) -> Path:
    """Return the path of the ring of the recording `uid`. Raises ValueError for a `uid` that hil does not generate."""
    return Path(folder, _name(str(uuid.UUID(uid))))


def _name(uid: str) -> str:
    return f"hil-{uid}.rows"
