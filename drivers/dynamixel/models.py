"""The servos and registers of `tables/dynamixel.toml`, whose head names the pages they are from."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from statistics import fmean

POSITION_LSB = 2.0 * math.pi / 4096.0
"""rad a count (Present Position(132): 4096 a turn)."""
VELOCITY_LSB = 0.229 * 2.0 * math.pi / 60.0
"""rad/s a count of the X series (Present Velocity(128): 0.229 rev/min)."""


@dataclass(frozen=True, slots=True)
class Register:
    """An item of the control table; size in bytes."""

    address: int
    size: int
    signed: bool

    def encoded(self, value: int) -> bytes:
        """The bytes of `value`. Raises OverflowError where it does not fit."""
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decoded(self, data: bytes) -> int:
        """The value of the bytes."""
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True, slots=True)
class Model:
    """A servo; the fields are explained at the head of its table. `stall` holds (V, A, N m)."""

    name: str
    protocol: int
    number: int
    current_lsb: float
    current_max: int
    velocity_max: int
    temperature_max: int
    watchdog_firmware: int
    stall: tuple[tuple[float, float, float], ...]
    torque_uncertainty: float

    @property
    def torque_constant(self) -> float:
        """N m/A at the horn, from the stall points; crude. NaN where the servo measures no current."""
        return fmean(torque / current for _, current, torque in self.stall) if self.stall else math.nan


@cache
def _table() -> dict[str, dict[str, object]]:
    return tomllib.loads(files("drivers").joinpath("dynamixel/table.toml").read_text(encoding="utf-8"))


@cache
def registers(protocol: int) -> dict[str, Register]:
    """The registers by name, of the X series (protocol 2) or of the MX servos (protocol 1)."""
    rows = _table()["registers" if protocol == 2 else "mx_registers"]
    return {name: Register(*row) for name, row in rows.items()}  # type: ignore[misc]  # TOML is Any


@cache
def models() -> dict[str, Model]:
    """The servos by name."""
    rows: dict[str, dict[str, object]] = _table()["models"]  # type: ignore[assignment]  # TOML is Any
    return {
        name: Model(name, **{"protocol": 2} | row | {"stall": tuple(tuple(point) for point in row["stall"])})  # type: ignore[arg-type,attr-defined]  # TOML is Any
        for name, row in rows.items()
    }


def name_of(number: int) -> str:
    """What a person calls the servo that answers a ping with `number`."""
    return next((name for name, model in models().items() if model.number == number), "of a kind not known here")
