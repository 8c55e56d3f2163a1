"""Read, write and restore the objects in the object dictionary of a CiA 402 drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.settings import Settings

if TYPE_CHECKING:
    from drivers.cia402.network import LinkedNetwork
    from drivers.cia402.profiles import ObjectIndex


class Objects:
    """The object dictionary of the node on `network`. Every method raises NoReply, Refused, BadReply, LinkLost."""

    def __init__(self, network: LinkedNetwork) -> None:
        self._network = network
        self.settings: Settings[ObjectIndex, bytes] = Settings(network.read, network.write)

    def get(self, place: ObjectIndex, *, signed: bool = False) -> int:
        """Read the object `place` as a number. The drive's reply determines its number of bytes. signed: whether it may
        be negative.
        """
        return int.from_bytes(self._network.read(place), "little", signed=signed)

    def text(self, place: ObjectIndex) -> str:
        """Read the object `place` as a string."""
        return self._network.read(place).decode("ascii", errors="replace").strip("\0 ")

    def put(self, place: ObjectIndex, value: int, size: int) -> None:
        """Write the number `value` to the object `place`, as `size` bytes."""
        self._network.write(place, value.to_bytes(size, "little", signed=value < 0))

    def require(self, place: ObjectIndex, value: int, what: str) -> None:
        """Write `value` to the object `place` and read it back. `restore` writes the earlier value again.

        what: name of the setting in messages. Raises as `Settings.require`.
        """
        data = value.to_bytes(len(self._network.read(place)), "little", signed=value < 0)
        self.settings.require(place, data, f"its {what} (object {place})")

    def changed(self) -> list[tuple[ObjectIndex, bytes]]:
        """Return the objects that `restore` will write, with their earlier values, in the order of writing."""
        return self.settings.changed()

    def restore(self) -> None:
        """Restore the objects that `require` changed. An object that the drive refuses to restore is skipped."""
        self.settings.restore()
