"""The objects of one CiA 402 drive: read, written, and restored."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from drivers.servo import DriverError

if TYPE_CHECKING:
    from drivers.cia402.network import LinkedNetwork
    from drivers.cia402.profiles import ObjectIndex


class Objects:
    """The object dictionary of the node of `network`. Every call raises NoReply, Refused, BadReply, LinkLost."""

    def __init__(self, network: LinkedNetwork) -> None:
        self._network = network
        self._before: dict[ObjectIndex, bytes] = {}

    def get(self, place: ObjectIndex, *, signed: bool = False) -> int:
        """Return a number, of the size that the drive reports."""
        return int.from_bytes(self._network.read(place), "little", signed=signed)

    def text(self, place: ObjectIndex) -> str:
        """Return a visible string."""
        return self._network.read(place).decode("ascii", errors="replace").strip("\0 ")

    def put(self, place: ObjectIndex, value: int, size: int) -> None:
        """Write a number of `size` bytes."""
        self._network.write(place, value.to_bytes(size, "little", signed=value < 0))

    def require(self, place: ObjectIndex, value: int, what: str) -> None:
        """Write a number and read it back; keep the earlier one for `restore`. Raises DriverError where they differ."""
        before = self._network.read(place)
        data = value.to_bytes(len(before), "little", signed=value < 0)
        if data != before:
            self._before.setdefault(place, before)
            self._network.write(place, data)
            if self._network.read(place) != data:
                raise DriverError(f"the drive does not keep its {what} (object {place}) at {value}: nothing was armed")

    def changed(self) -> list[tuple[ObjectIndex, bytes]]:
        """Return the objects that `restore` writes and the values that they had, in its order."""
        return list(reversed(self._before.items()))

    def restore(self) -> None:
        """Restore what `require` changed, newest first. Never raises DriverError."""
        with contextlib.suppress(DriverError):
            for place, data in reversed(self._before.items()):
                self._network.write(place, data)
            self._before.clear()
