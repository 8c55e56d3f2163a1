"""The emulated DYNAMIXEL models: the X series and the MX servos with protocol 1.0. They are read from table.toml, which
names its sources.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.tables import table
from sim_backend.wire.packets.registers import Item, items_of
from sim_backend.wire.packets.regulator import CURRENT, CURRENT_POSITION, EXTENDED, POSITION, PWM, SPEED


@dataclass(frozen=True, slots=True)
class DynamixelModel:
    """A DYNAMIXEL model as its manual page describes it.

    current_lsb: A in one count of current, 0 if the servo measures none. stall: voltage V, current A and torque N m at
    stall. indirect: the ranges of indirect addressing, each as (first address item, first data item, number of slots).
    """

    number: int
    current_lsb: float
    stall: tuple[float, float, float]
    firmware: int
    indirect: tuple[tuple[int, int, int], ...]
    items: tuple[Item, ...]


BAUD = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""bit/s by the value of Baud Rate(8)."""

MODES = (CURRENT, SPEED, POSITION, EXTENDED, CURRENT_POSITION, PWM)

RPM = 0.229 * 2.0 * math.pi / 60.0
"""rad/s in one count of velocity of an X servo: 0.229 rev/min."""

MX_RPM = 0.114 * 2.0 * math.pi / 60.0
"""rad/s in one count of velocity of an MX servo: 0.114 rev/min."""

MX_EEPROM_END = 24
MX_BAUD = {
    1: 1_000_000,
    3: 500_000,
    4: 400_000,
    7: 250_000,
    9: 200_000,
    16: 115_200,
    34: 57_600,
    103: 19_200,
    207: 9_600,
    250: 2_250_000,
    251: 2_500_000,
    252: 3_000_000,
}
"""bit/s by the value of Baud Rate(4) of the MX servos."""

_TABLE = table("dynamixel", "sim_backend.wire")


def _model(name: str) -> DynamixelModel:
    series, number, stall, initial = _TABLE["models"][name]
    current_lsb, firmware, tables, without, indirect = _TABLE["series"][series]
    rows = {item: row for part in tables for item, row in _TABLE["items"][part].items() if item not in without}
    items = [
        *items_of(rows, initial=initial | {"model_number": number, "firmware_version": firmware}),
        *_indirect(indirect),
    ]
    ordered = tuple(sorted(items, key=lambda item: item.address))
    ranges = tuple((address, data, slots) for address, data, slots in indirect)
    return DynamixelModel(number, current_lsb, tuple(stall), firmware, ranges, ordered)


def _indirect(ranges: list[list[int]]) -> list[Item]:
    items = []
    for address, data, slots in ranges:
        highest = max(data + slots for _, data, slots in ranges) - 1
        items += [Item(address + 2 * i, 2, "indirect_address", data + i, 64, highest) for i in range(slots)]
        items += [Item(data + i, 1, "indirect_data", 0, 0, 255) for i in range(slots)]
    return items


_ALL = {name: _model(name) for name in _TABLE["models"]}
MX_MODELS = {name: _ALL.pop(name) for name in ("mx-64", "mx-106")}
"""The models with protocol 1.0 by the name used in stand files. The stall point is that at the recommended voltage."""
MODELS = _ALL
"""The models with protocol 2.0."""
