"""Checks of a recording: whether the file may be opened, and whether header, rows and events are as they were
written.
"""

from __future__ import annotations

import hashlib
import json
import math
import stat
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from hil.errors import Untrustworthy, WrongUse
from hil.recording.ahead import Progress
from hil.recording.channels import CHANNELS, END_MARK, LATER, ROW, Row, Rows
from hil.recording.input import missing

LIVE = np.dtype([*ROW.descr, ("crc", "<u4")])
"""The layout of a row in a recording in progress: the bytes of ROW and their CRC-32."""
EVENT = np.dtype([("time", "<f8"), ("code", "S32"), ("message", "S200"), ("crc", "<u4")])
"""The layout of an event in a recording in progress; `crc` is the CRC-32 of the bytes before it."""

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


@contextmanager
def legible(path: Path) -> Iterator[None]:
    """Turn any exception caused by damaged metadata into a WrongUse; HDF5 and h5py raise many kinds."""
    try:
        yield
    except (WrongUse, Untrustworthy):
        raise
    except Exception as error:
        raise WrongUse(f"{path} is damaged and cannot be read ({first_line(error)}): use another copy") from error


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


def open_file(path: Path) -> h5py.File:
    """Open an HDF5 file for reading. Raises WrongUse."""
    with legible(path):
        try:
            return h5py.File(path, "r")
        except PermissionError:
            raise WrongUse(f"{path} cannot be opened (permission denied): change the file's permissions") from None
        except OSError as error:
            hint = (
                "it has no row that can be read, and `hil record --force` replaces it"
                if path.suffix == ".part"
                else f"a stand file is named with --stand {path}"
                if path.suffix == ".toml"
                else "bring CSV data in with `hil import`"
            )
            raise WrongUse(f"{path} is not HDF5, or is cut off: {hint}") from error


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
