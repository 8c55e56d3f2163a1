"""The objects of one CiA 402 drive: read, written, and put back as they were found."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from drivers.servo import DriverError

if TYPE_CHECKING:
    from drivers.cia402.network import LinkedNetwork
    from drivers.cia402.profiles import Place


class Objects:
    """The dictionary of the node of `network`, as numbers. Every call raises NoReply, Refused, BadReply, LinkLost."""

    def __init__(self, network: LinkedNetwork) -> None:
        self._network = network
        self._found: dict[Place, bytes] = {}

    def get(self, place: Place, *, signed: bool = False) -> int:
        """A number, of the size that the drive says."""
        return int.from_bytes(self._network.read(place), "little", signed=signed)

    def text(self, place: Place) -> str:
        """A visible string."""
        return self._network.read(place).decode("ascii", errors="replace").strip("\0 ")

    def put(self, place: Place, value: int, size: int) -> None:
        """Set a number of `size` bytes."""
        self._network.write(place, value.to_bytes(size, "little", signed=value < 0))

    def require(self, place: Place, value: int, what: str) -> None:
        """Set a number, read it back, and keep what was there for `restore`. Raises DriverError where it is not so."""
        found = self._network.read(place)
        data = value.to_bytes(len(found), "little", signed=value < 0)
        if data != found:
            self._found.setdefault(place, found)
            self._network.write(place, data)
            if self._network.read(place) != data:
                raise DriverError(f"the drive does not keep its {what} (object {place}) at {value}: nothing was armed")

    def restore(self) -> None:
        """Put back what `require` changed, newest first. Never raises."""
        with contextlib.suppress(DriverError):
            for place, data in reversed(self._found.items()):
                self._network.write(place, data)
            self._found.clear()
