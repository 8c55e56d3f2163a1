"""A recording played back as a servo: every exchange returns its next row, whatever is commanded.

For trying out limits, the live view and scripts on what a stand once did. Nothing turns, and what was recorded is not
an answer to what is commanded now.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from drivers.servo import (
    Clock,
    Command,
    Limits,
    LinkLost,
    NoReply,
    Sample,
    ServoInfo,
    Status,
    UnsafeCommand,
)

_LOST = Status.NO_REPLY | Status.BAD_REPLY


@dataclass(frozen=True, slots=True)
class ReplayConfig:
    """The [replay] table of stand.toml. recording: the recording that is played back."""

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid"}

    recording: str


class _Clock:
    """Time that passes only when somebody waits for it."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def sleep_until(self, t: float) -> None:
        self._now = max(self._now, t)


class ReplayServo:
    """The recording as a servo in virtual time. Raises WrongUse and Untrustworthy as opening a recording does."""

    def __init__(self, config: ReplayConfig) -> None:
        from hil.recording.reader import Recording

        self._recording = Recording(Path(config.recording))
        self._clock = _Clock()
        self._rows = self._samples()
        self._rest = next(self._rows, None)
        self._limits: Limits | None = None
        self._closed = False

    @property
    def info(self) -> ServoInfo:
        """Which recording it is; it takes every set-point and heeds none."""
        return ServoInfo(backend="replay", model=str(self._recording.path))

    @property
    def clock(self) -> Clock:
        """Virtual time."""
        return self._clock

    def arm(self, limits: Limits) -> None:
        """Begin to play: from now on every exchange is the next row. Raises LinkLost when closed."""
        self._open()
        self._limits = limits

    def exchange(self, command: Command) -> Sample:
        """The next row; while disarmed the first one, again and again.

        Raises UnsafeCommand, NoReply where the row's reply was lost, LinkLost where the recording ends.
        """
        self._open()
        if self._limits is None:
            if command != Command.rest():
                raise UnsafeCommand(f"{command.quantity} set-point {command.value} while disarmed: arm first")
            sample = self._rest
        else:
            self._limits.bound(command)
            sample, self._rest = self._rest, next(self._rows, None)
        if sample is None:
            raise LinkLost(f"{self._recording.path} ends here: ask for a shorter --duration")
        if sample.status & _LOST and self._limits is not None:
            raise NoReply("this reply was lost when it was recorded")
        return _at(sample, self._clock.now())

    def disarm(self) -> None:
        """Stop playing."""
        self._limits = None

    def close(self) -> None:
        """Let go of the file. Harmless when already closed."""
        if not self._closed:
            self._closed = True
            self._recording.__exit__()

    def _open(self) -> None:
        if self._closed:
            raise LinkLost("the recording is closed")

    def _samples(self) -> Iterator[Sample]:
        """The rows; joint_torque is NaN where the recording has none of its own."""
        for _, rows in self._recording.rows():
            for row in rows:
                yield Sample(
                    t=float(row["time"]),
                    t_read=float(row["read_time"]),
                    motor_position=float(row["motor_position"]),
                    motor_velocity=float(row["motor_velocity"]),
                    motor_torque=float(row["motor_torque"]),
                    joint_position=float(row["joint_position"]),
                    joint_torque=float(row["joint_torque"]),
                    temperature=float(row["temperature"]),
                    status=Status(int(row["status"])) & ~Status.LATE,
                    t_joint=float(row["joint_time"]),
                )


def _at(sample: Sample, now: float) -> Sample:
    """The sample with its times moved so that it was asked for `now`, s."""
    read = sample.t_read - sample.t
    age = sample.t_joint - sample.t
    return replace(sample, t=now, t_read=now + (read if math.isfinite(read) else 0.0), t_joint=now + age)
