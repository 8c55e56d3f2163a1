"""Rows of a recording that identification does not use, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.errors import Untrustworthy
from hil.recording.reader import Recording

Array = NDArray[np.float64]

FEWEST: Final = 16
"""Samples, below which nothing is concluded."""

_FINEST = 1e-9  # s between two samples
_STILL_ANGLE, _STILL_TORQUE = 1e-12, 1e-15  # rad and N m peak to peak, below which a reading never changes


@dataclass(frozen=True, slots=True)
class Defects:
    """Rows of a recording that are not used, and whether many shared a time stamp and were spread.

    lost: replies that never came. not_numbers: rows with a NaN. near_gaps: rows whose window spans a gap; those at the
    two ends of the recording are not counted. frozen: rows in which the angle stood still while the torque changed.
    wraps: jumps of the angle by a turn, which were taken back.
    """

    lost: int = 0
    not_numbers: int = 0
    near_gaps: int = 0
    coarse_clock: bool = False
    frozen: int = 0
    wraps: int = 0

    def __add__(self, other: Defects) -> Defects:
        return Defects(
            self.lost + other.lost,
            self.not_numbers + other.not_numbers,
            self.near_gaps + other.near_gaps,
            self.coarse_clock or other.coarse_clock,
            self.frozen + other.frozen,
            self.wraps + other.wraps,
        )


def refuse_hopeless(recording: Recording, time: Array, torque: Array, dtheta: Array) -> None:
    """Raise Untrustworthy where usable rows (n,) of a recording, SI, are too few, unordered or without any change."""
    name = recording.path
    if len(time) < FEWEST:
        raise Untrustworthy(f"{name} holds {len(time)} usable sample(s) of {len(recording)}: record at least {FEWEST}")
    backwards = np.flatnonzero(np.diff(time) < 0.0)
    if backwards.size:
        raise Untrustworthy(f"{name}: time goes backwards after usable row {int(backwards[0])}: mend the stamps first")
    if np.ptp(time) == 0.0:
        raise Untrustworthy(f"{name}: every sample has the same time: mend the stamps first")
    if (step := float(np.ptp(time)) / len(time)) < _FINEST:
        raise Untrustworthy(f"{name}: the samples are {step:.2g} s apart, which no recorder does: check --time-unit")
    if np.ptp(torque) < _STILL_TORQUE:
        raise Untrustworthy(
            f"{name}: the torque never changes: no Kc or Bc can be estimated; check the torque sensor and its unit"
        )
    if np.ptp(dtheta) < _STILL_ANGLE:
        raise Untrustworthy(
            f"{name}: the deflection never changes: no Kc or Bc can be estimated; raise --amplitude or free the cable"
        )
