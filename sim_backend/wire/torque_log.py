"""Write a log of the torque of emulated drives: a CSV file of commanded and acting torque, which is complete even if
the process is killed.

In a safety test the rows show when the torque of a drive ended, whichever process was killed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Literal, Protocol

if TYPE_CHECKING:
    from pathlib import Path

    from sim_backend.wire.plant_motor import PlantMotor

WatchdogState = Literal["none", "off", "on", "tripped"]
"""The state of a drive's watchdog. none: the drive has no watchdog. off: the watchdog is not active now. on: it is
active. tripped: it has stopped the drive.
"""
COLUMNS = ("time_s", "drive", "commanded_Nm", "acting_Nm", "enabled", "watchdog")
_STEP = 1e-3  # s between two rows in which only the acting torque differs


class Watched(Protocol):
    """An emulated drive whose motor and watchdog can be logged."""

    @property
    def motor(self) -> PlantMotor[Any]:
        """The motor whose torque is logged."""

    @property
    def watchdog_state(self) -> WatchdogState:
        """The state of the drive's watchdog."""


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

    def watch_all(self, drives: Iterable[Watched], powered: float) -> None:
        """Write a row at each change of the torque or watchdog of `drives`. The drives were powered at `powered`, s,
        and are numbered from 0.
        """
        for number, drive in enumerate(drives):
            drive.motor.observer = _Changes(drive, str(number), powered, self._line).observe
            drive.motor.observer()

    def close(self) -> None:
        """Close the file; changes are no longer logged."""
        os.close(self._file)

    def _line(self, fields: tuple[str, ...]) -> None:
        os.write(self._file, (",".join(fields) + "\n").encode("ascii"))


class _Changes:
    """Writes the rows of one drive."""

    def __init__(self, drive: Watched, name: str, powered: float, line: Callable[[tuple[str, ...]], None]) -> None:
        self._drive, self._name, self._powered, self._line = drive, name, powered, line
        self._written: tuple[str, ...] = ()
        self._acting = ""
        self._at = -_STEP

    def observe(self) -> None:
        motor = self._drive.motor
        state = (f"{motor.commanded:.6g}", str(int(motor.enabled)), self._drive.watchdog_state)
        acting = f"{motor.torque:.6g}"
        moved = acting != self._acting and motor.time >= self._at + _STEP
        if state == self._written and not moved:
            return
        self._written, self._acting, self._at = state, acting, motor.time
        commanded, enabled, watchdog = state
        self._line((f"{self._powered + motor.time:.6f}", self._name, commanded, acting, enabled, watchdog))
