"""A recording while it is made, and its turning into the final file: the two stages of `hil.store`'s schema."""

from __future__ import annotations

import hashlib
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
from typing import Any, Self

import h5py
import numpy as np

from hil.store import BLOCK, CHANNELS, END_MARK, EVENT, EVENTS, ROW, SCHEMA, Array, Event, Recording, Rows
from hil.target import check_space, part_path, writing

_OVERHEAD = 1 << 18  # bytes of a file that are not samples, generously
_DURABLE = 0.25  # s between two requests that the disk keep what it was given

Row = tuple[float, ...]
"""The fields of one row, in the order of CHANNELS."""


@dataclass(frozen=True, slots=True)
class Header:
    """What is known before the first row: everything of the file but its samples, events and end."""

    profile: Mapping[str, str | float]
    stand_toml: str = ""
    truth: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    operator_note: str = ""
    command_line: str = ""


def missing_row(seq: int) -> Row:
    """A row with nothing in it but its number."""
    return (seq, *([math.nan] * (len(CHANNELS) - 2)), 0)


class PartFile:
    """A recording in progress. The control loop calls `append` and nothing of HDF5.

    `length` rows are reserved on disk before anything moves. Rows are handed to the operating system in batches of
    `batch` rows, so a killed process loses at most one batch; a thread makes them durable four times a second, so a
    power cut loses little more.
    Raises WrongUse where the target cannot hold the run.
    """

    def __init__(self, path: Path, header: Header, length: int, *, batch: int = 10) -> None:
        self.path = part_path(path)
        self._final = path
        self._pending: list[Row] = []
        self._batch = batch
        self._rows = 0
        self._events = 0
        self._file: int | None = None
        self._closing = threading.Event()
        self._syncer = threading.Thread(target=self._keep_durable, daemon=True)
        with writing(self.path):
            check_space(self.path, 2 * length * ROW.itemsize + _OVERHEAD)  # the second stage stands beside the first
            try:
                self._offset, self._event_offset = _create_part(self.path, header, length)
                self._file = os.open(self.path, os.O_RDWR | getattr(os, "O_BINARY", 0))
                self._reserve(length)
            except FileExistsError:
                raise  # another recorder's, which is not ours to remove
            except BaseException:
                self.discard()
                raise
        self._syncer.start()

    def _keep_durable(self) -> None:
        # outside the control loop, which a slow disk must not stop
        while not self._closing.wait(_DURABLE) and self._file is not None:
            os.fsync(self._file)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._file is not None:
            self.flush()
            self.close()

    def __len__(self) -> int:
        return self._rows + len(self._pending)

    def _reserve(self, length: int) -> None:
        """Write the end mark over every row: a full disk shows now, not with the motor on."""
        blank = np.full(BLOCK, np.array(missing_row(int(END_MARK)), dtype=ROW))
        for start in range(0, length, BLOCK):
            self._write(blank[: length - start], self._offset + start * ROW.itemsize)
        events = np.full(EVENTS, np.array((math.nan, b"", b""), dtype=EVENT))
        self._write(events, self._event_offset)
        assert self._file is not None  # noqa: S101 - opened just above
        os.fsync(self._file)

    def _write(self, rows: Rows, offset: int) -> None:
        if self._file is None:
            raise ValueError(f"{self.path} is closed")
        data = rows.tobytes()
        written = _write_at(self._file, data, offset)
        if written != len(data):
            raise OSError(f"{self.path}: {written} of {len(data)} bytes were written; is the disk full?")

    def append(self, row: Row) -> None:
        """Take one row, its fields in the order of CHANNELS."""
        self._pending.append(row)
        if len(self._pending) >= self._batch:
            self.flush()

    def extend(self, rows: Rows) -> None:
        """Take many rows, (n,) of ROW, and hand them to the operating system."""
        self._write(rows, self._offset + self._rows * ROW.itemsize)
        self._rows += len(rows)

    def flush(self) -> None:
        """Hand the pending rows to the operating system."""
        if self._pending:
            self.extend(np.array(self._pending, dtype=ROW))
            self._pending.clear()

    def event(self, time: float, code: str, message: str) -> None:
        """Note something that happened. Past the table's end the note is dropped: samples matter more."""
        if self._events < EVENTS:
            entry = np.array([(time, code.encode()[:32], message.encode()[:200])], dtype=EVENT)
            self._write(entry, self._event_offset + self._events * EVENT.itemsize)
            self._events += 1

    def finish(self, end_reason: str) -> Path:
        """Write the final file in place of the `.part` and return its path. The `.part` stays if that fails."""
        self.flush()
        self.close()
        finalise(self.path, self._final, end_reason=end_reason)
        self.path.unlink()
        return self._final

    def close(self) -> None:
        """Let go of the file, keeping it as it is. Harmless when already closed."""
        self._closing.set()
        if self._syncer.is_alive():
            self._syncer.join()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def discard(self) -> None:
        """Remove a recording in which nothing was recorded."""
        self.close()
        with suppress(FileNotFoundError):
            self.path.unlink()


def _write_at(file: int, data: bytes, offset: int) -> int:
    if hasattr(os, "pwrite"):
        return os.pwrite(file, data, offset)
    os.lseek(file, offset, os.SEEK_SET)  # Windows has no pwrite; one writer, so seek and write is the same
    return os.write(file, data)


def _create_part(path: Path, header: Header, length: int) -> tuple[int, int]:
    """A `.part` with all but its rows; the byte offsets of the rows and of the events."""
    with h5py.File(path, "x", libver="latest") as file:  # never over another recording in progress
        _write_header(file, header)
        file.attrs.update(complete=False, end_reason="")
        return _reserve_contiguous(file, "live", length, ROW), _reserve_contiguous(file, "live_events", EVENTS, EVENT)


def _reserve_contiguous(file: h5py.File, name: str, length: int, dtype: np.dtype[Any]) -> int:
    settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    settings.set_layout(h5py.h5d.CONTIGUOUS)
    settings.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    settings.set_fill_time(h5py.h5d.FILL_TIME_NEVER)  # PartFile fills it itself, with plain writes
    space = h5py.h5s.create_simple((max(length, 1),))  # HDF5 gives an empty dataset no place
    dataset = h5py.h5d.create(file.id, name.encode(), h5py.h5t.py_create(dtype, logical=True), space, settings)
    offset = dataset.get_offset()
    if offset is None:
        raise OSError(f"{name} was given no place in the file")
    return int(offset)


def _write_header(file: h5py.File, header: Header) -> None:
    file.attrs.update(
        schema=SCHEMA,
        uid=str(uuid.uuid4()),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        software=json.dumps(_software()),
        host=platform.node(),
        command_line=header.command_line,
        seed=header.seed,
        stand_toml=header.stand_toml,
        operator_note=header.operator_note,
    )
    file.create_group("profile").attrs.update(header.profile)
    if header.truth:
        file.create_group("truth").attrs.update(header.truth)


def _software() -> dict[str, str]:
    versions = {"python": platform.python_version(), "os": sys.platform}
    for name in ("hil", "numpy", "h5py", "numba"):
        with suppress(PackageNotFoundError):  # a checkout that is run without being installed has none
            versions[name] = version(name)
    checkout = Path(__file__).parent.parent
    if (checkout / ".git").exists():
        with suppress(OSError, subprocess.SubprocessError):
            command = ["git", "-C", str(checkout), "rev-parse", "HEAD"]
            answer = subprocess.run(command, capture_output=True, text=True, timeout=2, check=True)  # noqa: S603 - fixed words
            versions["revision"] = answer.stdout.strip()
    return versions


def finalise(source: Path, target: Path, *, end_reason: str | None = None) -> int:
    """Write the recording in `source` (either layout) to `target` in the final layout.

    The target appears whole or not at all, and `source` is not touched. `end_reason` None marks it as recovered.
    Returns the number of samples.
    Raises WrongUse where the target cannot be written.
    """
    with Recording(source) as recording, writing(target):
        temporary = target.with_name(target.name + ".tmp")
        check_space(temporary, len(recording) * ROW.itemsize + _OVERHEAD)
        try:
            with h5py.File(temporary, "w", libver="latest") as file:
                _copy_attributes(recording, file)
                file.attrs["complete"] = end_reason == "done"
                file.attrs["end_reason"] = "recovered" if end_reason is None else end_reason
                file.attrs["sha256"] = _write_samples(file, recording)
                _write_events(file, recording.events())
            _replace(temporary, target)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
        return len(recording)


def write(path: Path, header: Header, channels: Mapping[str, Array]) -> None:
    """Write a whole recording at once, for data that was not recorded here.

    channels: (n,) arrays in SI, named as in CHANNELS; the ones not given are NaN. Raises WrongUse.
    """
    length = len(channels["time"])
    rows = np.full(length, np.array(missing_row(0), dtype=ROW))
    rows["seq"] = np.arange(length)
    for name, values in channels.items():
        rows[name] = values
    with PartFile(path, header, length) as part:
        try:
            part.extend(rows)
            part.finish("done")
        except BaseException:
            part.discard()
            raise


def _copy_attributes(recording: Recording, file: h5py.File) -> None:
    file.attrs.update(recording.attributes)
    file.create_group("profile").attrs.update(recording.profile)
    truth = recording.truth()
    if truth:
        file.create_group("truth").attrs.update(truth)


def _write_samples(file: h5py.File, recording: Recording) -> str:
    group = file.create_group("samples")
    length = len(recording)
    for name, (unit, description) in CHANNELS.items():
        dataset = group.create_dataset(
            name,
            shape=(length,),
            dtype=ROW[name],
            chunks=(min(4096, max(length, 1)),),
            shuffle=True,
            compression="gzip",
            compression_opts=4,
            fletcher32=True,
        )
        dataset.attrs.update(unit=unit, description=description)
    digest = hashlib.sha256()
    for start, rows in recording.rows():
        for name in CHANNELS:
            group[name][start : start + len(rows)] = rows[name]
        digest.update(rows.tobytes())
    return digest.hexdigest()


def _write_events(file: h5py.File, events: list[Event]) -> None:
    group = file.create_group("events")
    text = h5py.string_dtype()
    group.create_dataset("time", data=np.array([event.time for event in events], dtype="<f8"))
    group.create_dataset("code", data=np.array([event.code for event in events], dtype=object), dtype=text)
    group.create_dataset("message", data=np.array([event.message for event in events], dtype=object), dtype=text)


def _replace(temporary: Path, target: Path) -> None:
    """Make the new file durable, then let it appear under its name."""
    with temporary.open("rb+") as file:
        os.fsync(file.fileno())
    temporary.replace(target)
    if hasattr(os, "O_DIRECTORY"):
        folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
