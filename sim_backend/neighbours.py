"""The other motors of a simulated hand, which are off: they turn with the locks, which yield to the driven motor."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.neighbours import Swing, check_still
from sim_backend.drive import Drive
from sim_backend.integrator import STATE
from sim_backend.plant import JOINT, MOTOR


class Neighbours:
    """The neighbours of `drive`. turns: by name, the turns of their motors for one turn of its locked joint. count: rad
    in one count of the motors' encoders.
    """

    def __init__(self, drive: Drive, turns: Mapping[str, float], count: float) -> None:
        self._drive, self._turns, self._count = drive, turns, count
        self._driven = Swing(0)
        self._swings = {name: Swing(0) for name in turns}

    def begin(self) -> None:
        """Note where every motor is. From now on `look` watches them."""
        self._driven.begin(self._counts(MOTOR, 1.0))
        for name, turns in self._turns.items():
            self._swings[name].begin(self._counts(JOINT, turns))

    def look(self) -> None:
        """Raise DriverError if a neighbour turns as no locked joint does."""
        driven = self._driven.note(self._counts(MOTOR, 1.0))
        for name, turns in self._turns.items():
            check_still("the motor", driven, f"that of {name}", self._swings[name].note(self._counts(JOINT, turns)))

    def turned(self) -> dict[str, float]:
        """See `drivers.neighbours.SeesNeighbours`."""
        return {name: swing.range * self._count for name, swing in self._swings.items()}

    def _counts(self, place: int, turns: float) -> int:
        return math.floor(turns * float(self._drive.path[STATE, place]) / self._count + 0.5)
