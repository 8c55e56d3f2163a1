"""How another process switches a drive's torque off over a link that this process has open.

A process that was killed or is frozen sends nothing. Each adapter therefore gives the frames that switch its drive off
without a reply, and those that restore what a run changed in it, as bytes for its link: see `OffPath`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

INTERVAL = 5e-3
"""s from one sending of the frames to the next, on a line that is fast enough."""


@dataclass(frozen=True, slots=True)
class OwnBus:
    """A bus that the other process opens a second time: interface and channel of python-can, bit/s."""

    interface: str
    channel: str
    bitrate: int
    data_bitrate: int = 0


@dataclass(frozen=True, slots=True)
class OffPath:
    """The frames that switch the torque off, and the way to the drive.

    off: frames that switch the torque off; they need no reply and may be repeated. restore: frames that restore the
    drive's settings afterwards, in their order. resync: bytes that end a frame which was cut off in the middle.
    descriptor: of the open port or socket, which a child process inherits; -1 where there is none. to: address and port
    to which a socket of datagrams sends. bus: where there is no descriptor to inherit; the frames are then slcan text.
    interval: s from one sending of `off` to the next. name: of the link, for messages.
    """

    off: tuple[bytes, ...]
    restore: tuple[bytes, ...] = ()
    resync: bytes = b""
    descriptor: int = -1
    to: tuple[str, int] | None = None
    bus: OwnBus | None = None
    interval: float = INTERVAL
    name: str = ""

    @property
    def reachable(self) -> bool:
        """Return whether another process can reach the drive: not where it is simulated in this one."""
        return self.descriptor >= 0 or self.bus is not None


@runtime_checkable
class HasOffPath(Protocol):
    """A servo whose torque another process can switch off."""

    def off_path(self) -> OffPath:
        """Return the way, with the settings to restore that have been changed so far."""
        ...


@runtime_checkable
class HasJournal(Protocol):
    """A servo that says when it is about to change a setting of its drive."""

    def keep_journal(self, journal: Callable[[], None]) -> None:
        """Call `journal` before each write of a setting, when `off_path` restores it already."""
        ...


def descriptor_of(port: object) -> int:
    """Return the descriptor of an open port or socket, -1 where it has none."""
    try:
        number = port.fileno()  # type: ignore[attr-defined]  # a port of a test may have none
    except (AttributeError, OSError, ValueError):
        return -1
    return int(number)


def serial_interval(packets: tuple[bytes, ...], baudrate: int) -> float:
    """Return the s between two sendings of `packets` on a line of `baudrate` bit/s, which is half idle then."""
    return max(INTERVAL, 2.0 * 10.0 * sum(map(len, packets)) / baudrate)
