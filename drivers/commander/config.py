"""The [commander] table of stand.toml: a SimpleFOC board with Commander."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Unit

from drivers.gate import check_watchdog
from drivers.torque_constant import implausible


@dataclass(frozen=True, slots=True)
class CommanderConfig:
    """The [commander] table of stand.toml. Raises ValueError if watchdog and reply_timeout do not fit each other.

    port: the serial port. torque_constant: N m/A at the motor shaft. watchdog: s of silence after which the board's
    program disables the motor; 0: never, as in the library's examples, so that the motor stays live when this computer
    stops. motor: the letter under which the program added the motor. baudrate: bit/s; a board with a USB socket of its
    own accepts any. torque_mode: the board's current control. sign: 1 if the board's positive direction is the stand's,
    else -1. reply_timeout: s that a reply may take beyond its time on the wire. start: s that the board may take to
    boot and align the motor, since opening the port restarts many boards.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid", "allow_inf_nan": False}

    port: str
    torque_constant: Annotated[float, Gt(0), Unit("N*m/A")]
    watchdog: Annotated[float, Ge(0), Le(10), Unit("s")]
    motor: Literal["M", "A", "B", "C", "D", "X", "Y", "Z"] = "M"
    baudrate: Annotated[int, Ge(9600), Le(12_000_000)] = 1_000_000
    torque_mode: Literal["foc_current", "dc_current"] = "foc_current"
    sign: Literal[1, -1] = 1
    reply_timeout: Annotated[float, Gt(0), Le(0.5), Unit("s")] = 0.008
    start: Annotated[float, Gt(0), Le(60), Unit("s")] = 8.0

    def __post_init__(self) -> None:
        check_watchdog("commander", self.watchdog, self.reply_timeout)
        if problem := implausible("commander.torque_constant", self.torque_constant):
            raise ValueError(problem)
