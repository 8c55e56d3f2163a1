"""Rows and events on their way from the control loop to the process that writes them, in memory that both share.

One process puts, one takes, and neither waits for the other. The memory has no name: it lives as long as one of the two
has it open, so that the rows outlive the death of either. Imports no numpy, since the writing process must start soon.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from typing import NamedTuple, Self

_HEADER = 128  # bytes, of 8 each
_PUT, _TAKEN, _EVENTS_PUT, _EVENTS_TAKEN, _CLOSED, _FAILURE, _SHAPE = range(7)


class Shape(NamedTuple):
    """What a ring holds, and where it goes: rows of `row` bytes that fit, events of `event` bytes that fit.

    rows_at, events_at: byte offsets in the file of the first of each. The last event is what the writing process adds
    where the recorder died.
    """

    rows: int
    row: int
    events: int
    event: int
    rows_at: int
    events_at: int

    @property
    def size(self) -> int:
        """Return the bytes of the shared memory."""
        return _HEADER + self.rows * self.row + self.events * self.event


class Ring:
    """Shared memory for `shape`, open as the descriptor `file`."""

    def __init__(self, file: int, shape: Shape) -> None:
        self.file = file
        self.shape = shape
        self._memory = mmap.mmap(file, shape.size)
        self._numbers = memoryview(self._memory)[:_HEADER].cast("Q")
        self._events = _HEADER + shape.rows * shape.row

    @classmethod
    def create(cls, shape: Shape) -> Self:
        """Return a new, empty one."""
        if hasattr(os, "memfd_create"):
            file = os.memfd_create("hil")
        else:
            with tempfile.TemporaryFile() as unnamed:
                file = os.dup(unnamed.fileno())
        os.truncate(file, shape.size)
        ring = cls(file, shape)
        for place, number in enumerate(shape, _SHAPE):
            ring._numbers[place] = number
        return ring

    @classmethod
    def opened(cls, file: int) -> Self:
        """Return one that another process has created."""
        with mmap.mmap(file, _HEADER) as head:
            numbers = memoryview(head).cast("Q")
            shape = Shape(*numbers[_SHAPE : _SHAPE + len(Shape._fields)])
            numbers.release()
        return cls(file, shape)

    @property
    def put(self) -> int:
        """Rows that were put so far."""
        return self._numbers[_PUT]

    @property
    def taken(self) -> int:
        """Rows that were taken and are with the operating system."""
        return self._numbers[_TAKEN]

    @property
    def events_taken(self) -> int:
        """Events that were taken and are with the operating system."""
        return self._numbers[_EVENTS_TAKEN]

    @property
    def failure(self) -> int:
        """The number of the system's error that ended the writing, 0 without one."""
        return self._numbers[_FAILURE]

    @failure.setter
    def failure(self, number: int) -> None:
        self._numbers[_FAILURE] = number

    @property
    def closed(self) -> bool:
        """Whether nothing more will be put."""
        return bool(self._numbers[_CLOSED])

    def end(self) -> None:
        """Say that nothing more will be put."""
        self._numbers[_CLOSED] = 1

    def add(self, row: bytes) -> int:
        """Put a row; return how many are waiting. One for which there is no room is lost."""
        put = self._numbers[_PUT]
        waiting = put - self._numbers[_TAKEN]
        if waiting < self.shape.rows:
            at = _HEADER + put % self.shape.rows * self.shape.row
            self._memory[at : at + self.shape.row] = row
            self._numbers[_PUT] = put + 1  # last, so that the row is whole when it is seen
        return waiting + 1

    def add_event(self, event: bytes) -> None:
        """Put an event. One for which there is no room is lost; the last place is that of `set_last_event`."""
        put = self._numbers[_EVENTS_PUT]
        if put < self.shape.events - 1:
            self._set_event(put, event)
            self._numbers[_EVENTS_PUT] = put + 1

    def set_last_event(self, event: bytes) -> None:
        """Set the event for the case that the recorder dies."""
        self._set_event(self.shape.events - 1, event)

    def _set_event(self, place: int, event: bytes) -> None:
        at = self._events + place * self.shape.event
        self._memory[at : at + self.shape.event] = event

    def event(self, place: int) -> bytes:
        """Return an event, by its place in the order in which they were put; -1 is the last event of all."""
        at = self._events + place % self.shape.events * self.shape.event
        return self._memory[at : at + self.shape.event]

    def waiting(self) -> bytes:
        """Return rows that were put and not taken: all, or those up to the end of the memory."""
        taken, put = self._numbers[_TAKEN], self._numbers[_PUT]
        place = taken % self.shape.rows
        count = min(put - taken, self.shape.rows - place)
        at = _HEADER + place * self.shape.row
        return self._memory[at : at + count * self.shape.row]

    def take(self, rows: int) -> None:
        """Say that `rows` rows of `waiting` are with the operating system."""
        self._numbers[_TAKEN] += rows

    def events_waiting(self) -> list[bytes]:
        """Return the events that were put and not taken."""
        return [self.event(place) for place in range(self._numbers[_EVENTS_TAKEN], self._numbers[_EVENTS_PUT])]

    def take_events(self, events: int) -> None:
        """Say that `events` events of `events_waiting` are with the operating system."""
        self._numbers[_EVENTS_TAKEN] += events

    def close(self) -> None:
        """Give the memory up."""
        self._numbers.release()
        self._memory.close()
        os.close(self.file)
