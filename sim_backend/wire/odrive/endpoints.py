"""The parameters (endpoints) of an emulated ODrive with firmware 0.6, and the file from which clients read the endpoint
numbers.

The vendor publishes a flat_endpoints.json with each firmware. The names here are the vendor's; the numbers are this
emulator's own. A client that does not read the numbers from the file would fail on a real drive too.
"""

from __future__ import annotations

import struct

from drivers.tables import table

_PARAMETERS: tuple[tuple[str, str, float, bool], ...] = tuple(
    (name, kind, value, writable)
    for name, (kind, value, writable) in table("odrive", "sim_backend.wire")["parameters"].items()
)
"""Name, type, value in a new drive, and whether the parameter can be written."""
_LAYOUTS = {"float": "<f", "bool": "<?", "uint8": "<B", "uint32": "<I"}
_FIRST = 100


class Endpoints:
    """The parameters of one emulated drive."""

    def __init__(self, ident: int) -> None:
        self._values = {name: value for name, _, value, _ in _PARAMETERS}
        self._values["axis0.config.can.node_id"] = ident
        self.refused: set[str] = set()
        """Parameters whose writes are acknowledged but not carried out: a fault for tests."""

    def erase(self) -> None:
        """Set every writable parameter to its value in a new drive. The node id is lost too."""
        self._values |= {name: value for name, _, value, writable in _PARAMETERS if writable}
        self._values["axis0.config.can.node_id"] = 0x3F

    def get(self, name: str) -> float:
        """Return the value of a parameter."""
        return self._values[name]

    def put(self, name: str, value: float) -> None:
        """Set a parameter as the drive's own firmware does."""
        self._values[name] = value

    def sdo(self, data: bytes, *, confirms: bool) -> bytes | None:
        """Return the reply to an RxSdo request, None if there is none. confirms: whether the firmware replies to a
        write.
        """
        if len(data) < 4:
            return None
        writes, number, _ = struct.unpack_from("<BHB", data)
        if writes == 1:
            done = self.write(number, data[4:].ljust(4, b"\0"))
            return struct.pack("<BHB4x", 1, number, 0) if done and confirms else None
        value = self.read(number)
        return None if value is None else struct.pack("<BHB", 0, number, 0) + value

    def read(self, number: int) -> bytes | None:
        """Return the four bytes with the value of endpoint `number`; None if there is no such endpoint."""
        row = self._row(number)
        if row is None:
            return None
        name, kind, _, _ = row
        value = self._values[name]
        raw = struct.pack(_LAYOUTS[kind], value if kind == "float" else int(value))
        return raw.ljust(4, b"\0")

    def write(self, number: int, raw: bytes) -> bool:
        """Write an endpoint; return whether there is such an endpoint."""
        row = self._row(number)
        if row is None:
            return False
        name, kind, _, writable = row
        if writable and name not in self.refused:
            self._values[name] = float(struct.unpack_from(_LAYOUTS[kind], raw)[0])
        return True

    @staticmethod
    def _row(number: int) -> tuple[str, str, float, bool] | None:
        place = number - _FIRST
        return _PARAMETERS[place] if 0 <= place < len(_PARAMETERS) else None


def flat_endpoints(firmware: str) -> dict[str, object]:
    """Return the contents of the vendor's flat_endpoints.json for this firmware."""
    endpoints = {
        name: {"id": _FIRST + place, "type": kind, "access": "rw" if writable else "r"}
        for place, (name, kind, _, writable) in enumerate(_PARAMETERS)
    }
    return {"fw_version": firmware, "hw_version": "5.2.0", "endpoints": endpoints}
