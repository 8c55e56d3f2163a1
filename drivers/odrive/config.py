"""The [odrive] table of stand.toml."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Unit

from drivers.gate import check_watchdog
from drivers.torque_constant import implausible


@dataclass(frozen=True, slots=True)
class OdriveConfig:
    """The [odrive] table of stand.toml. Raises ValueError if watchdog and reply_timeout do not fit each other.

    interface: the kind of bus in python-can. channel: the bus, as python-can names it. bitrate: bit/s. id: the axis'
    node id. torque_constant: N m/A, 8.27 divided by the motor's KV (rev/min/V). sign: 1 if the axis' positive direction
    is the stand's, else -1. endpoints: the flat_endpoints.json of the firmware in the drive (0.6 only); with this file
    watchdog and limits are written and read back. watchdog: s without a set-point after which the axis stops by itself;
    needs `endpoints`; 0: the drive's own setting. reply_timeout: s that the replies of a tick may take.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    interface: str
    channel: str
    torque_constant: Annotated[float, Gt(0), Unit("N*m/A")]
    id: Annotated[int, Ge(0), Le(62)] = 0
    bitrate: Literal[125000, 250000, 500000, 1000000] = 250_000
    sign: Literal[1, -1] = 1
    endpoints: str | None = None
    watchdog: Annotated[float, Ge(0), Le(5), Unit("s")] = 0.1
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.008

    def __post_init__(self) -> None:
        check_watchdog("odrive", self.watchdog, self.reply_timeout)
        if problem := implausible("odrive.torque_constant", self.torque_constant):
            raise ValueError(problem)
