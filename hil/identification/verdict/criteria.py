"""The criteria for trusting a result: the same limits for a planned recording and for an identified one."""

from __future__ import annotations

import numpy as np

from ga.arrays import Array
from hil.signals import constants as c


def distinguishable(half: float, inflation: float) -> bool:
    """Return whether a parameter can be distinguished from others.

    half: half its 95 % interval. inflation: its variance inflation.
    """
    return bool(np.isfinite(half) and inflation < c.INFLATION)


def narrow(half: float, value: float) -> bool:
    """Return whether the interval of Kc or Bc is narrow enough. half: half the 95 % interval; value: the parameter, in
    the same unit.
    """
    return bool(half < c.INTERVAL * abs(value))


def friction_likeness(rate: Array) -> float:
    """Return the square of the cosine between a rate (n,) and its sign, 0 to 1; 0 without motion.

    This is the fraction of a damping torque that dry friction would explain.
    """
    power = float(np.mean(rate**2))
    return float(np.mean(np.abs(rate))) ** 2 / power if power else 0.0


def dampings_behind_filter(stiffness: float, damping: float, inertia: float) -> list[float]:
    """Return the values of Bc, SI, rising, for which a filter of the angle explains the fitted inertia; [] if there is
    none.

    stiffness, damping, inertia: the fitted values, SI. Behind a first-order filter of the angle with the time constant
    T, s, the torque is (Kc + Bc s)(1 + T s) times the angle that was read: the fitted damping is then Bc + Kc T, and
    the fitted inertia Bc T.
    """
    apart = damping**2 - 4.0 * stiffness * inertia
    if not (inertia > 0.0 and apart >= 0.0 and damping > 0.0):
        return []
    return [0.5 * (damping - apart**0.5), 0.5 * (damping + apart**0.5)]
