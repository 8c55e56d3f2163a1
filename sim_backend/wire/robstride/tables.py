"""The emulated RobStride motors and their parameters. They are read from table.toml, which names its source."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

from drivers.tables import table

_TABLE = table("robstride", "sim_backend.wire")


@dataclass(frozen=True, slots=True)
class RobstrideModel:
    """A RobStride model. span: full scale of the counts: velocity rad/s, torque N m, kp N m/rad, kd N m s/rad. highest:
    index of its last parameter. table.toml explains the other fields.
    """

    firmware: tuple[int, ...]
    span: tuple[float, float, float, float]
    current: float
    rms_constant: float
    resistance: float
    hottest: float
    inertia: float
    highest: int = 0xFFFF

    @property
    def torque_constant(self) -> float:
        """The torque constant, N m per A of peak phase current, the motor's unit of current."""
        return self.rms_constant / math.sqrt(2.0)


MODELS = {name: RobstrideModel(tuple(row[0]), tuple(row[1]), *row[2:]) for name, row in _TABLE["models"].items()}
"""By the name used in stand files."""


@dataclass(frozen=True, slots=True)
class Item:
    """A parameter. bounds: the lowest and the highest value that may be written; (): the parameter is read-only."""

    name: str
    layout: struct.Struct
    initial: float
    bounds: tuple[float, ...]


def items(model: RobstrideModel) -> dict[int, Item]:
    """Return the parameters of a motor by index."""
    known: dict[Any, float] = {"velocity": model.span[0], "torque": model.span[1], "current": model.current}
    known |= {f"-{name}": -value for name, value in known.items()} | {"measured": 0.0}
    rows = {}
    for index, (name, text, *values) in _TABLE["parameters"].items():
        initial, *bounds = (float(known.get(value, value)) for value in values)
        rows[int(index, 16)] = Item(name, struct.Struct(text), initial, tuple(bounds))
    return rows
