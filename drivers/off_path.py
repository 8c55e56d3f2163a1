"""The data with which another process switches off the torque of a drive whose link this process has open.

A process that was killed or is frozen sends nothing. Each driver therefore gives, as bytes for its link, the frames
that switch the torque off without a reply and the frames that restore the drive's settings (`OffPath`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

INTERVAL = 5e-3
"""s between two sendings of the torque-off frames, on a line that is fast enough."""


@dataclass(frozen=True, slots=True)
class OwnBus:
    """A bus that the other process opens itself. interface, channel: names of python-can. bitrate, data_bitrate:
    bit/s.
    """

    interface: str
    channel: str
    bitrate: int
    data_bitrate: int = 0


@dataclass(frozen=True, slots=True)
class OffPath:
    """The frames that switch a drive's torque off, and the open link through which another process sends them.

    off: frames that switch the torque off; they need no reply and may be repeated. restore: frames that then restore
    the drive's settings, in their order. resync: bytes that end a frame which was cut off in the middle. descriptor:
    file descriptor of the open port or socket, which a child process inherits; -1 if there is none. lock: descriptor
    of the link's lock, which the child inherits too, so that nobody else opens the link before the torque is off. to:
    address and port to which a datagram socket sends. bus: the bus to open if there is no descriptor; the frames are
    slcan text then. interval: s between two sendings of `off`. name: name of the link in messages.
    """

    off: tuple[bytes, ...]
    restore: tuple[bytes, ...] = ()
    resync: bytes = b""
    descriptor: int = -1
    lock: int = -1
    to: tuple[str, int] | None = None
    bus: OwnBus | None = None
    interval: float = INTERVAL
    name: str = ""

    @property
    def reachable(self) -> bool:
        """Return whether another process can reach the drive: it cannot reach a drive that is simulated in this
        process.
        """
        return self.descriptor >= 0 or self.bus is not None


@runtime_checkable
class HasOffPath(Protocol):
    """A servo whose torque another process can switch off."""

    def off_path(self) -> OffPath:
        """Return the frames that switch the torque off, and the link that carries them.

        The frames in `restore` undo the changes of settings that were made so far.
        """
        ...


@runtime_checkable
class HasJournal(Protocol):
    """A servo that calls a function before it changes a setting of its drive."""

    def keep_journal(self, journal: Callable[[], None]) -> None:
        """Call `journal` before each write of a setting; at that moment `off_path` already restores this setting."""
        ...


def descriptor_of(port: object) -> int:
    """Return the file descriptor of an open port or socket, -1 if it has none."""
    try:
        number = port.fileno()  # type: ignore[attr-defined]  # a port of a test may have none
    except (AttributeError, OSError, ValueError):
        return -1
    return int(number)


def serial_interval(packets: tuple[bytes, ...], baudrate: int) -> float:
    """Return the s between two sendings of `packets`, such that a line of `baudrate` bit/s is idle half of the time."""
    return max(INTERVAL, 2.0 * 10.0 * sum(map(len, packets)) / baudrate)
