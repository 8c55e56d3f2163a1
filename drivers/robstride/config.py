"""The [robstride] table of stand.toml."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Unit

from drivers.gate import check_watchdog
from drivers.robstride.frames import BROADCAST, models

if TYPE_CHECKING:
    ModelName = str
else:
    ModelName = Literal[tuple(sorted(models()))]  # so that a refused name is reported with all that are known


@dataclass(frozen=True, slots=True)
class RobstrideConfig:
    """The [robstride] table of stand.toml. Raises ValueError for an unknown model, or if values do not fit each other.

    interface: the kind of bus in python-can. channel: the bus, as python-can names it. bitrate: bit/s. model: the type
    of the motor. id: the motor's CAN id. host_id: our id on the bus. position_range: rad, full scale of the counts, if
    it differs from the firmware's. velocity_range: rad/s, full scale, if it differs from the table's. torque_range: N
    m, full scale, if it differs from the table's. torque_scale: true torque divided by reported torque. sign: 1 if the
    motor's positive direction is the stand's, else -1. watchdog: s without a frame after which the motor stops by
    itself; 0: the motor's present setting. reply_timeout: s that a reply may take.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    interface: str
    channel: str
    model: ModelName
    id: Annotated[int, Ge(1), Le(127)] = 1
    host_id: Annotated[int, Ge(0), Le(255)] = 0xFD
    bitrate: Literal[125000, 250000, 500000, 1000000] = 1_000_000
    position_range: Annotated[float, Gt(0), Le(1e3), Unit("rad")] | None = None
    velocity_range: Annotated[float, Gt(0), Le(1e4), Unit("rad/s")] | None = None
    torque_range: Annotated[float, Gt(0), Le(1e4), Unit("N*m")] | None = None
    torque_scale: Annotated[float, Ge(1e-3), Le(1e3)] = 1.0
    sign: Literal[1, -1] = 1
    watchdog: Annotated[float, Ge(0), Le(5), Unit("s")] = 0.1
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.008

    def __post_init__(self) -> None:
        if self.model not in models():
            raise ValueError(f"robstride.model {self.model!r} is not known; there are {', '.join(sorted(models()))}")
        if self.host_id in {self.id, BROADCAST}:
            raise ValueError(f"robstride.host_id {self.host_id} is the motor's id or the broadcast's: choose another")
        if self.watchdog and not models()[self.model].watchdog:
            raise ValueError(
                f"a {self.model} has no watchdog (canTimeout): its torque stays on if the computer stops; "
                "set robstride.watchdog = 0"
            )
        check_watchdog("robstride", self.watchdog, self.reply_timeout)

    @property
    def largest_torque(self) -> float:
        """The largest torque that a frame can command, N m."""
        return (self.torque_range or models()[self.model].torque) * self.torque_scale
