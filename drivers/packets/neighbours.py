"""Read whether the torque of another servo on the same line is on."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from drivers.neighbours import Neighbour
from drivers.retry import retry
from drivers.servo import DriverError, LinkLost

if TYPE_CHECKING:
    from drivers.packets.bus import Bus


def others(ident: int, ping: Callable[[], list[tuple[int, int]]]) -> list[tuple[int, int]]:
    """Return id and model number of the other servos that reply to `ping`, which pings all servos on the line.

    If the reply of the stand's servo, `ident`, is missing, the line loses replies, and the pings are sent once more.
    """
    found = set(ping())
    if ident not in dict(found):
        found |= set(ping())
    return sorted(servo for servo in found if servo[0] != ident)


def holding(bus: Bus, ident: int, kind: str, address: int | None) -> list[Neighbour]:
    """Return the servo `ident` if its torque is on or cannot be read, else [].

    bus: to that servo. kind: its model. address: of its Torque Enable, None if it is not known. Raises LinkLost.
    """
    if address is None:
        return [Neighbour(ident, kind, "its registers are not known to hil", "switch its torque off with its tool")]
    release = f"write 0 to its Torque Enable({address})"
    try:
        value = retry(lambda: bus.read(address, 1)[0])
    except LinkLost:
        raise
    except DriverError as error:
        return [Neighbour(ident, kind, f"its Torque Enable({address}) cannot be read ({error})", release)]
    return [Neighbour(ident, kind, f"its Torque Enable({address}) is {value}", release)] if value else []
