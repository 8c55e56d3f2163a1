"""Recordings on disk: HDF5, schema `hil-recording/2`. One file, one recording, one axis.

Layout of a finished file (all numbers little-endian, SI)::

    /                attrs: schema, uid, created (ISO 8601 UTC), complete (bool), end_reason, software (JSON), host,
                     command_line, seed, stand_toml (the whole file), operator_note, sha256 (of the samples)
    /samples/        one 1-D dataset a channel, equal length, attrs unit and description: see hil.recording.channels
    /profile/        attrs: kind, mode ("torque" or "position"), amplitude (N m or rad at the joint), duration (s),
                     band_low, band_high (Hz), fade (s, at each end), seed, setpoints (the CSV of kind "file"), rate
                     (Hz); of an import: kind, source, where
    /events/         time (s), code, message
    /truth/          attrs, only from a simulator: the true Kc, Bc, ...; never read by identification

`sha256` is over the rows in order, each the 8-byte fields of ROW: the bytes of the arrays that `rows()` yields.
`hil-recording/1` differs in the names of two attributes of /profile: "quantity" for mode and "soft" for fade.

A recording in progress is `NAME.h5.part`: the same groups, except that the samples are one contiguous compound dataset
`/live` and the events one `/live_events`, both preallocated and filled with the end mark. HDF5 is closed before the
first row, and rows are written straight to the dataset's offset, so that the metadata never changes and the file is
legal at every moment. A row is valid once its `seq` equals its index. Every reader here takes both layouts.
"""

from __future__ import annotations

import hashlib
import json
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import h5py
import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from hil.errors import Untrustworthy, WrongUse
from hil.recording.channels import CHANNELS, LATER, ROW, Rows

SCHEMA = "hil-recording/2"
RENAMED: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {"hil-recording/1": MappingProxyType({"quantity": "mode", "soft": "fade"}), SCHEMA: MappingProxyType({})}
)
"""The schemas that are read, each with what it called attributes of /profile that have another name now."""
BLOCK = 65536
"""Rows handled at a time, so that no recording is ever in memory whole."""

EVENT = np.dtype([("time", "<f8"), ("code", "S32"), ("message", "S200")])
EVENTS = 256
"""Events that a recording in progress has room for."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Event:
    """An event at `time` s: a short code and a sentence."""

    time: float
    code: str
    message: str


class Recording:
    """An open recording, finished or not; `len()` is its rows.

    attributes: the root's. profile: the excitation, by the names of SCHEMA whichever schema the file has. complete:
    whether it ended as planned. live: whether it is still in the first stage's layout.
    Raises WrongUse for a file that is no recording or has an unknown schema, Untrustworthy for a damaged one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = _open(path)
        try:
            with _legible(path):
                _refuse_foreign_storage(self._file, path)
                self.attributes = {name: _plain(self._file.attrs[name]) for name in self._file.attrs}
                names = self._renamed()
                profile = self._group("profile").attrs.items()
                self.profile = {names.get(name, name): _plain(value) for name, value in profile}
                self.live = "live" in self._file
                self.complete = bool(self.attributes.get("complete", False))
                self._length = self._count_live() if self.live else self._check_samples()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._length

    @property
    def stand_toml(self) -> str:
        """The stand file it was recorded with, "" without one."""
        return str(self.attributes.get("stand_toml", ""))

    def rows(self, block: int = BLOCK) -> Iterator[tuple[int, Rows]]:
        """Yield the rows in order, `block` at a time with the index of the first. Raises Untrustworthy."""
        for start in range(0, self._length, block):
            stop = min(start + block, self._length)
            rows = self._read("live", start, stop) if self.live else np.empty(stop - start, dtype=ROW)
            for name in () if self.live else CHANNELS:
                rows[name] = self._column(name, start, stop)
            yield start, rows

    def channel(self, name: str, start: int = 0, stop: int | None = None) -> Array:
        """Return rows `start` to `stop` (None: the last) of one channel, (n,) float64 in its SI unit.

        Raises Untrustworthy where the file is damaged.
        """
        stop = self._length if stop is None else min(stop, self._length)
        return np.asarray(self._column(name, start, stop), dtype=np.float64)

    def events(self) -> list[Event]:
        """Return the events of the run, in order. Raises WrongUse for a damaged file."""
        with _legible(self.path):
            if self.live:
                return [
                    Event(float(row["time"]), *(row[name].decode(errors="replace") for name in ("code", "message")))
                    for row in self._file["live_events"][:EVENTS]
                    if row["code"]
                ]
            group = self._group("events")
            text = (group["code"].asstr()[()], group["message"].asstr()[()])
            rows = zip(group["time"], *text, strict=True)
            return [Event(float(time), str(code), str(message)) for time, code, message in rows]

    def truth(self) -> dict[str, float]:
        """Return the simulator's own parameters, {} for a real stand. Identification never calls this."""
        with _legible(self.path):
            group = self._file.get("truth")
            return {} if group is None else {name: float(value) for name, value in group.attrs.items()}

    def verify(self) -> bool:
        """Return whether the samples still have the hash they were written with; True for an unfinished recording."""
        digest = hashlib.sha256()
        present = [name for name in CHANNELS if self.live or f"samples/{name}" in self._file]
        for _, rows in self.rows():
            digest.update(repack_fields(rows[present]).tobytes())
        return self.live or digest.hexdigest() == self.attributes.get("sha256")

    def _column(self, name: str, start: int, stop: int) -> Any:
        if self.live:
            return self._read("live", start, stop)[name]
        if name in LATER and f"samples/{name}" not in self._file:
            return np.full(stop - start, np.nan)
        return self._read(f"samples/{name}", start, stop)

    def _read(self, name: str, start: int, stop: int) -> Any:
        try:
            return self._file[name][start:stop]
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            raise Untrustworthy(f"{self.path}: {name} is damaged and cannot be read ({_first_line(error)})") from error

    def _group(self, name: str) -> h5py.Group:
        group = self._file.get(name)
        if not isinstance(group, h5py.Group):
            raise WrongUse(f"{self.path} has no group /{name}: it is not a complete recording")
        return group

    def _renamed(self) -> Mapping[str, str]:
        """Return the attributes of /profile that have another name now. Raises WrongUse for an unknown schema."""
        schema = str(self.attributes.get("schema", ""))
        if not schema.startswith("hil-recording/"):
            raise WrongUse(f"{self.path} is HDF5 but not a recording of hil: bring its data in with `hil import`")
        if schema not in RENAMED:
            raise WrongUse(
                f"{self.path} has schema {schema!r}, written by {_writer(self.attributes)}; this hil reads "
                f"{', '.join(RENAMED)}: read it with the version that wrote it"
            )
        return RENAMED[schema]

    def _count_live(self) -> int:
        """Return the number of rows before the first whose `seq` is not its index."""
        live = self._file["live"]
        if live.dtype != ROW:
            raise WrongUse(f"{self.path}: /live has other fields than {SCHEMA}: use the hil that wrote it")
        for start in range(0, len(live), BLOCK):
            seq = live[start : start + BLOCK]["seq"]
            invalid = np.flatnonzero(seq != np.arange(start, start + len(seq), dtype=np.uint64))
            if invalid.size:
                return start + int(invalid[0])
        return len(live)

    def _check_samples(self) -> int:
        samples = self._group("samples")
        names = [name for name in CHANNELS if name not in LATER or name in samples]
        absent = [name for name in names if not isinstance(samples.get(name), h5py.Dataset)]
        if absent:
            raise WrongUse(f"{self.path}: /samples lacks {', '.join(absent)}: it is not a complete recording")
        for name in names:
            if samples[name].ndim != 1 or samples[name].dtype.kind not in "fiu":
                raise WrongUse(f"{self.path}: /samples/{name} is not one column of numbers")
        lengths = {name: len(samples[name]) for name in names}
        if len(set(lengths.values())) > 1:
            odd = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise WrongUse(f"{self.path}: channels of unequal length ({odd}): the file was not written completely")
        return lengths["time"]


@contextmanager
def _legible(path: Path) -> Iterator[None]:
    """Turn any exception from damaged metadata into a WrongUse: HDF5 and h5py raise many kinds."""
    try:
        yield
    except (WrongUse, Untrustworthy):
        raise
    except Exception as error:
        raise WrongUse(f"{path} is damaged and cannot be read ({_first_line(error)}): use a copy of it") from error


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _open(path: Path) -> h5py.File:
    """Open an ordinary HDF5 file read-only; a FIFO or a device would block the reader."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise WrongUse(f"{path} cannot be opened ({error.strerror}): check the name") from None
    if not stat.S_ISREG(mode):
        raise WrongUse(f"{path} is not a file: name a recording such as recordings/run1.h5")
    with _legible(path):
        try:
            return h5py.File(path, "r")
        except PermissionError:
            raise WrongUse(f"{path} cannot be opened (permission denied)") from None
        except OSError as error:
            raise WrongUse(f"{path} is not HDF5, or is cut off: bring CSV data in with `hil import`") from error


def _refuse_foreign_storage(file: h5py.File, path: Path) -> None:
    """Raise WrongUse for links out of the file, external or virtual storage: it must not read other files."""
    for group in (file, *(file.get(name) for name in ("samples", "events") if _is_hard(file, name))):
        for name in group if isinstance(group, h5py.Group) else ():
            if not _is_hard(group, name):
                raise WrongUse(f"{path}: {name} is a link to somewhere else: such a file is not opened")
            item = group[name]
            if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
                raise WrongUse(f"{path}: {name} keeps its data in another file: such a file is not opened")


def _is_hard(group: h5py.Group, name: str) -> bool:
    return isinstance(group.get(name, getlink=True), h5py.HardLink)


def _writer(attributes: Mapping[str, Any]) -> str:
    """Return the name of the program that wrote a recording."""
    try:
        return f"hil {json.loads(attributes['software'])['hil']}"
    except (KeyError, TypeError, ValueError):
        return "an unknown version of hil"


def _plain(value: Any) -> Any:
    """Return an attribute as Python's own type."""
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return value.item() if isinstance(value, np.generic) else value
