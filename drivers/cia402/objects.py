"""Read, write and restore the objects in the object dictionary of a CiA 402 drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.servo import BadReply
from drivers.settings import Settings

if TYPE_CHECKING:
    from drivers.cia402.network import LinkedNetwork
    from drivers.cia402.profiles import ObjectIndex

_LARGEST = 4  # bytes of a number


class Objects:
    """The object dictionary of the node on `network`. Every method raises NoReply, Refused, BadReply, LinkLost."""

    def __init__(self, network: LinkedNetwork) -> None:
        self._network = network
        self.settings: Settings[ObjectIndex, bytes] = Settings(network.read, network.write)

    def get(self, place: ObjectIndex, *, signed: bool = False) -> int:
        """Read the object `place` as a number. The drive's reply determines its number of bytes, 1 to 4. signed:
        whether it may be negative.
        """
        data = self._network.read(place)
        if not 1 <= len(data) <= _LARGEST:
            raise BadReply(f"object {place}: the drive answers with {len(data)} bytes, which is no number")
        return int.from_bytes(data, "little", signed=signed)

    def text(self, place: ObjectIndex) -> str:
        """Read the object `place` as a string."""
        return self._network.read(place).decode("ascii", errors="replace").strip("\0 ")

    def put(self, place: ObjectIndex, value: int, size: int) -> None:
        """Write the number `value` to the object `place`, as `size` bytes."""
        self._network.write(place, _packed(place, value, size))

    def require(self, place: ObjectIndex, value: int, what: str) -> None:
        """Write `value` to the object `place` and read it back. `restore` writes the earlier value again.

        what: name of the setting in messages. Raises DriverError if the drive then holds another value.
        """
        data = _packed(place, value, len(self._network.read(place)))
        self.settings.require(place, data, f"its {what} (object {place})")

    def changed(self) -> list[tuple[ObjectIndex, bytes]]:
        """Return the objects that `restore` will write, with their earlier values, in the order of writing."""
        return self.settings.changed()

    def restore(self) -> None:
        """Restore the objects that `require` changed. An object that the drive refuses to restore is skipped."""
        self.settings.restore()


def _packed(place: ObjectIndex, value: int, size: int) -> bytes:
    """Return `value` as `size` bytes. Raises BadReply if it needs more: then the drive's reply was cut short."""
    try:
        return value.to_bytes(size, "little", signed=value < 0)
    except OverflowError:
        raise BadReply(
            f"object {place}: {value} does not fit into the {size} bytes with which the drive answers: nothing was "
            "written; check the cable, and whether two nodes have this id"
        ) from None
