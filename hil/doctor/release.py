"""Whether a drive released its torque: its readings at rest, under a load, and after the load should be gone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean, pstdev
from typing import NamedTuple

from drivers.servo import Sample

_GONE = 0.5  # share of the load that may be left
_NOISE = 4.0  # standard deviations by which a load must differ from rest
_READINGS = (
    ("motor_torque", "of the motor's torque"),
    ("joint_torque", "of the torque at the joint"),
    ("motor_position", "of the deflection"),
)


class Left(NamedTuple):
    """The remaining fraction of the load, also in words; releases: None if it cannot be decided.

    measured: whether the motor's own torque decided, which friction cannot hold.
    """

    releases: bool | None
    share: float
    words: str
    measured: bool = False


class Load:
    """The readings of a drive at rest and under a load.

    rest and loaded: samples of each, at the motor shaft. measures: whether it measures the motor's torque while it is
    off.
    """

    def __init__(self, rest: Sequence[Sample], loaded: Sequence[Sample], *, measures: bool = True) -> None:
        self._levels: dict[str, tuple[float, float]] = {}
        for name, _ in _READINGS if measures else _READINGS[1:]:
            before, under = _finite(rest, name), _finite(loaded, name)
            if before and under:
                change = fmean(under) - fmean(before)
                if abs(change) > _NOISE * (pstdev(before) + pstdev(under)):
                    self._levels[name] = (fmean(before), change)

    def left(self, after: Sequence[Sample]) -> Left:
        """Return what remains of the load in the samples `after`.

        The first of these readings that the load changed by more than its noise decides: the motor's torque, the
        joint's torque, the deflection, which friction may hold.
        """
        shares = {name: share for name, _ in _READINGS if math.isfinite(share := self._share(name, after))}
        if not shares:
            return Left(None, math.nan, "no reading that the load changed by more than its noise")
        words = dict(_READINGS)
        decides = next(iter(shares))
        share = shares[decides]
        said = f"{abs(share) * 100:.0f} % {words[decides]}"
        return Left(share <= _GONE, share, said, decides == "motor_torque")

    def _share(self, name: str, after: Sequence[Sample]) -> float:
        values = _finite(after, name)
        if name not in self._levels or not values:
            return math.nan
        rest, change = self._levels[name]
        return (fmean(values) - rest) / change


def _finite(samples: Sequence[Sample], name: str) -> list[float]:
    return [value for sample in samples if math.isfinite(value := getattr(sample, name))]
