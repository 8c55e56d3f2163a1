"""The process that writes the rows of a run in real time, so that the control loop never waits for the disk.

The process takes rows from a `Ring` until its standard input ends, because the recorder has closed it or has died. Then
the process writes all rows that are still in the ring. If the recorder has died, it adds an event that says so.
"""

from __future__ import annotations

import os
import select
import signal
import struct
import sys
import threading
import zlib
from contextlib import suppress

from hil.recording.posix import keep_durable
from hil.recording.ring import Ring

_PAUSE = 5e-3  # s between two looks at the ring
_DEAF_TO = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # meant for the recorder, which ramps down and closes us


def write(ring: Ring, file: int, recorder: int) -> None:
    """Write the rows of `ring` to the open `file`, until the pipe `recorder` ends."""
    ended = threading.Event()
    syncer = threading.Thread(target=_sync, args=(ring, file, ended), daemon=True)
    try:
        syncer.start()
    except RuntimeError:  # the system gives no thread: whoever started this process sees that it ended
        return
    with suppress(BrokenPipeError):  # the recorder is dead already
        os.write(1, b"\n")  # ready
    try:
        while not select.select([recorder], [], [], _PAUSE)[0]:
            drain(ring, file)
        finish(ring, file)
    except OSError as error:
        ring.failure = error.errno or 5
    ended.set()
    syncer.join()


def finish(ring: Ring, file: int) -> None:
    """Write the rows and events that are still in `ring` and flush them to the disk. Raises OSError."""
    drain(ring, file)
    if not ring.closed:
        _note_death(ring, file)
    os.fsync(file)


def drain(ring: Ring, file: int) -> None:
    """Write everything that waits in `ring`. Raises OSError."""
    shape = ring.shape
    while rows := ring.waiting():
        _write(file, rows, shape.rows_at + ring.taken * shape.row)
        ring.take(len(rows) // shape.row)
    for event in ring.events_waiting():
        _write(file, event, shape.events_at + ring.events_taken * shape.event)
        ring.take_events(1)


def _write(file: int, data: bytes, at: int) -> None:
    while data:
        written = os.pwrite(file, data, at)
        data, at = data[written:], at + written


def _sync(ring: Ring, file: int, ended: threading.Event) -> None:
    if error := keep_durable(file, ended):
        ring.failure = error.errno or 5


def _note_death(ring: Ring, file: int) -> None:
    """Write the event that the recorder has died, with the time of the last row."""
    at = ring.shape.rows_at + (ring.taken - 1) * ring.shape.row + 8
    time = os.pread(file, 8, at) if ring.taken else struct.pack("<d", 0.0)
    event = time + ring.event(-1)[8:-4]
    place = ring.events_taken
    _write(file, event + struct.pack("<I", zlib.crc32(event)), ring.shape.events_at + place * ring.shape.event)


if __name__ == "__main__":
    for number in _DEAF_TO:
        signal.signal(number, signal.SIG_IGN)
    write(Ring(int(sys.argv[1])), int(sys.argv[2]), 0)
