"""Write a recording: rows during the run, then the final file (the two stages of `hil.recording.reader`'s schema)."""

from __future__ import annotations

import errno
import json
import math
import os
import platform
import subprocess
import sys
import threading
import uuid
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple, Self

import h5py
import numpy as np

from hil.errors import Untrustworthy, WrongUse
from hil.recording.channels import END_MARK, Row, Rows, TorqueScale
from hil.recording.final import OVERHEAD, finalise, sign, write_attributes
from hil.recording.integrity import EVENT, LIVE, packed, packed_array, packed_event, second_header
from hil.recording.output import NameTaken, check_space, new_temporary, part_path, writing
from hil.recording.posix import is_at, keep_durable, remove, sync_folder, take_name, write_at
from hil.recording.reader import BLOCK, EVENTS, Array
from hil.recording.rescue import rescue
from hil.recording.ring import Ring


@dataclass(frozen=True, slots=True)
class Header:
    """The part of a recording that is known before its first row: everything except samples, events and end.

    torque_scale: how well the scale of the torque is known, as the drive states it; None without a drive.
    """

    profile: Mapping[str, str | float]
    stand_toml: str = ""
    truth: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    operator_note: str = ""
    command_line: str = ""
    torque_scale: TorqueScale | None = None


class Place(NamedTuple):
    """Where a second process writes: an open `.part`, and the byte offsets of its rows and events."""

    file: int
    rows_at: int
    events_at: int


class RecordingWriter:
    """Writes a recording in progress: the `.part` of the file `final`. The control loop calls `append` and never HDF5.

    Space for `length` rows is reserved on disk before anything moves. Rows are given to the operating system in batches
    of `batch` rows, so a killed process loses at most one batch. A thread flushes the file to the disk four times a
    second, so a power cut loses little more. The file is locked until it is closed, so that no other hil process
    removes it. path: of the `.part`. final: path of the finished file. moved: a sentence that says where the recording
    is, if its file was removed or replaced during the run. Raises WrongUse if the disk has too
    little space for the run, NameTaken if another recording has the name.
    """

    def __init__(self, path: Path, header: Header, length: int, *, batch: int = 10) -> None:
        self.path = part_path(path)
        self.final = path
        self.moved = ""
        self._pending: list[Row] = []
        self._batch = batch
        self._rows = 0
        self._events = 0
        self._file: int | None = None
        self._failure: OSError | None = None
        self._closing = threading.Event()
        self._syncer = threading.Thread(target=self._sync, daemon=True)
        with writing(self.path):
            if os.path.lexists(self.path):
                raise _taken(self.path)
            check_space(self.path, 2 * length * LIVE.itemsize + OVERHEAD)  # the second stage stands beside the first
            try:
                self._create(header, length)
            except BaseException:
                self.close()
                raise

    def _create(self, header: Header, length: int) -> None:
        """Create the `.part` under a temporary name and rename it when it is complete, so that a kill leaves no
        incomplete `.part`.
        """
        self._file, temporary = new_temporary(self.path)
        try:
            self._offset, self._event_offset = _fill_part(temporary, header, length)
            self._reserve(max(length, 1))
            self._file = take_name(self._file, temporary, self.path, replace=False)
        except FileExistsError:
            raise _taken(self.path) from None
        finally:
            with suppress(FileNotFoundError):  # it has its name
                temporary.unlink()
        sync_folder(self.path.parent)

    def _sync(self) -> None:
        # outside the control loop, which a slow disk must not stop; the next row that is written raises the failure
        if self._file is not None:
            self._failure = keep_durable(self._file, self._closing)

    @property
    def place(self) -> Place:
        """Return where a second process writes the rows, until `resume` is called."""
        if self._file is None:
            raise ValueError(f"{self.path} is closed")
        return Place(self._file, self._offset, self._event_offset)

    def resume(self, ring: Ring) -> None:
        """Continue to write in this process: first the rows and events that still wait in `ring`. Raises
        Untrustworthy.
        """
        self._rows, self._events = ring.taken, ring.events_taken
        while rows := ring.waiting():
            self._extend(rows)
            ring.take(len(rows) // LIVE.itemsize)
        for event in ring.events_waiting():
            self._add_event(event)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            if self._file is not None:
                self.flush()
        finally:
            self.close()

    def __len__(self) -> int:
        return self._rows + len(self._pending)

    def _reserve(self, length: int) -> None:
        """Write the second header, and the end mark into all rows.

        A disk without enough space is so noticed before the motor is on.
        """
        assert self._file is not None  # noqa: S101 - opened just above
        end = os.fstat(self._file).st_size  # as HDF5 has made it
        blank = packed([Row(END_MARK)]) * min(BLOCK, length)
        for start in range(0, length, BLOCK):
            self._write(blank[: (length - start) * LIVE.itemsize], self._offset + start * LIVE.itemsize)
        self._write(packed_event(math.nan, "", "") * EVENTS, self._event_offset)
        os.lseek(self._file, 0, os.SEEK_SET)
        header = os.read(self._file, self._offset)  # HDF5 has put everything but the two tables before the rows
        self._write(second_header(header), end)
        os.fsync(self._file)

    def _write(self, data: bytes, offset: int) -> None:
        if self._file is None:
            raise ValueError(f"{self.path} is closed")
        written = write_at(self._file, data, offset)
        if written != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _add(self, data: bytes, offset: int) -> None:
        try:
            if self._failure is not None:
                raise self._failure
            if self._syncer.ident is None:
                with suppress(RuntimeError):  # the system gives no thread: rows are then safe from a kill alone
                    self._syncer.start()
            self._write(data, offset)
        except OSError as error:
            raise Untrustworthy(
                f"{self.path} cannot be written any further ({error.strerror or error}): its rows so far are kept"
            ) from error

    def append(self, row: Row) -> None:
        """Add one row. Raises Untrustworthy if the disk fails."""
        self._pending.append(row)
        if len(self._pending) >= self._batch:
            self.flush()

    def extend(self, rows: Rows) -> None:
        """Add many rows, (n,) of ROW, and give them to the operating system. Raises Untrustworthy."""
        self._extend(packed_array(rows))

    def _extend(self, data: bytes) -> None:
        self._add(data, self._offset + self._rows * LIVE.itemsize)
        self._rows += len(data) // LIVE.itemsize

    def flush(self) -> None:
        """Give all rows so far to the operating system. Raises Untrustworthy if the disk fails."""
        if self._pending:
            self._extend(packed(self._pending))
            self._pending.clear()

    def event(self, time: float, code: str, message: str) -> None:
        """Add an event at `time` s. If the table of events is full, the event is dropped: samples are more important.

        Raises Untrustworthy if the disk fails.
        """
        if self._events < EVENTS:
            self._add_event(packed_event(time, code, message))

    def _add_event(self, event: bytes) -> None:
        self._add(event, self._event_offset + self._events * EVENT.itemsize)
        self._events += 1

    def finish(self, end_reason: str, *, force: bool = False, channels: Mapping[str, Array] | None = None) -> Path:
        """Write the final file, remove the `.part`, and return the path of the final file. If that fails, the `.part`
        is kept.

        force: replace an existing file. channels: (n,) each, SI, of all rows, if none was added. Raises WrongUse, and
        Untrustworthy if the disk fails.
        """
        self.flush()
        self._stop_syncing()
        if self._file is None:
            raise WrongUse(f"{self.path} is closed already")
        if not is_at(self._file, self.path):
            self._rescue(force=force)
        finalise(self.path, self.final, end_reason=end_reason, force=force, channels=channels)
        file, self._file = self._file, None
        remove(file, self.path)
        return self.final

    def _rescue(self, *, force: bool) -> None:
        """Copy the `.part`, whose name was removed, to a new name, and make the final file from the copy."""
        assert self._file is not None  # noqa: S101 - the caller has looked
        gone = self.path
        copy, self.path = rescue(self._file, self.final)
        os.close(self._file)
        self._file = copy
        if not self.final.parent.is_dir() or (os.path.lexists(self.final) and not force):
            self.final = self.path.with_suffix("")
        self.moved = f"{gone} was removed or replaced while it was recorded: its rows were rescued to {self.final}"

    def _stop_syncing(self) -> None:
        self._closing.set()
        if self._syncer.is_alive():
            self._syncer.join()

    def close(self) -> None:
        """Close the file and keep it as it is. Harmless if already closed."""
        self._stop_syncing()
        if self._file is not None:
            file, self._file = self._file, None
            os.close(file)

    def discard(self) -> None:
        """Remove the recording, if it has no row worth keeping. Harmless if already closed."""
        self._pending.clear()
        self._stop_syncing()
        if self._file is not None and is_at(self._file, self.path):
            file, self._file = self._file, None
            remove(file, self.path)
        self.close()


def _taken(path: Path) -> NameTaken:
    return NameTaken(f"{path} is another recording that has not ended (File exists): choose another name")


def _fill_part(path: Path, header: Header, length: int) -> tuple[int, int]:
    """Write the header and the empty tables of a `.part` into the locked file. Return the byte offsets of the rows and
    of the events.
    """
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_LATEST, h5py.h5f.LIBVER_LATEST)
    access.set_file_locking(False, True)  # we have locked it already
    access.set_sieve_buf_size(0)  # of a write that waits in its memory while the disk is full, HDF5 crashes
    with h5py.File(h5py.h5f.create(os.fsencode(path), h5py.h5f.ACC_TRUNC, fapl=access)) as file:
        _write_header(file, header)
        file.attrs.update(complete=False, end_reason="")
        sign(file, header.truth, [])
        tables = _contiguous(file, "live", length, LIVE), _contiguous(file, "live_events", EVENTS, EVENT)
        file.flush()  # many attributes get their place in the file only now
        return _reserve_contiguous(tables[0]), _reserve_contiguous(tables[1])


def _contiguous(file: h5py.File, name: str, length: int, dtype: np.dtype[Any]) -> h5py.Dataset:
    """Return a new table without a place in the file, so that all that describes the file comes before the tables."""
    settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    settings.set_layout(h5py.h5d.CONTIGUOUS)
    settings.set_alloc_time(h5py.h5d.ALLOC_TIME_LATE)
    settings.set_fill_time(h5py.h5d.FILL_TIME_NEVER)  # RecordingWriter fills it itself, with plain writes
    space = h5py.h5s.create_simple((max(length, 1),))  # HDF5 gives an empty dataset no place
    return h5py.Dataset(
        h5py.h5d.create(file.id, name.encode(), h5py.h5t.py_create(dtype, logical=True), space, settings)
    )


def _reserve_contiguous(table: h5py.Dataset) -> int:
    """Give a table its place in the file, and return the byte offset."""
    table[0] = np.zeros((), table.dtype)
    offset = table.id.get_offset()
    if offset is None:
        raise OSError(f"{table.name} has no place in the file")
    return int(offset)


def _write_header(file: h5py.File, header: Header) -> None:
    attributes = {
        "uid": str(uuid.uuid4()),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": json.dumps(_software()),
        "host": platform.node(),
        "command_line": header.command_line,
        "seed": header.seed,
        "stand_toml": header.stand_toml,
        "operator_note": header.operator_note,
    }
    if header.torque_scale is not None:
        attributes |= header.torque_scale.attributes()
    write_attributes(file, attributes, header.profile, header.truth)


def _software() -> dict[str, str]:
    versions = {"python": platform.python_version(), "os": sys.platform}
    for name in ("hil", "numpy", "h5py", "numba"):
        with suppress(PackageNotFoundError):  # a checkout that is run without being installed has none
            versions[name] = version(name)
    checkout = Path(__file__).parents[2]
    if (checkout / ".git").exists():
        with suppress(OSError, subprocess.SubprocessError):
            command = ["git", "-C", str(checkout), "rev-parse", "HEAD"]
            answer = subprocess.run(command, capture_output=True, text=True, timeout=2, check=True)  # noqa: S603 - fixed words
            versions["revision"] = answer.stdout.strip()
    return versions


def write(path: Path, header: Header, channels: Mapping[str, Array], *, force: bool = False) -> None:
    """Write a complete recording at once, for data that hil did not record.

    channels: arrays (n,) in SI, by the names in CHANNELS; a missing channel is stored as NaN. force: replace an
    existing file. Raises WrongUse.
    """
    channels = dict(zip(channels, np.broadcast_arrays(*channels.values()), strict=True))
    with RecordingWriter(path, header, 0) as writer:
        try:
            writer.finish("done", force=force, channels=channels)
        except BaseException:
            writer.discard()
            raise
