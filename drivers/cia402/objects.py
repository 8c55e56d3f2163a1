"""The objects of one CiA 402 drive: read, written, and restored."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.settings import Settings

if TYPE_CHECKING:
    from drivers.cia402.network import LinkedNetwork
    from drivers.cia402.profiles import ObjectIndex


class Objects:
    """The object dictionary of the node of `network`. Every call raises NoReply, Refused, BadReply, LinkLost."""

    def __init__(self, network: LinkedNetwork) -> None:
        self._network = network
        self.settings: Settings[ObjectIndex, bytes] = Settings(network.read, network.write)

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
        """Make an object hold a number, read back; `restore` writes the earlier one. Raises as `Settings.require`."""
        data = value.to_bytes(len(self._network.read(place)), "little", signed=value < 0)
        self.settings.require(place, data, f"its {what} (object {place})")

    def changed(self) -> list[tuple[ObjectIndex, bytes]]:
        """Return the objects that `restore` writes and the values that they had, in its order."""
        return self.settings.changed()

    def restore(self) -> None:
        """Restore what `require` changed, as far as the drive accepts it."""
        self.settings.restore()
