"""The memory that the guardian and the guarded process share: four numbers, each written by one of the two.

Times are in ns as `now` returns them; every process of a computer reads the same time.
"""

from __future__ import annotations

import mmap
import os
from enum import IntEnum

from drivers.clock import machine_time

SIZE = 64


def now() -> int:
    """Return the time of `drivers.clock.machine_time`, ns."""
    return int(machine_time() * 1e9)


class Word(IntEnum):
    """The numbers in the memory that the guardian shares with the guarded process.

    Written by the guarded process: DUE, when its next sign of life is due (0: none is expected), and LATEST, when the
    torque must be off in any case (0: never). Written by the guardian: ALIVE, when it last checked, and FIRED, why it
    switched the torque off (a `Reason`; 0: it did not).
    """

    DUE = 0
    LATEST = 1
    ALIVE = 2
    FIRED = 3


class Reason(IntEnum):
    """Why the guardian switched the torque off."""

    GONE = 1
    STOPPED = 2
    LATE = 3
    TOO_LONG = 4
    ASKED = 5


class Words:
    """The shared memory in the open file `descriptor`. Closing it also closes the file.

    A number is read and written atomically, because it is one machine word.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, SIZE)
        self._words = memoryview(self._memory).cast("q")

    def __getitem__(self, word: Word) -> int:
        return self._words[word]

    def __setitem__(self, word: Word, value: int) -> None:
        self._words[word] = value

    def close(self) -> None:
        """Release the memory."""
        self._words.release()
        self._memory.close()
        os.close(self.descriptor)
