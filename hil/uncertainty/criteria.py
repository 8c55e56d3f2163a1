"""The criteria of trust: the same numbers for a recording that is planned and for one that is identified."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

INFLATION: Final = 300.0
"""Variance inflation from which a parameter cannot be distinguished from others.

A part of 1/300 of its column is its own: what distorts the columns by 6 % (1/sqrt(300)), as the rate's noise and window
do, moves the parameter by as much as its value.
"""

INTERVAL: Final = 0.35
"""Half the 95 % interval over the value, from which Kc or Bc is not identifiable: 1.96 standard errors are then a third
of the value, and two recordings of one joint differ by a half.
"""

UNCERTAIN: Final = 0.1
"""The same, from which a warning says what makes the interval so wide."""

LIKE_FRICTION: Final = 0.95
"""`friction_likeness` from which Bc cannot be distinguished from dry friction that the model omits."""

ONE_SPEED: Final = 0.79
"""`friction_likeness` from which Bc would hold most of it.

A triangle has 1, a sine 0.81, less with soft start and stop; a chirp over two octaves 0.72, two sines 0.66.
"""

OPTIMISER_GAP: Final = 1e-3
"""Optimiser gap from which the search has not converged: a tenth of the usual relative interval of Kc."""

UNEXPLAINED: Final = 0.9
"""Part of the torque's spread left in held-out blocks from which a model explains nothing."""

EVIDENCE_AGAINST: Final = -6.0
"""Gain below which the evidence against a term is strong (Kass and Raftery 1995)."""

TICK_SHARE: Final = 0.1
"""Part of a tick by which one recorder's readings of torque and angle differ in age, one standard deviation."""

LONGEST_SKEW: Final = 1.5
"""Ticks between two readings of one recorder, from which a skew is more likely something else."""

CELLS: Final = (15.0, 480.0)
"""The bandwidths of torque cells, Hz: a slower one shows, and a faster one is late by a small part of a tick."""

BETWEEN: Final = 3.0
"""Standard deviation between recordings over that within, from which the recordings differ and not their noise."""

DIFFERENT: Final = 3.0
"""Ratio of two values of Kc in one recording, from which no single Kc stands for both."""

FRICTION: Final = 0.5
"""Part of the torque that friction takes, from which Kc follows from how friction is modelled."""

LITTLE_FRICTION: Final = 0.2
"""Part of the torque that friction may take: in real ramps with 0.2 to 0.3, Kc repeated within 4 % (median)."""

PLAY: Final = 0.75
"""Part of the range of the deflection that is play, from which the flanks are short."""

COUPLING: Final = ("Kc", "Bc")
"""The parameters without which a result is not usable."""


def distinguishable(half: float, inflation: float) -> bool:
    """Return whether a parameter of this half-interval and variance inflation is distinguishable from others."""
    return bool(np.isfinite(half) and inflation < INFLATION)


def narrow(half: float, value: float) -> bool:
    """Return whether half a 95 % interval is narrow enough for a value of Kc or Bc; both in its unit."""
    return bool(half < INTERVAL * abs(value))


def friction_likeness(rate: NDArray[np.float64]) -> float:
    """Return the square of the cosine between a rate (n,) and its sign, 0 to 1, 0 for no motion.

    It is the part of a damping torque that dry friction would explain.
    """
    power = float(np.mean(rate**2))
    return float(np.mean(np.abs(rate))) ** 2 / power if power else 0.0


def dampings_behind_filter(stiffness: float, damping: float, inertia: float) -> list[float]:
    """Return what Bc is, SI, rising, if a filter of the angle explains an inertia that was fitted; [] if none does.

    Behind a first-order filter of the angle with the time constant T, s, the torque is (Kc + Bc s)(1 + T s) times the
    angle that is read: there is Bc + Kc T in the place of a damping, and Bc T in that of an inertia.
    """
    apart = damping**2 - 4.0 * stiffness * inertia
    if not (inertia > 0.0 and apart >= 0.0 and damping > 0.0):
        return []
    return [0.5 * (damping - apart**0.5), 0.5 * (damping + apart**0.5)]
