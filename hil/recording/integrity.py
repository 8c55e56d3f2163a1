"""Checks of a recording: whether the file may be opened, and whether header, rows and events are as they were
written.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import stat
import struct
import sys
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import h5py
import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from hil.errors import Untrustworthy, WrongUse
from hil.printable import quoted
from hil.recording.ahead import Progress
from hil.recording.channels import CHANNELS, END_MARK, LATER, ROW, Row, Rows
from hil.recording.input import missing, open_input
from hil.recording.posix import process_mark

LIVE = np.dtype([*ROW.descr, ("crc", "<u4")])
"""The layout of a row in a recording in progress: the bytes of ROW and their CRC-32."""
EVENT = np.dtype([("time", "<f8"), ("code", "S32"), ("message", "S200"), ("crc", "<u4")])
"""The layout of an event in a recording in progress; `crc` is the CRC-32 of the bytes before it."""

_FOOT = struct.Struct("<8sQQ64sI")  # _MAGIC, bytes of the header, process and its mark, CRC-32 of all before
_MAGIC = b"hil-part"
_HDF5 = b"\x89HDF\r\n\x1a\n"
_FEW = 4  # bytes
_SMALL = 1 << 26  # bytes that any file may declare
_COMPRESSION = 1000  # declared bytes a stored one

_crc = struct.Struct("<I").pack
_pack_row = struct.Struct("<" + "".join("Q" if ROW[name].kind == "u" else "d" for name in Row._fields)).pack


def packed(rows: Iterable[Row]) -> bytes:
    """Return the bytes of rows in the layout of LIVE, twice as fast as through an array.

    `row[:]` is a plain tuple, which is unpacked twice as fast as a Row.
    """
    crc32 = zlib.crc32
    return b"".join([(data := _pack_row(*row[:])) + _crc(crc32(data)) for row in rows])


def packed_array(rows: Rows) -> bytes:
    """Return the bytes of rows, (n,) of ROW, in the layout of LIVE."""
    live = np.empty(len(rows), dtype=LIVE)
    for name in Row._fields:
        live[name] = rows[name]
    live["crc"] = _checksums(live)
    return live.tobytes()


def packed_event(time: float, code: str, message: str) -> bytes:
    """Return the bytes of an event in the layout of EVENT; a text that is too long is cut off."""
    data = np.array([(time, code.encode()[:32], message.encode()[:200], 0)], dtype=EVENT).tobytes()[:-4]
    return data + _crc(zlib.crc32(data))


def intact(table: Rows) -> NDArray[np.bool_]:
    """Return for each entry of a table, (n,) of LIVE or EVENT, whether its checksum is right.

    Tables of older schemas have no checksums. There every entry is returned as intact, unless all its bytes are zero
    because a killed recorder had not written it.
    """
    if "crc" not in (table.dtype.names or ()):
        data = np.frombuffer(table.tobytes(), dtype=np.uint8).reshape(len(table), table.dtype.itemsize)
        return np.asarray(data.any(axis=1))
    return np.asarray(table["crc"] == _checksums(table))


def damaged_events(table: Rows) -> int:
    """Return how many events at most a table of EVENT has lost: its damaged entries before the first empty one, which
    has a checksum too.
    """
    if table.dtype != EVENT:
        return 0
    whole = intact(table)
    empty = np.flatnonzero(whole & (table["code"] == b""))
    return int((~whole[: empty[0] if len(empty) else None]).sum())


def is_wiped(row: Rows) -> bool:
    """Return whether a row of LIVE, (1,) or none, consists of zeros apart from a few damaged bytes: a place that was
    never written has the end mark.
    """
    few = np.count_nonzero(np.frombuffer(row.tobytes(), np.uint8)) <= _FEW
    return bool(few and len(row) and row.dtype == LIVE)


def written_first(table: Rows) -> int:
    """Return the number of rows at the beginning of a table of LIVE that were written, with a right or a wrong
    checksum.

    A row that consists of the end mark or of zeros, apart from a few damaged bytes, was not written.
    """
    if table.dtype != LIVE:
        return 0
    data = np.frombuffer(table.tobytes(), dtype=np.uint8).reshape(len(table), LIVE.itemsize)
    blank = np.frombuffer(packed([Row(END_MARK)]), dtype=np.uint8)
    written = ((data != blank).sum(axis=1) > _FEW) & ((data != 0).sum(axis=1) > _FEW)
    return int(np.argmin(written)) if not written.all() else len(table)


def _checksums(table: Rows) -> NDArray[np.uint32]:
    """Return the CRC-32 of each entry's bytes except its last four, (n,)."""
    data, size = memoryview(table.tobytes()), table.dtype.itemsize
    return np.fromiter(
        (zlib.crc32(data[at : at + size - 4]) for at in range(0, len(data), size)), np.uint32, len(table)
    )


def header_hash(
    attributes: Mapping[str, Any],
    profile: Mapping[str, Any],
    truth: Mapping[str, float],
    events: Iterable[tuple[float, str, str]],
) -> str:
    """Return the SHA-256 of everything in a recording except its rows and this hash itself.

    It is computed over the JSON of the list of the four arguments, with sorted keys, as Python's `json.dumps` writes
    it.
    """
    own = {name: value for name, value in attributes.items() if name != "sha256_header"}
    text = json.dumps([own, dict(profile), dict(truth), list(events)], sort_keys=True, default=repr)
    return hashlib.sha256(text.encode()).hexdigest()


def rows_hash(blocks: Iterable[tuple[int, Rows]], names: list[str], length: int, progress: Progress | None) -> str:
    """Return the SHA-256 of the named channels of all rows.

    blocks: the rows, in blocks with the index of the first row. length: number of all rows, for progress.
    """
    digest = hashlib.sha256()
    for start, rows in blocks:
        digest.update((rows if names == list(CHANNELS) else repack_fields(rows[names])).data)
        if progress is not None:
            progress("checking that it is as it was written", (start + len(rows)) / length)
    return digest.hexdigest()


def stored_hash(samples: h5py.Group, names: Iterable[str]) -> str:
    """Return the SHA-256 of the named channels as they are stored, without decompressing them.

    The hash covers for each channel, in order: the JSON of its name, length, rows of a chunk and filters (number and
    parameters); then for each chunk its filter mask, four bytes, and its bytes. Return "" if a channel is not stored
    only in such chunks, or has another type than defined: then the stored bytes do not determine the values.
    """
    digest = hashlib.sha256()
    for name in names:
        dataset = samples[name]
        if dataset.chunks is None or not dataset.id.get_type().equal(h5py.h5t.py_create(ROW[name])):
            return ""
        stored, layout = dataset.id, dataset.id.get_create_plist()
        filters = [layout.get_filter(number)[::2] for number in range(layout.get_nfilters())]
        digest.update(json.dumps([name, dataset.shape, dataset.chunks, filters], default=list).encode())
        for start in range(0, len(dataset), dataset.chunks[0]):
            if stored.get_chunk_info_by_coord((start,)).byte_offset is None:
                return ""
            mask, chunk = stored.read_direct_chunk((start,))
            digest.update(mask.to_bytes(4))
            digest.update(chunk)
    return digest.hexdigest()


def plain(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes of a group as Python's own types."""
    return {name: _plain(attributes[name]) for name in attributes}


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return value.item() if isinstance(value, np.generic) else value


_NO_ROW = "it has no row that can be read: remove it, or choose another name"


@contextmanager
def legible(path: Path) -> Iterator[None]:
    """Turn any exception caused by damaged metadata into a WrongUse; HDF5 and h5py raise many kinds."""
    try:
        yield
    except (WrongUse, Untrustworthy):
        raise
    except Exception as error:
        hint = _NO_ROW if path.suffix == ".part" else "use another copy"
        raise WrongUse(f"{path} is damaged and cannot be read ({first_line(error)}): {hint}") from error


def first_line(error: Exception) -> str:
    """Return the first line of an error's text; HDF5 adds its call stack in further lines."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def check_regular(path: Path) -> None:
    """Raise WrongUse unless `path` is a regular file; a FIFO or a device would block the reader."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise WrongUse(f"{path} cannot be opened ({error.strerror}): {missing(path)}") from None
    if not stat.S_ISREG(mode):
        raise WrongUse(f"{path} is not a file: name a recording such as recordings/run1.h5")


class Recorder(NamedTuple):
    """The process that writes a recording: its id, and its `hil.recording.posix.process_mark`."""

    process: int
    mark: str


def second_header(header: bytes) -> bytes:
    """Return what stands behind the last byte that HDF5 knows of a recording in progress: its header again, this
    process as its recorder, and a checksum of both.
    """
    process = os.getpid()
    data = header + _FOOT.pack(_MAGIC, len(header), process, process_mark(process).encode(), 0)[:-4]
    return data + _crc(zlib.crc32(data))


def recorder(path: Path) -> Recorder | None:
    """Return the process that began the recording in progress at `path`; None for any other file."""
    with suppress(WrongUse, OSError), open_input(path, largest=sys.maxsize) as file:
        return _second(file)[1]
    return None


def is_unfinished(path: Path) -> bool:
    """Return whether a file is a recording in progress, or one that never ended, of this version or an older one."""
    if recorder(path) is None:
        with suppress(Exception), open_file(path) as file:
            return "live" in file
        return False
    return True


def _second(file: BinaryIO) -> tuple[bytes, Recorder | None]:
    """Return the second header of a file and its recorder; nothing and None without one."""
    end = file.seek(0, os.SEEK_END) - _FOOT.size
    file.seek(max(0, end))
    foot = file.read(_FOOT.size)
    if end < 0 or not foot.startswith(_MAGIC):
        return b"", None
    _, size, process, mark, checksum = _FOOT.unpack(foot)
    if size > min(end, _SMALL):
        return b"", None
    file.seek(end - size)
    header = file.read(size)
    if zlib.crc32(header + foot[:-4]) != checksum:
        return b"", None
    return header, Recorder(process, mark.rstrip(b"\0").decode(errors="replace"))


class _Mended(io.RawIOBase):
    """The bytes of a damaged recording in progress, with `header` at the beginning, and with zeros where the file is
    cut off before byte `size`.
    """

    def __init__(self, path: Path, header: bytes, size: int) -> None:
        self._file, self._header, self._size, self._place = path.open("rb"), header, size, 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set and return the place of the next byte."""
        self._place = offset + (0, self._place, self._size)[whence]
        return self._place

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer; return its length."""
        self._file.seek(self._place)
        data = bytearray(self._file.read(len(buffer)).ljust(len(buffer), b"\0"))
        first = self._header[self._place : self._place + len(data)]
        data[: len(first)] = first
        buffer[:] = data
        self._place += len(data)
        return len(data)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _mended(path: Path) -> _Mended | None:
    """Return the bytes of a recording in progress whose header is damaged or which is cut off; None for a file that
    needs no mending.
    """
    with suppress(WrongUse, OSError), open_input(path, largest=sys.maxsize) as file:
        header, _ = _second(file)
        length = file.seek(0, os.SEEK_END)
        file.seek(0)
        first = file.read(max(len(header), 48))
        known = header or first  # bytes 28 to 35 of superblocks 2 and 3: the end of the file
        size = int.from_bytes(known[28:36], "little") if known[:8] == _HDF5 and known[8] in {2, 3} else 0
        if size > length or not first.startswith(header):
            return _Mended(path, header, max(size, length))
    return None


def open_file(path: Path) -> h5py.File:
    """Open an HDF5 file for reading; of a recording in progress, also a damaged one. Raises WrongUse."""
    with legible(path):
        try:
            mended = _mended(path)
            file = h5py.File(mended or path, "r")
            if mended is None or "live" in file:
                return file
            file.close()
            raise OSError("truncated file")
        except PermissionError:
            raise WrongUse(f"{path} cannot be opened (permission denied): change the file's permissions") from None
        except OSError as error:
            raise WrongUse(f"{path} {_why_illegible(path)}") from error


def _why_illegible(path: Path) -> str:
    """Return what is wrong with a file that HDF5 cannot open, and the remedy."""
    if path.suffix == ".part":
        return f"is not HDF5, or is cut off: {_NO_ROW}"
    with path.open("rb") as file:
        if (first := file.read(len(_HDF5))) == _HDF5:
            return "is cut off or damaged: copy it again from where it was recorded, or use another copy"
    if not first:
        return "is empty: use another copy"
    if path.suffix == ".toml":
        return f"is no recording: if it is a stand file, `hil record --stand {quoted(path)}` makes one"
    return "is not HDF5: bring CSV data in with `hil import`"


def refuse_foreign_storage(file: h5py.File, path: Path) -> None:
    """Raise WrongUse for a file with links to other files, or with external or virtual storage: a recording must not
    read other files.
    """
    for group in (file, *(file.get(name) for name in ("samples", "events") if _is_hard(file, name))):
        for name in group if isinstance(group, h5py.Group) else ():
            if not _is_hard(group, name):
                raise WrongUse(f"{path}: {name} is a link to somewhere else: hil does not open such a file")
            item = group[name]
            if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
                raise WrongUse(f"{path}: {name} keeps its data in another file: hil does not open such a file")


def check_samples(samples: h5py.Group, path: Path) -> tuple[int, frozenset[str]]:
    """Return the number of rows of a finished recording, and the names of the channels that its older schema does not
    have.

    Raises WrongUse if a channel is missing, is no column of numbers or differs in length from the others. Raises
    WrongUse as well if the file declares more data than its size can contain, which would fill memory or disk.
    """
    later = frozenset(name for name in LATER if name not in samples)
    columns = {name: samples.get(name) for name in CHANNELS if name not in later}
    absent = [name for name, column in columns.items() if not isinstance(column, h5py.Dataset)]
    if absent:
        raise WrongUse(f"{path}: /samples lacks {', '.join(absent)}: it is not a complete recording")
    for name, column in columns.items():
        if column.ndim != 1 or column.dtype.kind not in "fiu":
            raise WrongUse(f"{path}: /samples/{name} is not one column of numbers")
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        odd = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise WrongUse(f"{path}: channels of unequal length ({odd}): the file was not written completely")
    _check_size(columns, lengths["time"], path)
    return lengths["time"], later


def _check_size(columns: Mapping[str, h5py.Dataset], rows: int, path: Path) -> None:
    stored = path.stat().st_size
    if rows * ROW.itemsize > max(_SMALL, _COMPRESSION * stored):
        raise WrongUse(f"{path} declares {rows} rows in {stored} bytes, which no recording does: use another copy")
    for name, column in columns.items():
        chunk = math.prod(column.chunks or ()) * column.dtype.itemsize
        if chunk > _SMALL:
            raise WrongUse(f"{path}: /samples/{name} has chunks of {chunk} bytes: no recording of hil has such")


def _is_hard(group: h5py.Group, name: str) -> bool:
    return isinstance(group.get(name, getlink=True), h5py.HardLink)


def writer_of(attributes: Mapping[str, Any]) -> str:
    """Return the name of the program that wrote a recording."""
    try:
        return f"hil {json.loads(attributes['software'])['hil']}"
    except (KeyError, TypeError, ValueError):
        return "an unknown version of hil"
