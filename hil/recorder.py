"""The control loop: drive the motor through a profile, tick by tick, and write every sample.

A tick is one `exchange`. A reply that is lost is a counted gap; everything else that goes wrong ends the run. However
it ends, the torque is off before anything else is done, and what was recorded becomes a file.
"""

from __future__ import annotations

import gc
import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from drivers.servo import BadReply, Command, DriverError, NoReply, Quantity, Sample, Servo, Status
from hil.guard import AtJoint, Guard, LimitReached, StopRequest
from hil.part import PartFile, Row
from hil.profiles import Profile
from hil.stand import Stand

_REST_SAMPLES = 16  # averaged for the zero of the deflection
_REST_TRIES = 100
_RAMP_DOWN = 0.1  # s; a first request to stop lets the cable down over this long
_BLOCK = 512  # set-points computed at a time


@dataclass(frozen=True, slots=True)
class Zero:
    """Where the axis rests before anything is commanded: motor and joint, rad; joint 0 where it has no sensor."""

    motor: float
    joint: float
    has_joint: bool


@dataclass(slots=True)
class Outcome:
    """How a run went.

    error: what ended it early, None where it ran to its end or was stopped on request. signal: the one that asked.
    """

    samples: int = 0
    lost: int = 0
    late: int = 0
    saturated: int = 0
    end_reason: str = "done"
    signal: int = 0
    error: Exception | None = None


def tick_count(profile: Profile, rate: float) -> int:
    """Rows that a run of `profile` at `rate` Hz has."""
    return round(profile.duration * rate) + 1


class Recorder:
    """One run on an open servo. Set-points are at the joint, in N m or rad; what is sent is at the motor shaft."""

    def __init__(self, stand: Stand, servo: Servo, profile: Profile, rate: float, part: PartFile) -> None:
        self._stand = stand.stand
        self._motor_limits = stand.motor_limits
        self._servo = servo
        self._profile = profile
        self._rate = rate
        self._part = part
        self._guard = Guard(stand.checked_limits())
        self._outcome = Outcome()
        self._start = 0.0

    def run(self, stop: StopRequest) -> Outcome:
        """Record until the profile's end, a request to stop or a fault. The servo is disarmed on return.

        Never raises for what a drive does: the outcome holds it, since what was recorded is still to be kept.
        """
        outcome = self._outcome
        try:
            zero = self._find_zero()
            with _quiet_collector():
                self._servo.arm(self._motor_limits(zero.motor))
                self._loop(zero, stop)
        except (DriverError, LimitReached, OSError) as error:
            outcome.error = error
            outcome.end_reason = f"{type(error).__name__}: {error}"
        finally:
            self._torque_off()
        if outcome.error is not None:
            self._part.event(self._since_start(), type(outcome.error).__name__, str(outcome.error))
        outcome.samples = len(self._part)
        return outcome

    def _find_zero(self) -> Zero:
        """Read the axis at rest, without driving it. Raises NoReply where it does not answer."""
        found: deque[Sample] = deque(maxlen=_REST_SAMPLES)
        clock = self._servo.clock
        begin = clock.now()
        for attempt in range(_REST_TRIES):
            clock.sleep_until(begin + attempt / self._rate)
            try:
                found.append(self._servo.exchange(Command.rest()))
            except (NoReply, BadReply):
                continue
            if len(found) == _REST_SAMPLES:
                break
        else:
            raise NoReply(f"{len(found)} replies to {_REST_TRIES} requests: check power, cable, id and baud rate")
        self._guard.check_start(found[-1])
        motor = float(np.mean([sample.motor_position for sample in found]))
        joint = float(np.mean([sample.joint_position for sample in found]))
        if not math.isfinite(motor):
            raise BadReply("the drive reports no position: a deflection cannot be recorded")
        source = self._stand.torque_source
        if math.isnan(found[-1].joint_torque if source == "joint" else found[-1].motor_torque):
            raise BadReply(f"the stand file says torque_source = {source!r}, but no torque is reported there")
        return Zero(motor, joint if math.isfinite(joint) else 0.0, math.isfinite(joint))

    def _loop(self, zero: Zero, stop: StopRequest) -> None:
        clock = self._servo.clock
        period = 1.0 / self._rate
        self._start = clock.now() + period
        stopping_at = math.inf
        for seq, set_point in enumerate(self._set_points()):
            due = seq * period
            clock.sleep_until(self._start + due)
            if stop.count and math.isinf(stopping_at):
                stopping_at = due
                self._outcome.end_reason = "stopped on request"
                self._outcome.signal = stop.number
                self._part.event(due, "stop-requested", f"signal {stop.number}")
            left = min(1.0, 1.0 - (due - stopping_at) / _RAMP_DOWN) if math.isfinite(stopping_at) else 1.0
            if left <= 0.0 or stop.count > 1:
                return
            self._tick(seq, due, set_point * left, zero)

    def _set_points(self) -> Iterator[float]:
        count = tick_count(self._profile, self._rate)
        for first in range(0, count, _BLOCK):
            times = np.arange(first, min(first + _BLOCK, count)) / self._rate
            yield from self._profile.at(times).tolist()

    def _tick(self, seq: int, due: float, set_point: float, zero: Zero) -> None:
        try:
            sample = self._servo.exchange(self._command(set_point, zero))
        except (NoReply, BadReply) as error:
            status = Status.BAD_REPLY if isinstance(error, BadReply) else Status.NO_REPLY
            sample = Sample.missing(self._start + due, status)
            self._outcome.lost += 1
            self._part.append(self._row(seq, due, set_point, sample, AtJoint()))
            self._guard.check_silence(self._servo.clock.now())
            return
        at_joint = self._at_joint(sample, zero)
        self._part.append(self._row(seq, due, set_point, sample, at_joint))
        self._guard.check(sample, at_joint)

    def _at_joint(self, sample: Sample, zero: Zero) -> AtJoint:
        ratio = self._stand.gear_ratio
        joint = sample.joint_position if zero.has_joint else 0.0
        return AtJoint(
            torque=sample.joint_torque if self._stand.torque_source == "joint" else sample.motor_torque * ratio,
            dtheta=(sample.motor_position - zero.motor) / ratio - (joint - zero.joint),
            dtheta_dot=sample.motor_velocity / ratio,
        )

    def _command(self, set_point: float, zero: Zero) -> Command:
        ratio = self._stand.gear_ratio
        if self._profile.quantity is Quantity.TORQUE:
            return Command(Quantity.TORQUE, set_point / ratio)
        return Command(Quantity.POSITION, zero.motor + set_point * ratio)

    def _row(self, seq: int, due: float, set_point: float, sample: Sample, at_joint: AtJoint) -> Row:
        sent = sample.t - self._start
        status = sample.status
        if sent - due > 0.5 / self._rate:
            status |= Status.LATE
            self._outcome.late += 1
        if status & Status.SATURATED:
            self._outcome.saturated += 1
        return (
            seq,
            sent,
            set_point,
            *at_joint,
            sample.motor_position,
            sample.motor_velocity,
            sample.motor_torque,
            sample.joint_position,
            sample.joint_torque,
            sample.t_read - self._start,
            sample.temperature,
            int(status),
        )

    def _torque_off(self) -> None:
        try:
            self._servo.disarm()
        except DriverError as error:
            self._outcome.error = self._outcome.error or error
            self._outcome.end_reason = f"torque-off not confirmed ({error}): CUT THE POWER"

    def _since_start(self) -> float:
        return self._servo.clock.now() - self._start


@contextmanager
def _quiet_collector() -> Iterator[None]:
    """No garbage collection inside the loop: a full one can stop it for 100 ms."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
