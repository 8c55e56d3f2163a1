"""The DYNAMIXEL models and registers of table.toml, which also names the manual pages used."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from statistics import fmean

from drivers.tables import table

TURN = 4096
"""Counts of position in one turn, Present Position(132)."""
POSITION_LSB = math.tau / TURN
"""rad in one count of position."""
VELOCITY_LSB = 0.229 * math.tau / 60.0
"""rad/s in one count of the X series (Present Velocity(128): 0.229 rev/min)."""


@dataclass(frozen=True, slots=True)
class DynamixelRegister:
    """An item of the control table. size: bytes."""

    address: int
    size: int
    signed: bool

    def encoded(self, value: int) -> bytes:
        """Return the bytes of `value`. Raises OverflowError if it does not fit."""
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decoded(self, data: bytes) -> int:
        """Return the value that the bytes encode."""
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True, slots=True)
class DynamixelModel:
    """A DYNAMIXEL model; table.toml explains the fields. stall: the stall points, each as (V, A, N m)."""

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
        """N m/A at the horn, estimated from the stall points; NaN if the servo measures no current."""
        return fmean(torque / current for _, current, torque in self.stall) if self.stall else math.nan


@cache
def registers(protocol: int) -> dict[str, DynamixelRegister]:
    """Return the registers by name: of the X series for `protocol` 2, of the MX servos for `protocol` 1."""
    rows = table("dynamixel")["registers" if protocol == 2 else "mx_registers"]
    return {name: DynamixelRegister(*row) for name, row in rows.items()}


@cache
def models() -> dict[str, DynamixelModel]:
    """Return the DYNAMIXEL models by name."""
    tables = table("dynamixel")
    return {
        name: DynamixelModel(
            name,
            number=row["number"],
            stall=tuple(tuple(point) for point in row["stall"]),
            **{"protocol": 2} | tables["series"][row["series"]],
        )
        for name, row in tables["models"].items()
    }


def no_current(name: str) -> str:
    """Return why hil does not drive the servo `name`, which is of a series without a measured current; "" if it does
    not know the name.
    """
    if not re.match(r"(xl-?320|ax|dx|rx|mx-?12|mx-?28)", name.lower()):
        return ""
    return (
        f"dynamixel.model {name!r}: it measures no current, so no torque is inferred, and its control table has other "
        "registers, so that hil could not limit or stop it: use a servo of the X series, or an MX with protocol 2.0"
    )


def name_of(number: int) -> str:
    """Return the name of the model `number`."""
    return _names().get(number, "of a kind not known here")


def is_known(number: int) -> bool:
    """Return whether `number` is that of a known model, also of one that hil does not drive."""
    return number in _names()


@cache
def _names() -> dict[int, str]:
    refused: dict[str, int] = table("dynamixel")["refused"]
    return {model.number: name for name, model in models().items()} | {number: name for name, number in refused.items()}


def torque_enable(number: int) -> int | None:
    """Return the address of Torque Enable of the model `number`, None if it is not known. 0: any model of protocol 1.0.

    Source: e-manual, emanual.robotis.com/docs/en/dxl/: 24 in all servos of protocol 1.0 and in the XL-320.
    """
    if number in {0, *table("dynamixel")["refused"].values()}:
        return registers(1)["torque_enable"].address
    known = {model.number: model.protocol for model in models().values()}
    return registers(known[number])["torque_enable"].address if number in known else None
