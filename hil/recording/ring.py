"""The shared memory through which rows and events pass from the control loop to the writing process.

The control loop puts rows, the writing process takes rows, and neither waits for the other. If one of the two dies, the
other has all rows; if both die, the rows that nobody has taken are lost. The module does not import numpy, so that the
writing process starts quickly.
"""

from __future__ import annotations

import mmap
import os
from array import array
from typing import NamedTuple, Self

from hil.child import shared_memory

_HEADER = 128  # bytes, of 8 each
_PUT, _TAKEN, _EVENTS_PUT, _EVENTS_TAKEN, _CLOSED, _FAILURE, _SHAPE = range(7)


class Shape(NamedTuple):
    """The sizes of a ring and of the file that its rows are written to.

    rows, row: number of rows that the ring has room for, and bytes of a row. events, event: number of events, and bytes
    of an event. rows_at, events_at: byte offsets of the first row and of the first event in the file. The last
    place for an event is kept for the writing process, which fills it if the recorder dies.
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
    """A ring buffer in the shared memory of the open file `file`."""

    def __init__(self, file: int) -> None:
        self.file = file
        self._memory = mmap.mmap(file, 0)
        self._numbers = memoryview(self._memory)[:_HEADER].cast("Q")
        self.shape = Shape(*self._numbers[_SHAPE : _SHAPE + len(Shape._fields)])
        self._events = _HEADER + self.shape.rows * self.shape.row

    @classmethod
    def create(cls, shape: Shape) -> Self:
        """Return a new, empty ring. Raises OSError if there is no room for it."""
        file = shared_memory(shape.size)
        head = memoryview(bytearray(_HEADER)).cast("Q")
        head[_SHAPE : _SHAPE + len(shape)] = array("Q", shape)
        os.pwrite(file, head, 0)
        return cls(file)

    @property
    def put(self) -> int:
        """Return the number of rows put so far."""
        return self._numbers[_PUT]

    @property
    def taken(self) -> int:
        """Return the number of rows taken so far. They survive a crash of this process."""
        return self._numbers[_TAKEN]

    @property
    def events_taken(self) -> int:
        """Return the number of events taken so far. They survive a crash of this process."""
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

    def close(self) -> None:
        """Release the shared memory."""
        self._numbers.release()
        self._memory.close()
        os.close(self.file)
