"""The emulated Feetech models with their memory tables. They are read from table.toml, which names its sources."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.tables import table
from sim_backend.wire.packets.registers import Item, items_of

BAUD = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
"""bit/s by the value of Baud Rate(6)."""
EEPROM_END = 40
CURRENT_LSB = 6.5e-3
"""A in one count of current."""


@dataclass(frozen=True, slots=True)
class FeetechModel:
    """A Feetech model as its specification describes it.

    number: main and sub version. firmware: major and minor version. stall: voltage V, current A and torque N m at
    stall. count: rad in one count of position. calibrates: the firmware from which the servo knows the instruction
    Position Calibration without and with a value; empty if it does not.
    """

    family: str
    number: tuple[int, int]
    firmware: tuple[int, int]
    stall: tuple[float, float, float]
    count: float
    calibrates: tuple[tuple[int, int], ...]
    items: tuple[Item, ...]

    @property
    def big(self) -> bool:
        """Return whether words have the high byte first."""
        return self.family == "scs"


def _model(name: str) -> FeetechModel:
    tables = table("feetech", "sim_backend.wire")
    row, items = tables["models"][name], tables["items"]
    family = row["family"]
    scs = family == "scs"
    own = items_of(items["common"], {} if scs else items["magnetic"], items[family], initial=tables["initial"][name])
    count = math.radians(300.0) / 1024.0 if scs else math.tau / 4096.0
    number, firmware, stall = (tuple(row[key]) for key in ("number", "firmware", "stall"))
    calibrates = tuple(tuple(version) for version in tables["calibrates"].get(family, ()))
    return FeetechModel(family, number, firmware, stall, count, calibrates, own)


MODELS = {name: _model(name) for name in table("feetech", "sim_backend.wire")["models"]}
"""The Feetech models by the name used in stand files."""
