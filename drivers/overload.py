"""When a servo protects itself from a load that lasts too long."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:
    from drivers.servo import Limits


class Overload(NamedTuple):
    """The load at which a servo protects itself. torque: N m at the motor shaft. acts: a clause that says when it acts
    and what it does then, with the registers that set it. remedy: the register that raises the load.
    """

    torque: float
    acts: str
    remedy: str


@runtime_checkable
class HasOverload(Protocol):
    """A servo whose registers say when an overload protection acts."""

    def overload(self, limits: Limits) -> Overload | None:
        """Return the load at which the protection acts in a run within `limits`; None if it is off or the servo has
        none. The registers are only read. Raises DriverError.
        """
