"""Decides whether a drive released its torque, from its readings at rest, under a load, and after the torque-off."""

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
    """The remaining load of a drive after the torque-off.

    releases: whether the drive released its torque, None if that cannot be decided. share: the remaining fraction of
    the load. words: the remaining load in words. measured: whether the motor's torque was used for the decision; unlike
    the deflection it is not held by friction.
    """

    releases: bool | None
    share: float
    words: str
    measured: bool = False


class Load:
    """The load of a drive, from its readings at rest and under the load.

    rest, loaded: samples at the motor shaft. measures: whether the drive measures the motor's torque while the torque
    is off.
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
        """Return the remaining load in the samples `after`.

        One reading decides: the motor's torque, the joint's torque or the deflection, in this order, whichever first
        changed by more than its noise under the load. The deflection may be held by friction.
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
