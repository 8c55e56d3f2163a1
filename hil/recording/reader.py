"""Recordings on disk: HDF5, schema `hil-recording/3`. One file, one recording, one axis.

Layout of a finished file (all numbers little-endian, SI)::

    /                attrs: schema, uid, created (ISO 8601 UTC), complete (bool), end_reason, software (JSON), host,
                     command_line, seed, stand_toml (the whole file), operator_note, sha256 (of the samples),
                     sha256_stored (of the stored bytes), sha256_header (of the rest), lateness_p50, lateness_p99,
                     lateness_max (s, of the set-points; NaN for other data), missed (ticks that were skipped),
                     torque_uncertainty, torque_scale (a run's, see `hil.recording.channels.TorqueScale`)
    /samples/        one 1-D dataset a channel, equal length, attrs unit and description: see hil.recording.channels;
                     torque and joint_torque are one dataset with two names where they are equal
    /profile/        attrs: kind, mode ("torque" or "position"), amplitude (N m or rad at the joint), duration (s),
                     band_low, band_high (Hz), fade (s, at each end), seed, setpoints (the CSV of kind "file"), rate
                     (Hz); of an import: kind, source, where
    /events/         time (s), code, message
    /truth/          attrs, only from a simulator: the true Kc, Bc, ...; never read by identification

Three hashes tell whether the file was changed; `hil.recording.integrity` computes them:

- `sha256`: of the rows in order, each as the 8-byte fields of ROW, which are the bytes of the arrays that `rows()`
  yields.
- `sha256_stored`: of the compressed chunks. Old recordings lack it, and it is wrong after another program has
  compressed the file again. The rows are unchanged if one of these two hashes is right.
- `sha256_header`: of the attributes (with `sha256`), the profile, the truth and the events; "" if the recording was
  recovered from a file that had been changed.

Older schemas: `hil-recording/2` has no `sha256_header`, and no checksums in a recording in progress. `hil-recording/1`
also names two attributes of /profile "quantity" (now mode) and "soft" (now fade).

A recording in progress is `NAME.h5.part`. It has the same groups, but all samples are one contiguous compound dataset
`/live`, and all events one dataset `/live_events`. Both are preallocated and filled with the end mark. The program
closes HDF5 before the first row and writes each row at its place in the file, so that the file is valid HDF5 at every
moment. A row is valid if its `seq` is its index and its checksum is right. Any other row before the last valid one is
damaged, and is read as lost. All bytes before the rows stand again behind the events, with a checksum and the process
that records (`hil.recording.integrity.second_header`): a file that is cut off, or damaged in its header, is read with
what is whole. `sha256_header` is computed without the events, and there is no `sha256`. The classes of
this module read finished recordings and recordings in progress.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from hil.errors import Untrustworthy, WrongUse
from hil.recording.ahead import Progress, ahead
from hil.recording.channels import CHANNELS, ROW, Row, Rows
from hil.recording.integrity import (
    LIVE,
    check_regular,
    check_samples,
    damaged_events,
    first_line,
    header_hash,
    intact,
    is_wiped,
    legible,
    open_file,
    plain,
    refuse_foreign_storage,
    rows_hash,
    stored_hash,
    writer_of,
    written_first,
)
from hil.recording.interval import Given, Part, named, path_of, rows_between
from hil.recording.posix import in_child

SCHEMA = "hil-recording/3"
RENAMED: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "hil-recording/1": MappingProxyType({"quantity": "mode", "soft": "fade"}),
        "hil-recording/2": MappingProxyType({}),
        SCHEMA: MappingProxyType({}),
    }
)
"""The schemas that can be read; for each, the old names of attributes of /profile that were renamed later."""
BLOCK = 65536
"""The number of rows that are processed at a time, so that a long recording is never completely in memory."""

EVENTS = 256
"""The number of events that a recording in progress has room for."""
_MOST_EVENTS = 100_000
_TRIAL_TIME, _TRIAL_MEMORY = 2, 1 << 29  # s of processor time, bytes
_TAIL = 64  # rows after the last valid one among which damaged ones are looked for

Array = NDArray[np.float64]


class Event(NamedTuple):
    """An event of a run: its time, s, a short code and a sentence."""

    time: float
    code: str
    message: str


class Recording:
    """An open recording, finished or not. `len(recording)` is the number of rows.

    given: the file, or a part of it; then only the rows of the part are read. window: the times of the first and the
    last row of the part, s; None for the whole file. attributes: those of the file's root. profile: the excitation,
    with the attribute names of the newest schema. complete: whether the run ended as planned. live: whether the file
    has the layout of a recording in progress. Raises WrongUse for a file that is no recording or has an unknown schema,
    and for a part without rows, Untrustworthy for a damaged recording.
    """

    def __init__(self, given: Given) -> None:
        self.path = path = path_of(given)
        self.window: tuple[float, float] | None = None
        self._first = 0
        self._absent: frozenset[str] = frozenset()
        self._ends_damaged = False
        self._damaged: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        check_regular(path)
        self._try_out()
        self._file = open_file(path)
        try:
            with legible(path):
                self._length = self._read_header()
                if self.live:
                    self._length = self._count_live()
            self._whole = self._length
            if isinstance(given, Part) and given[1:] != (None, None):
                self._narrow(given)
        except BaseException:
            self._file.close()
            raise

    def _narrow(self, part: Part) -> None:
        """Restrict the recording to the rows between the two times of `part`. Raises WrongUse if there are none."""
        blocks = range(0, self._whole, BLOCK)
        time = np.concatenate([np.empty(0), *(self.channel("time", start, start + BLOCK) for start in blocks)])
        kept = np.flatnonzero(rows_between(self.path, time, 1.0, part.first, part.last))
        self._first, self._length = int(kept[0]), int(kept[-1] + 1 - kept[0])
        self.window = float(time[kept[0]]), float(time[kept[-1]])

    @property
    def first(self) -> int:
        """Return the row of the file at which the part begins."""
        return self._first

    @property
    def name(self) -> str:
        """Return the recording's file, with the times of the part that is read."""
        return named(self.path, self.window)

    @property
    def imported(self) -> bool:
        """Return whether the recording was imported from a table of another program."""
        return self.profile.get("kind") == "imported"

    def _try_out(self) -> None:
        """Read everything except the rows in a forked copy of this process, because HDF5 can hang or crash on a damaged
        file.
        """
        if in_child(self._has_outline, processor=_TRIAL_TIME, memory=_TRIAL_MEMORY) is None:
            raise WrongUse(
                f"{self.path} is damaged: the HDF5 library crashes when it opens the file, or needs more than "
                f"{_TRIAL_TIME} s of processor time or 512 MiB of memory; use another copy of the file"
            )

    def _has_outline(self) -> bool:
        """Read everything except the rows, and return True. Raises WrongUse, Untrustworthy."""
        with open_file(self.path) as self._file, legible(self.path):
            self._read_header()
            self.events()
            self.truth()
        return True

    def _read_header(self) -> int:
        """Read everything before the rows; return the number of rows for which the file has room."""
        refuse_foreign_storage(self._file, self.path)
        self.attributes = plain(self._file.attrs)
        names = self._renamed()
        profile = plain(self._group("profile").attrs)
        self.profile = {names.get(name, name): value for name, value in profile.items()}
        self.live = "live" in self._file
        self.complete = bool(self.attributes.get("complete", False))
        if self.live:
            return len(self._checked_live())
        rows, self._absent = check_samples(self._group("samples"), self.path)
        return rows

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._length

    @property
    def damaged(self) -> int:
        """Return the number of damaged rows in an unfinished recording; damaged rows are read as lost."""
        return len(self._damaged)

    @property
    def damage(self) -> str:
        """Return what is missing of an unfinished recording because its file is damaged, "" if nothing is."""
        events = damaged_events(self._file["live_events"][:EVENTS]) if self.live else 0
        counts = [f"{count} {what}" for count, what in ((self.damaged, "rows"), (events, "events at most")) if count]
        lost = [f"{' and '.join(counts)} were damaged on the disk and count as lost"] if counts else []
        last = f"the file is damaged after row {self._whole}: later rows, if there were any, are missing"
        return "; ".join([*lost, *([last] if self._ends_damaged else [])])

    @property
    def stand_toml(self) -> str:
        """Return the text of the stand file with which the recording was made, "" without a stand file."""
        return str(self.attributes.get("stand_toml", ""))

    def rows(self, block: int = BLOCK) -> Iterator[tuple[int, Rows]]:
        """Yield all rows in order, in blocks of `block` rows, each with the index of its first row. Raises
        Untrustworthy.
        """
        return self._rows(self._first, self._first + self._length, block)

    def _rows(self, first: int, end: int, block: int = BLOCK) -> Iterator[tuple[int, Rows]]:
        """Yield the rows from `first` to before `end` in blocks of `block` rows, each with the index of its
        first row.
        """
        for start in range(first, end, block):
            stop = min(start + block, end)
            source = self._live_rows(start, stop) if self.live else None
            rows = np.empty(stop - start, dtype=ROW)
            for name in CHANNELS:
                rows[name] = self._column(name, start, stop) if source is None else source[name]
            yield start - first, rows

    def channel(self, name: str, start: int = 0, stop: int | None = None) -> Array:
        """Return rows `start` to `stop` (None: to the end) of one channel, (n,) float64 in its SI unit.

        Raises Untrustworthy if the file is damaged.
        """
        stop = self._length if stop is None else min(stop, self._length)
        return np.asarray(self._column(name, self._first + start, self._first + stop), dtype=np.float64)

    def events(self) -> list[Event]:
        """Return the events of the run in order. Raises WrongUse for a damaged file."""
        with legible(self.path):
            if self.live:
                return self._live_events()
            group = self._group("events")
            if max(len(group[name]) for name in ("time", "code", "message")) > _MOST_EVENTS:
                raise WrongUse(f"{self.path} declares more than {_MOST_EVENTS} events: use another copy of the file")
            text = (group["code"].asstr()[()], group["message"].asstr()[()])
            rows = zip(group["time"], *text, strict=True)
            return [Event(float(time), str(code), str(message)) for time, code, message in rows]

    def truth(self) -> dict[str, float]:
        """Return the simulator's true parameters, {} for a real stand. Identification never calls this."""
        with legible(self.path):
            group = self._file.get("truth")
            return {} if group is None else {name: float(value) for name, value in group.attrs.items()}

    def verify(self, progress: Progress | None = None) -> bool:
        """Return whether header, rows and events are as they were written. Raises WrongUse, Untrustworthy.

        progress: called with the fraction of the rows that have been checked. A recording of an older schema is checked
        with the hash that it has; an unfinished recording of such a schema has no hash.
        """
        with legible(self.path):
            intact_rows = not self.damage if self.live else self._rows_intact(progress)
            return intact_rows and self.header_intact()

    def header_intact(self) -> bool:
        """Return whether attributes, profile and truth are as they were written; for a finished recording, also the
        events.
        """
        if self.attributes["schema"] != SCHEMA and "sha256_header" not in self.attributes:
            return True
        events = [] if self.live else self.events()
        return self._stated("sha256_header") == header_hash(self.attributes, self.profile, self.truth(), events)

    def check_unchanged(self) -> None:
        """Raise Untrustworthy if the recording is not as it was written. Damaged rows of an unfinished recording are
        accepted as lost rows.
        """
        if not (self.header_intact() if self.live else self.verify()):
            raise Untrustworthy(
                f"{self.path} is not as it was written (its SHA-256 differs), so its rows cannot be trusted: use "
                "another copy of the file"
            )

    def _stated(self, name: str) -> str:
        return str(self.attributes.get(name, ""))

    def _rows_intact(self, progress: Progress | None) -> bool:
        present = [name for name in CHANNELS if name not in self._absent]
        if stored_hash(self._group("samples"), present) == (self._stated("sha256_stored") or None):
            return True  # what is decompressed from the same bytes is the same: that takes twenty times as long
        return rows_hash(ahead(self._rows(0, self._whole)), present, self._whole, progress) == self._stated("sha256")

    def _column(self, name: str, start: int, stop: int) -> Any:
        if self.live:
            return self._live_rows(start, stop)[name]
        if name in self._absent:
            return np.full(stop - start, np.nan)
        return self._read(f"samples/{name}", start, stop)

    def _live_rows(self, start: int, stop: int) -> Rows:
        rows: Rows = self._read("live", start, stop)
        for at in self._damaged[(start <= self._damaged) & (self._damaged < stop)]:
            lost = Row(int(at), status=int(Status.BAD_REPLY))
            for name, value in zip(Row._fields, lost, strict=True):
                rows[name][at - start] = value
        return rows

    def _live_events(self) -> list[Event]:
        table = self._file["live_events"][:EVENTS]
        return [
            Event(float(row["time"]), *(row[name].decode(errors="replace") for name in ("code", "message")))
            for row in table[intact(table)]
            if row["code"]
        ]

    def _read(self, name: str, start: int, stop: int) -> Any:
        try:
            return self._file[name][start:stop]
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            raise Untrustworthy(
                f"{self.path}: {name} is damaged and cannot be read ({first_line(error)}): use another copy"
            ) from error

    def _group(self, name: str) -> h5py.Group:
        group = self._file.get(name)
        if not isinstance(group, h5py.Group):
            raise WrongUse(
                f"{self.path} has no group /{name}: it is no recording of hil. Make one from other data with hil import"
            )
        return group

    def _renamed(self) -> Mapping[str, str]:
        """Return the old names of attributes of /profile in the schema of this file. Raises WrongUse for an unknown
        schema.
        """
        schema = str(self.attributes.get("schema", ""))
        if not schema.startswith("hil-recording/"):
            raise WrongUse(f"{self.path} is HDF5 but not a recording of hil: bring its data in with `hil import`")
        if schema not in RENAMED:
            raise WrongUse(
                f"{self.path} has schema {schema!r}, written by {writer_of(self.attributes)}; this hil reads "
                f"{', '.join(RENAMED)}: read it with the version that wrote it"
            )
        return RENAMED[schema]

    def _count_live(self) -> int:
        """Return the number of rows up to the last written row, and store the indices of the damaged rows.

        The search ends at a block without a valid row, so that a day-long run that has just begun is not read
        completely.
        """
        live = self._file["live"]
        length, damaged = 0, [self._damaged]
        for start in range(0, len(live), BLOCK):
            valid = _valid(live[start : start + BLOCK], start)
            if not valid.size:
                break
            damaged.append(np.setdiff1d(np.arange(length, valid[-1]), valid, assume_unique=True))
            length = int(valid[-1]) + 1
        tail = live[length : length + _TAIL]
        grew = _valid(tail, length).size > 0  # a run that goes on has written them since
        torn = length + np.arange(0 if grew else written_first(tail))
        self._damaged = np.concatenate([*damaged, torn])
        self._ends_damaged = not grew and is_wiped(tail[len(torn) : len(torn) + 1])
        return length + len(torn)

    def _checked_live(self) -> h5py.Dataset:
        live = self._file["live"]
        if live.dtype not in {LIVE, ROW} or live.ndim != 1:
            raise WrongUse(f"{self.path}: /live has other fields than {SCHEMA}: use the version of hil that wrote it")
        return live


def _valid(rows: Rows, first: int) -> NDArray[np.int64]:
    """Return the indices of the rows that are as they were written. first: index of the first of `rows` in the
    recording.
    """
    index = np.arange(first, first + len(rows))
    found: NDArray[np.int64] = index[(rows["seq"] == index.astype(np.uint64)) & intact(rows)]
    return found
