"""The emulated motors with MIT frames, and the registers of a Damiao. They are read from table.toml, which names its
sources.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.tables import table


@dataclass(frozen=True, slots=True)
class MitModel:
    """A CubeMars or Damiao model. span: full scale of the counts: position rad, velocity rad/s, torque N m. table.toml
    explains the other fields.
    """

    damiao: bool
    span: tuple[float, float, float]
    gear: float
    torque_constant: float
    resistance: float
    inertia: float


MODELS = {
    name: MitModel(damiao, tuple(span), *more)
    for name, (damiao, span, *more) in table("mit", "sim_backend.wire")["models"].items()
}
"""The models by the name used in stand files."""


@dataclass(frozen=True, slots=True)
class Item:
    """A register of a Damiao. whole: whether it is an unsigned integer; otherwise it is a float. low, high: the range
    of values that may be written.
    """

    name: str
    initial: float
    whole: bool = False
    writable: bool = False
    low: float = -math.inf
    high: float = math.inf


def registers(model: MitModel, ident: int, reply_id: int) -> dict[int, Item]:
    """Return the registers of a Damiao by number."""
    known: dict[str, float] = {"ident": ident, "reply_id": reply_id, "gear": model.gear}
    known |= {"torque_constant": model.torque_constant, "resistance": model.resistance}
    known |= dict(zip(("position", "velocity", "torque"), model.span, strict=True))
    rows = {}
    for number, (name, kind, initial, *bounds) in table("mit", "sim_backend.wire")["registers"].items():
        rows[int(number)] = Item(name, known.get(initial, initial), kind == "uint", bool(bounds), *bounds)
    return rows
