"""What a servo can tell about the other drives on its bus: which of them hold torque. They are only read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable


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
