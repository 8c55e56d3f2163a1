"""The [mit] table of stand.toml."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Unit

from drivers.gate import check_watchdog
from drivers.mit.frames import models

if TYPE_CHECKING:
    ModelName = str
else:
    ModelName = Literal[tuple(sorted(models()))]  # so that a refused name is reported with all that are known


@dataclass(frozen=True, slots=True)
class MitConfig:
    """The [mit] table of stand.toml. Raises ValueError for a model that is not known, or if values do not fit each
    other.

    interface: the kind of bus in python-can. channel: the bus, as python-can names it. bitrate: bit/s. model: the type
    of the motor. id: the motor's CAN id. reply_id: the CAN identifier of the motor's replies (a Damiao's master id);
    None: 0 for a Damiao, the motor's id or 0 for an AK. position_range: rad, full scale of the position counts, if it
    differs from the table's. velocity_range: rad/s, full scale of the velocity counts, if it differs from the table's.
    torque_range: N m, full scale of the torque counts, if it differs from the table's. torque_scale: true torque
    divided by reported torque. temperature_offset: K subtracted from an AK's reading. sign: 1 if the motor's positive
    direction is the stand's, else -1. watchdog: s without a frame after which a Damiao stops by itself; 0: never; an
    AK's is set with the vendor's tool. reply_timeout: s that a reply may take.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    interface: str
    channel: str
    model: ModelName
    id: Annotated[int, Ge(1), Le(127)] = 1
    reply_id: Annotated[int, Ge(0), Le(0x7FE)] | None = None
    bitrate: Literal[125000, 250000, 500000, 1000000] = 1_000_000
    position_range: Annotated[float, Gt(0), Unit("rad")] | None = None
    velocity_range: Annotated[float, Gt(0), Unit("rad/s")] | None = None
    torque_range: Annotated[float, Gt(0), Unit("N*m")] | None = None
    torque_scale: Annotated[float, Gt(0)] = 1.0
    temperature_offset: Annotated[float, Ge(0), Le(60), Unit("K")] = 0.0
    sign: Literal[1, -1] = 1
    watchdog: Annotated[float, Ge(0), Le(5), Unit("s")] = 0.1
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.008

    def __post_init__(self) -> None:
        if self.model not in models():
            raise ValueError(f"mit.model {self.model!r} is not known; there are {', '.join(sorted(models()))}")
        check_watchdog("mit", self.watchdog, self.reply_timeout)

    @property
    def ranges(self) -> tuple[float, float, float]:
        """The values at full scale of the counts: position rad, velocity rad/s, torque N m."""
        model = models()[self.model]
        return (
            self.position_range or model.position,
            self.velocity_range or model.velocity,
            self.torque_range or model.torque,
        )

    @property
    def largest_torque(self) -> float:
        """The largest torque that a frame can command, N m."""
        return self.ranges[2] * self.torque_scale

    @property
    def reply_ids(self) -> frozenset[int]:
        """The CAN identifiers that the motor's replies may have."""
        if self.reply_id is not None:
            return frozenset({self.reply_id})
        return frozenset({0}) if models()[self.model].family == "damiao" else frozenset({0, self.id})
