"""Write a log of the torque of emulated drives: a CSV file of commanded and acting torque, which is complete even if
the process is killed.

In a safety test the rows show when the torque of a drive ended, whichever process was killed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from sim_backend.wire.life import Life

COLUMNS = ("time_s", "drive", "commanded_Nm", "acting_Nm", "enabled", "watchdog")
_STEP = 1e-3  # s between two rows in which only the acting torque differs


class TorqueLog:
    """A new CSV file at `path` with one line for each change, and the columns `COLUMNS`. Every line is passed to the
    operating system as soon as it is complete.

    time_s: `time.monotonic()` of this computer, which is the same in other processes. commanded_Nm: the torque demanded
    of the current loop, 0 while disabled. acting_Nm: the torque that the current makes. Both torques are at the motor's
    output shaft. Raises FileExistsError if the file exists, OSError if it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
        self._file = os.open(path, flags, 0o644)
        self._line(COLUMNS)

    def watch_all(self, lives: Iterable[Life]) -> None:
        """Write a row at each change of the torque or watchdog of the drives with `lives`, numbered from 0."""
        for number, life in enumerate(lives):
            life.motor.observer = _Changes(life, str(number), self._line).observe
            life.motor.observer()

    def close(self) -> None:
        """Close the file; changes are no longer logged."""
        os.close(self._file)

    def _line(self, fields: tuple[str, ...]) -> None:
        os.write(self._file, (",".join(fields) + "\n").encode("ascii"))


class _Changes:
    """Writes the rows of one drive."""

    def __init__(self, life: Life, name: str, line: Callable[[tuple[str, ...]], None]) -> None:
        self._life, self._name, self._line = life, name, line
        self._written: tuple[str, ...] = ()
        self._acting = ""
        self._at = -_STEP

    def observe(self) -> None:
        motor = self._life.motor
        state = (f"{motor.commanded:.6g}", str(int(motor.enabled)), self._life.watchdog_state)
        acting = f"{motor.torque:.6g}"
        moved = acting != self._acting and motor.time >= self._at + _STEP
        if state == self._written and not moved:
            return
        self._written, self._acting, self._at = state, acting, motor.time
        commanded, enabled, watchdog = state
        self._line((f"{self._life.now:.6f}", self._name, commanded, acting, enabled, watchdog))
