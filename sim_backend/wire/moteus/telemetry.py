"""Encode the telemetry channels of the diagnostic stream: a binary schema, and data in this schema.

Source: mjbots/mjlib's telemetry format as moteus/reader.py of the vendor's Python package reads it. A channel is an
object whose fields have no aliases and no defaults.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

_FINAL, _OBJECT, _FIXED_ARRAY = 0, 16, 19
_KINDS = {
    "?": bytes([2]),
    "i": bytes([3, 4]),
    "q": bytes([3, 8]),
    "B": bytes([4, 1]),
    "I": bytes([4, 4]),
    "f": bytes([7]),
}
"""The schema's type code for each format letter of `struct`."""


class Field(NamedTuple):
    """A field of a channel. kind: a format letter of `struct`. value: a number, or several numbers for a fixed
    array.
    """

    name: str
    kind: str
    value: float | Sequence[int]


def schema(fields: Sequence[Field]) -> bytes:
    """Return the binary schema that describes an object with `fields`."""
    out = bytes([_OBJECT, 0])
    for field in fields:
        kind = _KINDS[field.kind]
        if isinstance(field.value, Sequence):
            kind = bytes([_FIXED_ARRAY, len(field.value)]) + kind
        name = field.name.encode("ascii")
        out += bytes([0, len(name)]) + name + b"\0" + kind + b"\0"
    return out + bytes([0, 0, 0, _FINAL, 0])


def data(fields: Sequence[Field]) -> bytes:
    """Return the values of `fields`, encoded as their schema says."""
    out = b""
    for field in fields:
        values = field.value if isinstance(field.value, Sequence) else [field.value]
        whole = field.kind != "f"
        out += struct.pack(f"<{len(values)}{field.kind}", *(int(value) if whole else value for value in values))
    return out


def announced(kind: str, name: str, blob: bytes) -> bytes:
    """Return a blob as the stream transmits it: a line with kind and name, the size of the blob, then the blob."""
    return f"{kind} {name}\r\n".encode("ascii") + struct.pack("<I", len(blob)) + blob
