"""Constants that several modules of `hil.signals` and `hil.uncertainty` share, each with its unit and source."""

from __future__ import annotations

import math
from typing import Final

NORMAL: Final = 1.959964
"""Half a 95 % interval of a normal distribution, in standard deviations."""

UPPER: Final = 0.975
"""The quantile at the upper end of a 95 % interval."""

SPREAD: Final = 1.4826
"""The standard deviation of normal noise over the median of its absolute value (Rousseeuw and Croux 1993)."""

CLIPPED: Final = 2.5
"""The distance from the median, in standard deviations, beyond which a residual counts no more (Huber 1964)."""

DEPENDENT: Final = 1e-12
"""The ratio to the largest eigenvalue of a Gram matrix below which columns are dependent: rounding of the sums."""

ACCURATE: Final = 5e-4
"""The relative accuracy of Kc, Bc, torque and rate below which nothing is corrected or reported: real sensors are not
better.
"""

GAIN_ERROR: Final = 3e-4
"""The relative error of rate and acceleration at the upper end of the band, and of the torque that follows from it."""

BLOCKS: Final = 32
"""The number of parts of a recording whose scatter gives the error of a sum over it."""

TURN: Final = math.tau
"""One turn, rad."""

SURE: Final = 4.0
"""The number of standard errors from which an effect is no chance, among the many that are looked for."""

NEARLY_ALL: Final = 0.98
"""The part of the samples that a rule must hold for, if single faults are expected."""

ENOUGH: Final = 65_536
"""The number of samples from which a property of a whole recording is estimated."""

ROUNDING: Final = 12.0**-0.5
"""The standard deviation of the error of rounding to counts, in counts."""

RELEVANT: Final = (5e-3, 0.03)
"""The relative changes of Kc and Bc from which a warning states them."""

FEWEST: Final = 16
"""The smallest number of samples, or of parts of a recording, from which anything is concluded."""

MOST: Final = 0.9
"""The quantile of a quantity that stands for its large values, without the few largest."""

MANY: Final = 0.05
"""The part of the samples from which a fault is one of the whole recording, and not of single samples."""

TESTED: Final = 20_000
"""The number of samples to which the costly tests of a fit are limited."""

PREDICTED: Final = 0.02
"""The part of the residuals' power below which what the motion predicts of them is of no size."""

FALSE_ALARMS: Final = 0.002
"""The probability that a test finds an effect or a difference that does not exist."""
