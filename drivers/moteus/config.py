"""The [moteus] table of stand.toml."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, Self

from annotated_types import Ge, Gt, Le, Unit

from drivers.gate import check_watchdog
from drivers.servo import Quantity


@dataclass(frozen=True, slots=True)
class MoteusConfig:
    """The [moteus] table of stand.toml. Raises ValueError if watchdog and reply_timeout do not fit each other.

    interface: the kind of bus in python-can; it must carry CAN FD. channel: the bus, as python-can names it. bitrate:
    bit/s of the identifiers. data_bitrate: bit/s of the data. id: the controller's id on the bus. source: our id on the
    bus. mode: the quantity that is commanded; None: the quantity that the run commands. sign: 1 if the controller's
    positive direction is the stand's, else -1. watchdog: s without a command after which the controller stops by
    itself. reply_timeout: s that a reply may take.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    interface: str
    channel: str
    id: Annotated[int, Ge(1), Le(126)] = 1
    source: Annotated[int, Ge(0), Le(126)] = 0
    bitrate: Annotated[int, Gt(0)] = 1_000_000
    data_bitrate: Annotated[int, Gt(0)] = 5_000_000
    mode: Literal["torque", "position"] | None = None
    sign: Literal[1, -1] = 1
    watchdog: Annotated[float, Gt(0), Le(5), Unit("s")] = 0.1
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.008

    def __post_init__(self) -> None:
        check_watchdog("moteus", self.watchdog, self.reply_timeout)
        if self.id == self.source:
            raise ValueError(f"moteus.source {self.source} is the controller's own id: choose another")

    def for_quantity(self, quantity: Quantity) -> Self:
        """Return the configuration that commands `quantity`. Raises ValueError if the stated `mode` is the other
        quantity.
        """
        if self.mode not in {None, quantity.value}:
            raise ValueError(f"moteus.mode = {self.mode!r} does not command {quantity}: remove it")
        return replace(self, mode=quantity.value)

    @property
    def quantity(self) -> Quantity:
        """The quantity that is commanded; torque where `mode` is None."""
        return Quantity(self.mode or "torque")
