"""The torque log of emulated drives: a CSV file of what each commands and makes, which survives a kill.

Its rows are the evidence of a safety test: when the torque of a drive ended, whoever died and however.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Literal, Protocol

if TYPE_CHECKING:
    from pathlib import Path

    from sim_backend.wire.plant_motor import PlantMotor

WatchdogState = Literal["none", "off", "on", "tripped"]
"""The state of a drive's watchdog. none: the drive has none. off: it does not watch now."""
COLUMNS = ("time_s", "drive", "commanded_Nm", "acting_Nm", "enabled", "watchdog")
_STEP = 1e-3  # s between two rows in which only the acting torque differs


class Watched(Protocol):
    """A drive with a motor, and with a watchdog or without one."""

    @property
    def motor(self) -> PlantMotor[Any]:
        """The motor."""

    @property
    def watchdog_state(self) -> WatchdogState:
        """The state of its watchdog."""


class TorqueLog:
    """A new CSV file at `path`, a line a change: see `COLUMNS`. Every line is with the operating system when it ends.

    time_s is `time.monotonic()` of this machine, which other processes share. commanded_Nm: the torque demanded of the
    current loop, 0 while disabled; acting_Nm: the torque that the current makes; both at the motor's output shaft.
    Raises FileExistsError if there is a file, OSError if none can be made.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
        self._file = os.open(path, flags, 0o644)
        self._line(COLUMNS)

    def watch_all(self, drives: Iterable[Watched], powered: float) -> None:
        """Write a row at each change of `drives`, which were powered at `powered` s and are counted from 0."""
        for number, drive in enumerate(drives):
            drive.motor.observer = _Changes(drive, str(number), powered, self._line).observe
            drive.motor.observer()

    def close(self) -> None:
        """Close the file; nothing is watched any more."""
        os.close(self._file)

    def _line(self, fields: tuple[str, ...]) -> None:
        os.write(self._file, (",".join(fields) + "\n").encode("ascii"))


class _Changes:
    """The rows of one drive."""

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
