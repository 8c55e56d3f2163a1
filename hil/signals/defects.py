"""Rows of a recording that identification does not use, and why."""

from __future__ import annotations

from dataclasses import dataclass


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
