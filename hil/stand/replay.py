"""A recording played back as a servo: every exchange returns the recording's next row and ignores the command.

With a replay, limits, the live view and scripts can be tried out on recorded data. Nothing turns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from drivers.clock import Clock, VirtualClock
from drivers.gate import Gate
from drivers.servo import Command, Limits, LinkLost, NoReply, Quantity, Sample, ServoInfo, Status
from hil.errors import WrongUse

if TYPE_CHECKING:
    from hil.stand.file import Stand

_LOST = Status.NO_REPLY | Status.BAD_REPLY


@dataclass(frozen=True, slots=True)
class ReplayConfig:
    """The [replay] table of stand.toml. recording: the recording that is played back."""

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid"}

    recording: str


def replayed(path: Path) -> Stand:
    """Return the stand with which `path` was recorded, but with the recording played back in place of the servo.

    Raises WrongUse, also if the recording contains no stand file, and Untrustworthy for a damaged recording.
    """
    from hil.recording.reader import Recording
    from hil.stand.file import parse

    with Recording(path) as recording:
        recording.check_unchanged()
        text = recording.stand_toml
    if not text:
        raise WrongUse(
            f"{path} contains no stand file, so a replay of it has no limits: write a stand file with [limits] and "
            f"with recording = '{path}' in [replay], and give that file with --stand"
        )
    stand = parse(text, f"{path}: stand_toml")
    table = stand.stand.model_copy(update={"backend": "replay", "zero": 0.0})  # its positions have lost their zero
    return replace(stand, stand=table, devices={"replay": ReplayConfig(str(path))}, sensor=None)


class ReplayServo:
    """A servo that plays a recording back in virtual time. Raises WrongUse, and Untrustworthy for a damaged
    recording.
    """

    def __init__(self, config: ReplayConfig) -> None:
        from hil.recording.reader import Recording

        self._recording = Recording(Path(config.recording))
        try:
            self._recording.check_unchanged()
        except BaseException:
            self._recording.__exit__()
            raise
        self._clock = VirtualClock()
        self._rows = self._samples()
        self._next = next(self._rows, None)
        self._gate = Gate(
            "the recording", frozenset(Quantity), torque_off=lambda _request: None, release=self._recording.__exit__
        )

    @property
    def info(self) -> ServoInfo:
        """The description of this servo: the recording's path as model, and no watchdog time, because nothing can
        move.
        """
        return ServoInfo(backend="replay", model=str(self._recording.path), watchdog=math.inf)

    @property
    def clock(self) -> Clock:
        """The virtual clock of the playback."""
        return self._clock

    def arm(self, limits: Limits) -> None:
        """Begin to play: every exchange returns the next row from now on. Raises LinkLost if the servo is closed."""
        with self._gate.arming(limits):
            pass

    def exchange(self, command: Command) -> Sample:
        """Return the next row of the recording. While disarmed, return the present row again, with zero motor torque.

        Raises UnsafeCommand, NoReply if the row's reply was lost in the recording, LinkLost at the recording's end.
        """
        self._gate.admit(command)
        sample = self._next
        if self._gate.armed:
            self._next = next(self._rows, None)
        if sample is None:
            raise LinkLost(f"{self._recording.path} ends here: ask for a shorter --duration")
        if sample.status & _LOST and self._gate.armed:
            raise NoReply("this reply was lost when it was recorded")
        sample = _at(sample, self._clock.now())
        return sample if self._gate.armed else replace(sample, motor_torque=0.0)

    def disarm(self) -> None:
        """Stop playing."""
        self._gate.disarm()

    def close(self) -> None:
        """Close the recording. Harmless if it is closed already."""
        self._gate.close()

    def _samples(self) -> Iterator[Sample]:
        """Yield the rows as samples; joint_torque is NaN if the recording has no torque cell at the joint."""
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
    """Return the sample with all its times shifted, so that its request was sent at `now`, s."""
    read = sample.t_read - sample.t
    age = sample.t_joint - sample.t
    return replace(sample, t=now, t_read=now + (read if math.isfinite(read) else 0.0), t_joint=now + age)
