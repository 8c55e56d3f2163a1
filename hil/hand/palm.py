"""How far the locked joints of a simulated or emulated hand yield, and how far its other motors turn with them.

A lock yields by its fixture, and all joints stand on one palm, which yields to the sum of their torques. A motor that
is off turns with its tendon, and that with the joints that it passes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sim_backend.parameters import FixtureParameters


class Tendon(NamedTuple):
    """A motor with its tendon. row: the turns of each joint that it passes for one turn of its joint `moves`, which is
    among them. lock: of that joint.
    """

    motor: str
    gear_ratio: float
    moves: str
    row: Mapping[str, float]
    lock: FixtureParameters


def yields(tendons: Sequence[Tendon]) -> dict[str, dict[str, float]]:
    """Return for each motor how far, rad, its locked joint yields and each other motor turns for 1 N m in its coupling.

    With the routing R (motors by joints) the joints turn by R C R', where C is the compliance of their locks with the
    palm in series.
    """
    locks = {one.moves: one.lock for one in tendons}
    routing = np.array([[one.row.get(name, 0.0) for name in locks] for one in tendons])
    palm = max(1.0 / lock.palm for lock in locks.values())
    turns = routing @ (np.diag([1.0 / lock.stiffness for lock in locks.values()]) + palm) @ routing.T
    return {
        one.motor: {
            other.motor: float(turn) * (1.0 if other is one else other.gear_ratio)
            for other, turn in zip(tendons, row, strict=True)
            if turn
        }
        for one, row in zip(tendons, turns, strict=True)
    }
