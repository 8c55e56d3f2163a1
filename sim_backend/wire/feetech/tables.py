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
    stall. count: rad in one count of position. big: whether words have the high byte first.
    """

    number: tuple[int, int]
    firmware: tuple[int, int]
    stall: tuple[float, float, float]
    count: float
    big: bool
    items: tuple[Item, ...]


def _model(name: str) -> FeetechModel:
    tables = table("feetech", "sim_backend.wire")
    row, items = tables["models"][name], tables["items"]
    scs = row["family"] == "scs"
    own = items_of(
        items["common"], {} if scs else items["magnetic"], items[row["family"]], initial=tables["initial"][name]
    )
    count = math.radians(300.0) / 1024.0 if scs else math.tau / 4096.0
    return FeetechModel(tuple(row["number"]), tuple(row["firmware"]), tuple(row["stall"]), count, scs, own)


MODELS = {name: _model(name) for name in table("feetech", "sim_backend.wire")["models"]}
"""The Feetech models by the name used in stand files."""
