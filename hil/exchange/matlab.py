"""Vectors of MATLAB's level 5 MAT-files (save -v6 and -v7), as MathWorks' "MAT-File Format" describes them.

SciPy reads more of the format, but ends the process with a segmentation fault on a damaged file. Here every length is
checked against the data.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.recording.input import open_input

Array = NDArray[np.float64]

_LARGEST = 1 << 30  # bytes of a file, which is in memory whole
_SMALL, _COMPRESSION = 1 << 26, 100  # bytes that any element may unpack to; for a larger one, bytes for each of its own
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCT = 2
_NUMERIC = range(6, 16)  # classes: double, single, and the integers
_COMPLEX = 0x0800


def vectors(source: Path) -> dict[str, Array]:
    """Return all real vectors of a MAT-file by name, (n,) each. A vector in a struct of one element has the name
    "struct.field".

    Raises WrongUse for a file that is not a MAT-file of level 5, and for a damaged file.
    """
    with open_input(source, largest=_LARGEST) as file:
        data = file.read()
    if data.startswith(b"MATLAB 7.3"):
        raise WrongUse(f"{source} is of MATLAB's version 7.3: save it with save(..., '-v7'), or as CSV")
    order = {b"IM": "<", b"MI": ">"}.get(data[_HEADER - 2 : _HEADER])
    if order is None:
        raise WrongUse(f"{source} is not a MAT-file of MATLAB 5 or later: save it with save(..., '-v7'), or as CSV")
    found: dict[str, Array] = {}
    try:
        for kind, content in _elements(data[_HEADER:], order):
            if kind == _COMPRESSED:
                [(kind, content)] = list(_elements(_unpacked(content), order))  # noqa: PLW2901 - unpacked
            if kind == _MATRIX:
                _collect(found, _Matrix.of(content, order), order)
    except (ValueError, IndexError, StopIteration, struct.error, zlib.error) as error:
        raise WrongUse(f"{source} is a damaged MAT-file, or is cut off ({error}): save it again") from None
    return found


def _unpacked(content: bytes) -> bytes:
    """Return the data of a compressed element. Raises ValueError if the data would fill the memory."""
    largest = max(_SMALL, _COMPRESSION * len(content))
    unpacker = zlib.decompressobj()
    data = unpacker.decompress(content, largest)
    if unpacker.unconsumed_tail:
        raise ValueError(f"{len(content)} bytes unpack to more than {largest}")
    if not unpacker.eof:
        raise ValueError("an element is cut off")
    return data


@dataclass(frozen=True, slots=True)
class _Matrix:
    """A variable in a MAT-file: class, flags, sizes, name, and the elements with its data."""

    kind: int
    complex: bool
    sizes: tuple[int, ...]
    name: str
    rest: Iterator[tuple[int, bytes]]

    @classmethod
    def of(cls, content: bytes, order: str) -> _Matrix:
        parts = _elements(content, order)
        flags = struct.unpack(f"{order}II", next(parts)[1])[0]
        sizes = tuple(int(size) for size in np.frombuffer(next(parts)[1], f"{order}i4"))
        name = next(parts)[1].decode("latin-1")
        return cls(flags & 0xFF, bool(flags & _COMPLEX), sizes, name, parts)


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield the type and the content of each element in a part of a MAT-file."""
    at = 0
    while at < len(data):
        first, size = struct.unpack_from(f"{order}II", data, at)
        if first >> 16:  # a small element: type, size and up to four bytes in one
            first, size, start, step = first & 0xFFFF, first >> 16, at + 4, 8
        else:
            start = at + 8
            step = 8 + (size if first == _COMPRESSED else (size + 7) // 8 * 8)
        if start + size > len(data) or (step == 8 and size > 4):
            raise ValueError("an element is longer than the file")
        yield first, data[start : start + size]
        at += step


def _collect(found: dict[str, Array], matrix: _Matrix, order: str) -> None:
    if matrix.kind == _STRUCT and set(matrix.sizes) == {1}:
        width = int(np.frombuffer(next(matrix.rest)[1], f"{order}i4")[0])
        names = next(matrix.rest)[1]
        if width <= 0:
            raise ValueError("a struct without field names")
        for start, (_, content) in zip(range(0, len(names), width), matrix.rest, strict=False):
            field = names[start : start + width].split(b"\0")[0].decode("latin-1")
            _vector(found, f"{matrix.name}.{field}", _Matrix.of(content, order), order)
    else:
        _vector(found, matrix.name, matrix, order)


def _vector(found: dict[str, Array], name: str, matrix: _Matrix, order: str) -> None:
    """Add the variable to `found` if it is a real numeric vector; a table has no column for other variables."""
    long = [size for size in matrix.sizes if size != 1]
    if matrix.kind not in _NUMERIC or matrix.complex or len(long) > 1:
        return
    kind, content = next(matrix.rest)
    if kind not in _NUMBERS:
        raise ValueError(f"{name} is stored as the unknown type {kind}")
    values = np.frombuffer(content, f"{order}{_NUMBERS[kind]}")
    if len(values) != (long[0] if long else 1):
        raise ValueError(f"{name} has {len(values)} numbers, and other sizes in its header")
    found[name] = values.astype(np.float64)
