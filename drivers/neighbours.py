"""What a servo can tell about the other drives on its bus: which of them hold torque, and how far they turn while it is
driven. They are only read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from drivers.servo import DriverError

_COUNTS, _SHARE, _MOST = 10, 0.5, 512
"""With all joints locked, a neighbour turns by fewer counts than the first number, or by less than this share of the
driven servo's turn, and by fewer counts than the last number in any case.
"""


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A drive with another id on the same bus whose torque is on, or which does not report whether it is.

    ident: its id on the bus. kind: its model, as far as it is known. state: what it reported. release: the register or
    frame that switches its torque off.
    """

    ident: int
    kind: str
    state: str
    release: str


@runtime_checkable
class HasNeighbours(Protocol):
    """A servo that can ask the other drives on its bus for their state without changing it."""

    def neighbours(self) -> list[Neighbour] | None:
        """Return the drives with other ids whose torque is on, or which do not report it; None if drives like this
        one cannot be asked.

        Takes about a second. To be called before the servo is armed. Raises DriverError.
        """


@runtime_checkable
class JoinsHand(Protocol):
    """A servo that watches the servos of the same hand on its bus while it is armed, and switches them off with it."""

    def join_hand(self, joints: Mapping[str, int]) -> None:
        """Set the servos of the hand: their ids by the names of their joints. To be called before the servo is armed.

        From arming on, a neighbour that reports an error, does not reply or turns raises DriverError in `exchange`, and
        the torque-off is confirmed only if every servo of the hand is off.
        """


@runtime_checkable
class SeesNeighbours(Protocol):
    """A servo that watches how far the other motors of a hand turn while it is driven."""

    def slower(self) -> tuple[float, float]:
        """Return by how much, s, an exchange takes longer once the servo is armed, since it writes a set-point and
        reads a neighbour now and then: on average, and with a neighbour. Zero without neighbours.

        To be called before the servo is armed. Raises DriverError.
        """

    def turned(self) -> Mapping[str, float]:
        """Return by how much each motor has turned since this servo was armed, rad at its shaft."""


@dataclass(slots=True)
class Swing:
    """The range of positions, counts, that a servo has had. turn: counts after which its position begins again at zero,
    0 if it never does.
    """

    turn: int
    last: int = 0
    position: int = 0
    low: int = 0
    high: int = 0

    def begin(self, raw: int) -> None:
        """Begin at the position `raw`."""
        self.last, self.position, self.low, self.high = raw, 0, 0, 0

    def note(self, raw: int) -> int:
        """Add the position `raw` and return the range so far."""
        step, self.last = raw - self.last, raw
        self.position += (step + self.turn // 2) % self.turn - self.turn // 2 if self.turn else step
        self.low, self.high = min(self.low, self.position), max(self.high, self.position)
        return self.range

    @property
    def range(self) -> int:
        """The range of positions so far, counts."""
        return self.high - self.low


def check_still(driven: str, turned: int, neighbour: str, moved: int) -> None:
    """Raise DriverError if a neighbour has `moved` by as many counts as no locked joint lets it. turned: counts by
    which the driven servo has turned.
    """
    if moved > max(_COUNTS, min(_SHARE * turned, _MOST)):
        raise DriverError(
            f"{driven} is driven and turned by {turned} counts, and {neighbour} turned by {moved} counts: the motor "
            "turns the wrong joint, whose Kc and Bc would be taken for this one's, or the palm yields as much as the "
            "cable; correct the ids in the hand file, look for a second id (Secondary ID) and for swapped tendons, and "
            "lock every joint"
        )
