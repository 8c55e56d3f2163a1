"""The scale of a torque cell from known loads: a line with Student's interval, and a check for impossible loads.

The readings are fitted as a line over the torques, because the readings have the larger error; the scale is the inverse
of the slope. With n loads the slope's 95 % interval is t(0.975, n - 2) standard errors (Student's t). The error of
lever arm and gravity, which is the same for all loads, is added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hil.errors import Untrustworthy, WrongUse

Array = NDArray[np.float64]

GRAVITY = 9.80665
"""Standard gravity, m/s^2."""
GRAVITY_UNCERTAINTY = 0.0015
"""Relative standard uncertainty of gravity at an unknown place on Earth: 9.780 m/s^2 at the equator to 9.832 at the
poles.
"""
_NORMAL = 1.96
_GRAMS = 30.0  # factor between two loads for one reading, from which another unit is the likely reason
_BEYOND = 20.0  # of the torque limit, that no calibration needs
_BENT = 0.05  # of the span, root mean square


@dataclass(frozen=True, slots=True)
class Point:
    """A known load and the cell's reading of it.

    torque: N m, with the sign of the joint's torque. value: the cell's reading without the tare. name: for messages.
    """

    torque: float
    value: float
    name: str


@dataclass(frozen=True, slots=True)
class Scale:
    """The calibrated scale of a torque cell.

    scale: N m for a reading of 1. uncertainty: relative standard uncertainty; the 95 % interval is +- 1.96 times this.
    offset: the reading at zero torque. hysteresis: largest difference, N m, between the same load approached from below
    and from above; NaN if no load was approached from both. residual: root mean square of the fit's residuals, N m.
    points: number of loads. one_sided: whether all loads pulled in the same direction.
    """

    scale: float
    uncertainty: float
    offset: float
    hysteresis: float
    residual: float
    points: int
    one_sided: bool

    @property
    def ci95(self) -> tuple[float, float]:
        """The 95 % interval of the scale."""
        half = _NORMAL * self.uncertainty * self.scale
        return self.scale - half, self.scale + half


def fit(points: Sequence[Point], load_uncertainty: float = 0.0) -> Scale:
    """Return the scale from three or more loads, in the order in which they were read.

    load_uncertainty: relative standard uncertainty that all torques have in common. Raises WrongUse for too few
    different loads, Untrustworthy if the readings do not lie on a rising line.
    """
    torque, value = np.array([[point.torque, point.value] for point in points]).reshape(-1, 2).T
    if len(points) < 3 or len(np.unique(torque)) < 2:
        raise WrongUse(
            f"{len(points)} points of {len(np.unique(torque))} different loads give no scale with an uncertainty: take "
            "three points or more, better five on each side, while loading and while unloading"
        )
    slope, offset = np.polyfit(torque, value, 1)
    residuals = value - offset - slope * torque
    rms = float(np.sqrt(np.mean(residuals**2)))
    _check_slope(float(slope), rms > abs(float(slope)) * float(np.ptp(torque)) / 4.0)
    if rms > _BENT * float(np.ptp(slope * torque)):
        worst = points[int(np.argmax(np.abs(residuals)))]
        raise Untrustworthy(
            f"the points are not on a line: they are off by {rms / slope:.3g} N m (root mean square), {worst.name} "
            "most; Kc would be wrong by as much: repeat them with the lever level and the weight still"
        )
    freedom = len(points) - 2
    spread = math.sqrt(float(residuals @ residuals) / freedom / float(np.sum((torque - torque.mean()) ** 2)))
    own = float(student.ppf(0.975, freedom)) * spread / float(slope) / _NORMAL
    return Scale(
        scale=1.0 / float(slope),
        uncertainty=math.hypot(own, load_uncertainty),
        offset=float(offset),
        hysteresis=_hysteresis(torque, value) / float(slope),
        residual=rms / float(slope),
        points=len(points),
        one_sided=bool((torque >= 0.0).all() or (torque <= 0.0).all()),
    )


def _check_slope(slope: float, unrelated: bool) -> None:
    if slope == 0.0 or unrelated:
        raise Untrustworthy(
            "the reading does not follow the load, so it gives no scale for Kc and Bc: check the cell's plugs, and "
            "that the load passes through the cell"
        )
    if slope < 0.0:
        raise Untrustworthy(
            "the reading falls where the torque rises: the cell is wired the wrong way round, which would turn the "
            "sign of Kc and Bc. Set sign with the other value in [joint_sensor], or exchange the cell's two signal "
            "wires; where the weights hung on the other side of the lever, write them with a minus"
        )


def _hysteresis(torque: Array, value: Array) -> float:
    """Return the largest difference between a load's readings during loading and unloading; NaN if no load was read in
    both.
    """
    came = np.sign(np.diff(torque, prepend=0.0))
    found = []
    for load in np.unique(torque):
        up, down = value[(torque == load) & (came > 0.0)], value[(torque == load) & (came < 0.0)]
        if len(up) and len(down):
            found.append(abs(float(up.mean() - down.mean())))
    return max(found, default=math.nan)


def implausible(points: Sequence[Point], limit: float | None) -> str:
    """Return a sentence why the loads are impossible, with the most likely cause; "" if they are possible.

    limit: the stand's torque limit, N m.
    """
    largest = max(points, key=lambda point: abs(point.torque))
    if limit is not None and abs(largest.torque) > _BEYOND * limit:
        return (
            f"{largest.name} is {abs(largest.torque):.3g} N m, {abs(largest.torque) / limit:.0f} times limits.torque = "
            f"{limit:g} N m: was a mass typed in grams, or the arm in mm? A bare mass is in kg and an arm in m (or "
            "write 200g, 50mm)"
        )
    loaded = [point for point in points if point.torque and point.value]
    if len(loaded) < 2:
        return ""
    usual = median(abs(point.torque / point.value) for point in loaded)
    for point in loaded:
        factor = abs(point.torque / point.value) / usual
        if not 1.0 / _GRAMS < factor < _GRAMS:
            size = f"{factor:.3g} times smaller" if factor > 1.0 else f"{1.0 / factor:.3g} times larger"
            return (
                f"{point.name} gives the reading of a load {size}, by the other points: was it, or were they, typed in "
                "grams? A bare mass is in kg (or write 200g)"
            )
    return ""
