"""The criteria for trusting a result: the same limits for a planned recording and for an identified one."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

INFLATION: Final = 300.0
"""The variance inflation from which a parameter cannot be distinguished from others.

At this limit only 1/300 of the power of its column is independent of the others. A distortion of the columns by 6 %
(1/sqrt(300)), as noise of the rate and its window cause, changes the parameter by as much as its value.
"""

INTERVAL: Final = 0.35
"""The ratio of half the 95 % interval to the value from which Kc or Bc is not identifiable.

At this limit 1.96 standard errors are a third of the value, and two recordings of one joint differ by a half.
"""

UNCERTAIN: Final = 0.1
"""The ratio of half the 95 % interval to the value from which a warning says why the interval is so wide."""

LIKE_FRICTION: Final = 0.95
"""The `friction_likeness` from which Bc cannot be distinguished from dry friction that the model lacks."""

ONE_SPEED: Final = 0.79
"""The `friction_likeness` from which most of an omitted friction would be added to Bc.

A triangle has 1; a sine 0.81, less with soft start and stop; a chirp over two octaves 0.72; two sines 0.66.
"""

OPTIMISER_GAP: Final = 1e-3
"""The optimiser gap from which the search has not converged: a tenth of the usual relative interval of Kc."""

UNEXPLAINED: Final = 0.9
"""The fraction of the torque's spread that remains in held-out blocks, from which a model explains nothing."""

EVIDENCE_AGAINST: Final = -6.0
"""The gain below which the evidence against a term is strong (Kass and Raftery 1995)."""

TICK_SHARE: Final = 0.1
"""The difference in age between one recorder's readings of torque and angle: its standard deviation, in ticks."""

LONGEST_SKEW: Final = 1.5
"""The skew, in ticks, above which one recorder is unlikely to be its cause."""

CELLS: Final = (15.0, 480.0)
"""The range of bandwidths of torque cells, Hz. A slower cell is visible in the data; a faster one delays by a small
part of a tick.
"""

BETWEEN: Final = 3.0
"""The ratio of the standard deviation between recordings to that within, from which the recordings really differ."""

DIFFERENT: Final = 3.0
"""The ratio between two values of Kc in one recording above which a single Kc cannot describe both."""

MUCH_FRICTION: Final = 0.5
"""The ratio of friction to torque from which Kc depends on how friction is modelled."""

LITTLE_FRICTION: Final = 0.2
"""The ratio of friction to torque that is harmless: in real ramps with 0.2 to 0.3, Kc repeated within 4 % (median)."""

PLAY: Final = 0.75
"""The ratio of play to the range of the deflection from which too little of the motion loads the spring."""

COUPLING: Final = ("Kc", "Bc")
"""The names of the parameters that a usable result must contain."""


def distinguishable(half: float, inflation: float) -> bool:
    """Return whether a parameter can be distinguished from others.

    half: half its 95 % interval. inflation: its variance inflation.
    """
    return bool(np.isfinite(half) and inflation < INFLATION)


def narrow(half: float, value: float) -> bool:
    """Return whether the interval of Kc or Bc is narrow enough. half: half the 95 % interval; value: the parameter, in
    the same unit.
    """
    return bool(half < INTERVAL * abs(value))


def friction_likeness(rate: NDArray[np.float64]) -> float:
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
