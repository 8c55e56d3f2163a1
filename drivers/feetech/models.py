"""The Feetech models and registers of table.toml, which also names its sources."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

from drivers.tables import table

CURRENT_LSB = 6.5e-3
"""A in one count (Present Current(69), Protection Current(28), Goal Torque(44) of HLS)."""
SPEED_UNIT = 50
"""Steps/s in one count of speed: 0.732 rev/min. Where bit 2 of an STS's Phase(18) is set, one count is one step/s."""

Family = Literal["sts", "hls", "scs"]


@dataclass(frozen=True, slots=True)
class FeetechRegister:
    """An item of the memory table. size: bytes. sign_bit: the bit that means negative, 0 if the value is unsigned. big:
    whether the high byte comes first.
    """

    address: int
    size: int
    sign_bit: int
    big: bool

    def encoded(self, value: int) -> bytes:
        """Return `value` as bytes, encoded as magnitude and sign bit. Raises OverflowError if it does not fit."""
        limit = 1 << (self.sign_bit or 8 * self.size)
        if abs(value) >= limit or (value < 0 and not self.sign_bit):
            raise OverflowError(f"{value} does not fit into the {self.size} byte(s) at {self.address}")
        raw = abs(value) | (limit if value < 0 else 0)
        return raw.to_bytes(self.size, "big" if self.big else "little")

    def decoded(self, data: bytes) -> int:
        """Return the value that the bytes encode."""
        raw = int.from_bytes(data, "big" if self.big else "little")
        return signed(raw, self.sign_bit) if self.sign_bit else raw


def signed(raw: int, sign_bit: int) -> int:
    """Return the signed value of `raw`, a magnitude in which bit `sign_bit` means negative."""
    magnitude = raw & ((1 << sign_bit) - 1)
    return -magnitude if raw >> sign_bit & 1 else magnitude


@dataclass(frozen=True, slots=True)
class FeetechModel:
    """A Feetech model; table.toml explains the fields."""

    name: str
    family: Family
    number: tuple[int, int]
    firmware: tuple[int, int]
    stall: float
    torque_constant: float
    torque_uncertainty: float

    @property
    def has_torque_mode(self) -> bool:
        """Return whether the servo accepts a current as set-point."""
        return self.family == "hls"

    @property
    def has_current(self) -> bool:
        """Return whether the servo measures its current."""
        return self.family != "scs"

    @property
    def position_lsb(self) -> float:
        """rad in one count of position: a turn has 4096 counts; an SCS has 1024 counts over 300 degrees."""
        return math.radians(300.0) / 1024.0 if self.family == "scs" else math.tau / 4096.0

    @property
    def turn(self) -> int:
        """Number of counts after which the position begins again at zero; 0 if it never does."""
        return 0 if self.family == "scs" else 4096


@cache
def registers(family: Family) -> dict[str, FeetechRegister]:
    """Return the registers of a model family by name."""
    rows = table("feetech")["registers"][family]
    big = family == "scs"
    return {name: FeetechRegister(address, size, bit, big) for name, (address, size, bit) in rows.items()}


@cache
def models() -> dict[str, FeetechModel]:
    """Return the Feetech models by name."""
    rows: dict[str, dict[str, object]] = table("feetech")["models"]
    pairs = ("number", "firmware")
    return {
        name: FeetechModel(name, **{key: tuple(value) if key in pairs else value for key, value in row.items()})  # type: ignore[arg-type]  # TOML is Any
        for name, row in rows.items()
    }


def name_of(number: tuple[int, int]) -> str:
    """Return the name of the model whose main and sub version are `number`; "" if it is not known."""
    return next((name for name, model in models().items() if model.number == number), "")
