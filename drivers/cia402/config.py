"""The [cia402] table of stand.toml."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Unit

from drivers.gate import check_watchdog
from drivers.torque_constant import implausible


@dataclass(frozen=True, slots=True)
class Cia402Config:
    """The [cia402] table of stand.toml. Raises ValueError if two keys do not fit each other.

    interface, channel: the bus, as python-can names it. bitrate: bit/s. profile: the kind of drive. id: the drive's
    node id. own_id: the node id under which we send our heartbeat. torque_constant: N m/A; needed for the epos2, read
    from the epos4. rated_torque: N m; None: read from the drive. rated_torque_unit: N m of one count of the drive's
    rated torque (0x6076), if it differs from the profile's. resolution: counts a turn; None: read from the drive. sign:
    1 if the drive's positive direction is the stand's, else -1. watchdog: s without our heartbeat after which the drive
    stops by itself; 0: never. reply_timeout: s that a reply may take. reset_faults: whether to clear every latched
    fault when arming.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    interface: str
    channel: str
    profile: Literal["epos4", "epos2", "generic"]
    id: Annotated[int, Ge(1), Le(127)] = 1
    own_id: Annotated[int, Ge(1), Le(127)] = 127
    bitrate: Literal[20000, 50000, 125000, 250000, 500000, 800000, 1000000] = 1_000_000
    torque_constant: Annotated[float, Gt(0), Unit("N*m/A")] | None = None
    rated_torque: Annotated[float, Gt(0), Unit("N*m")] | None = None
    rated_torque_unit: Annotated[float, Gt(0), Unit("N*m")] | None = None
    resolution: Annotated[int, Gt(0)] | None = None
    sign: Literal[1, -1] = 1
    watchdog: Annotated[float, Ge(0), Le(5), Unit("s")] = 0.1
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.01
    reset_faults: bool = False

    def __post_init__(self) -> None:
        check_watchdog("cia402", self.watchdog, self.reply_timeout)
        if problem := implausible("cia402.torque_constant", self.torque_constant):
            raise ValueError(problem)
        if self.id == self.own_id:
            raise ValueError(f"cia402.own_id {self.own_id} is the drive's own id: choose another")
        if self.profile == "epos2" and self.torque_constant is None:
            raise ValueError("cia402.torque_constant (N m/A) must be given for an epos2, which measures current only")
