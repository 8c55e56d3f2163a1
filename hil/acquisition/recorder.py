"""The control loop: drive the motor through a profile, tick by tick, and write every sample.

A tick is one `exchange`. A lost reply is a counted gap; every other fault ends the run. However it ends, the torque is
turned off before anything else, and the rows so far are kept.
"""

from __future__ import annotations

import gc
import math
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean, median

import numpy as np

from drivers.gate import confirm_torque_off
from drivers.servo import BadReply, Command, NoReply, Quantity, Sample, Servo, Status
from hil.acquisition.excitation import Profile
from hil.acquisition.guard import Guard
from hil.acquisition.heat import heat_budget
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.limits import AtJoint, LimitReached
from hil.acquisition.phases import Phase, Phases
from hil.acquisition.real_time import real_time
from hil.acquisition.setpoints import SetPoints
from hil.acquisition.sink import Sink
from hil.errors import WrongUse
from hil.recording.channels import Row
from hil.stand.file import Stand
from hil.stand.opening import require_watchdog
from hil.stand.transmission import Transmission, Zero

_REST_SAMPLES = 16  # averaged for the zero of the deflection
_REST_TRIES = 100
_TOO_LONG = 1.5  # periods that an answer at rest may take; some drives answer sooner once they are armed
_RAMP_DOWN = 0.1  # s; a first request to stop ramps the torque to zero over this long
_BLOCK = 512  # set-points computed at a time
_LATE, _SATURATED = int(Status.LATE), int(Status.SATURATED)
_MISSED = Status.MISSED | Status.LATE | Status.NO_REPLY


class _Stopped(Exception):
    """A request to stop came before anything was driven."""


@dataclass(slots=True)
class Outcome:
    """How a run went.

    late: ticks that began more than half a period after their time. missed: those of them that were skipped, since the
    next one was due already. error: the fault that ended it, None where it ran to its end or was stopped on request.
    signal: of that request. alarm: a sentence to show first, where the torque may still be on; "" otherwise. moved:
    one that says where the recording is, where its file was removed during the run. phases: of the run.
    """

    samples: int = 0
    lost: int = 0
    late: int = 0
    missed: int = 0
    saturated: int = 0
    end_reason: str = "done"
    signal: int = 0
    error: BaseException | None = None
    alarm: str = ""
    moved: str = ""
    phases: Phases = field(default_factory=Phases)


def tick_count(profile: Profile, rate: float) -> int:
    """Rows that a run of `profile` at `rate` Hz has."""
    return round(profile.duration * rate) + 1


class Recorder:
    """One run of a profile on an open servo, at `rate` Hz, into a sink.

    scratch: the folder for the run's set-points, which a long run keeps on disk; None for the system's. Raises WrongUse
    for a stand without limits, or whose drive does not stop by itself and is not accepted as it is.
    """

    def __init__(
        self, stand: Stand, servo: Servo, profile: Profile, rate: float, sink: Sink, *, scratch: Path | None = None
    ) -> None:
        limits = stand.checked_limits()
        require_watchdog(stand, servo.info)
        self._torque_source = stand.stand.torque_source
        self._transmission = Transmission.of(stand.stand)
        self._limits = limits
        self._has_joint = False
        self._servo = servo
        self._profile = profile
        self._rate = rate
        self._sink = sink
        self._scratch = Path(tempfile.gettempdir()) if scratch is None else scratch
        # a profile of torque swings by twice its amplitude; for a profile of position only the limit is known
        by_torque = profile.mode is Quantity.TORQUE
        self._heat = heat_budget(stand, servo.info, profile)
        self._guard = Guard(
            limits,
            moves=profile.amplitude if by_torque else 0.5 * limits.torque,
            more=() if self._heat is None else (self._heat,),
        )
        self._outcome = Outcome()
        self._start = math.nan
        self._off_asked = False
        self._off_error: BaseException | None = None

    def run(self, stop: StopRequest) -> Outcome:
        """Record until the profile's end, a request to stop or a fault. The servo is disarmed on return.

        Never raises, since the rows must still be kept: the outcome has the error.
        """
        outcome = self._outcome
        try:
            self._record(stop)
        except _Stopped:
            self._stopped(stop)
        except BaseException as error:  # noqa: BLE001 - in any case the torque goes off and the data is kept
            outcome.error = error
            outcome.end_reason = f"{type(error).__name__}: {error}"
        finally:
            if not self._off_asked:  # nothing was driven, or the torque-off itself was interrupted
                self._torque_off()
        if self._heat is not None:
            with suppress(WrongUse):  # what it kept at the start is no cooler
                self._heat.keep()
        outcome.samples = len(self._sink)
        self._note_end()
        return outcome

    def _record(self, stop: StopRequest) -> None:
        with SetPoints(self._scratch) as set_points:
            for times in self._times():
                _check_stop(stop)
                set_points.extend(self._profile.at(times))
            zero = self._find_zero(stop)
            limits = self._transmission.motor_limits(self._limits, zero.motor)
            with _quiet_collector(), real_time(self._servo.clock):
                _check_stop(stop)
                try:
                    self._enter(Phase.ARMING)
                    self._servo.arm(limits)
                    self._loop(set_points, zero, stop)
                finally:  # before anything else, which might take its time
                    self._torque_off()

    def _times(self) -> Iterator[np.ndarray[tuple[int], np.dtype[np.float64]]]:
        count = tick_count(self._profile, self._rate)
        for first in range(0, count, _BLOCK):
            yield np.arange(first, min(first + _BLOCK, count)) / self._rate

    def _find_zero(self, stop: StopRequest) -> Zero:
        """Read the axis at rest, without driving it.

        Raises NoReply where it does not answer, BadReply where a necessary reading is missing, WrongUse where a tick is
        too short for it, LimitReached where it is too warm.
        """
        samples = self._at_rest(stop)
        motor = _mean(sample.motor_position for sample in samples)
        joint = _mean(sample.joint_position for sample in samples)
        if not math.isfinite(motor):
            raise BadReply("the drive reports no position: a deflection cannot be recorded")
        self._has_joint = math.isfinite(joint)
        zero = Zero(motor, joint if self._has_joint else 0.0)
        at_rest = [self._at_joint(sample, zero) for sample in samples]
        if not any(math.isfinite(one.torque) for one in at_rest):
            raise BadReply(
                f"the stand file says torque_source = {self._torque_source!r}, but no torque is reported there"
            )
        self._guard.check_start(samples, at_rest)
        return zero

    def _at_rest(self, stop: StopRequest) -> list[Sample]:
        samples: list[Sample] = []
        took: list[float] = []
        clock = self._servo.clock
        begin = clock.now()
        for attempt in range(_REST_TRIES):
            clock.sleep_until(begin + attempt / self._rate)
            _check_stop(stop)
            before = clock.now()
            try:
                samples.append(self._servo.exchange(Command.rest()))
            except (NoReply, BadReply):
                continue
            took.append(clock.now() - before)
            if len(samples) == _REST_SAMPLES:
                break
        else:
            raise NoReply(f"{len(samples)} replies to {_REST_TRIES} requests: check power, cable, id and baud rate")
        if median(took) > _TOO_LONG / self._rate:
            raise WrongUse(
                f"--rate {self._rate:g}: this servo takes {median(took) * 1e3:.3g} ms to answer, so it reaches at "
                f"most {1.0 / median(took):.0f} Hz: lower the rate"
            )
        return samples

    def _loop(self, set_points: Iterable[float], zero: Zero, stop: StopRequest) -> None:
        clock = self._servo.clock
        period = 1.0 / self._rate
        self._start = clock.now() + period
        self._enter(Phase.FADE_IN)
        fading = True
        stopping_at = math.inf
        sent, sent_at = 0.0, self._start - period
        for seq, set_point in enumerate(set_points):
            due = seq * period
            clock.sleep_until(self._start + due)
            now = clock.now()
            too_late = self._guard.check_late(now - sent_at - period)
            if (stop.count or too_late) and math.isinf(stopping_at):
                stopping_at = due
                self._enter(Phase.RAMP_DOWN)
                self._ramp_down(stop, due, too_late)
            elif fading and due >= self._profile.fade and math.isinf(stopping_at):
                fading = False
                self._enter(Phase.RUN)
            left = min(1.0, 1.0 - (due - stopping_at) / _RAMP_DOWN) if math.isfinite(stopping_at) else 1.0
            if left <= 0.0 or stop.count > 1:
                return
            if now - self._start - due >= period:
                self._miss(seq, due, sent)
                continue
            sent, sent_at = set_point * left, now
            self._tick(seq, due, sent, zero)

    def _ramp_down(self, stop: StopRequest, due: float, too_late: str) -> None:
        if stop.count:
            self._stopped(stop)
            self._sink.event(due, "stop-requested", f"signal {stop.number}")
        else:
            self._outcome.error = LimitReached(too_late)
            self._outcome.end_reason = f"LimitReached: {too_late}"

    def _miss(self, seq: int, due: float, held: float) -> None:
        """Write the row of a tick that is skipped; the drive keeps the set-point `held`."""
        sample = Sample.missing(self._start + due, _MISSED)
        self._outcome.missed += 1
        self._outcome.late += 1
        self._sink.append(self._row(seq, due, held, sample, AtJoint()))

    def _stopped(self, stop: StopRequest) -> None:
        self._outcome.end_reason = "stopped on request"
        self._outcome.signal = stop.number

    def _tick(self, seq: int, due: float, set_point: float, zero: Zero) -> None:
        try:
            sample = self._servo.exchange(self._transmission.command(self._profile.mode, set_point, zero))
        except (NoReply, BadReply) as error:
            status = Status.BAD_REPLY if isinstance(error, BadReply) else Status.NO_REPLY
            sample = Sample.missing(self._start + due, status)
            self._outcome.lost += 1
            self._sink.append(self._row(seq, due, set_point, sample, AtJoint()))
            self._guard.check_silence(self._servo.clock.now())
            return
        at_joint = self._at_joint(sample, zero)
        self._sink.append(self._row(seq, due, set_point, sample, at_joint))
        self._guard.check(sample, at_joint)

    def _at_joint(self, sample: Sample, zero: Zero) -> AtJoint:
        way = self._transmission
        from_cell = self._torque_source == "joint"
        return AtJoint(
            torque=sample.joint_torque if from_cell else way.torque(sample.motor_torque),
            dtheta=way.deflection(sample.motor_position, sample.joint_position if self._has_joint else 0.0, zero),
            dtheta_dot=way.rate(sample.motor_velocity),
        )

    def _row(self, seq: int, due: float, set_point: float, sample: Sample, at_joint: AtJoint) -> Row:
        sent = sample.t - self._start
        status = int(sample.status)  # an operation on the flags themselves takes as long as the rest of a tick
        if sent - due > 0.5 / self._rate:
            status |= _LATE
            self._outcome.late += 1
        if status & _SATURATED:
            self._outcome.saturated += 1
        return Row(
            seq=seq,
            time=sent,
            command=set_point,
            torque=at_joint.torque,
            dtheta=at_joint.dtheta,
            dtheta_dot=at_joint.dtheta_dot,
            motor_position=sample.motor_position,
            motor_velocity=sample.motor_velocity,
            motor_torque=sample.motor_torque,
            joint_position=sample.joint_position,
            joint_torque=sample.joint_torque,
            read_time=sample.t_read - self._start,
            joint_time=sample.t_joint - self._start,
            temperature=sample.temperature,
            status=status,
        )

    def _torque_off(self) -> None:
        result = confirm_torque_off(self._servo)
        self._outcome.alarm, self._off_error = result.alarm, result.error
        self._off_asked = True
        if result.confirmed and self._outcome.phases.now is not Phase.OFF:
            self._enter(Phase.OFF)

    def _enter(self, phase: Phase) -> None:
        self._outcome.phases.enter(phase, self._servo.clock.now())

    def _note_end(self) -> None:
        """Add the fault that ended the run to its events. A failure here must not lose the data."""
        outcome = self._outcome
        outcome.error = outcome.error or self._off_error
        if outcome.alarm:
            outcome.end_reason = f"{outcome.end_reason}; {outcome.alarm}"
        if outcome.error is None:
            return
        try:
            since = self._servo.clock.now() - self._start if math.isfinite(self._start) else 0.0
            self._sink.event(since, type(outcome.error).__name__, outcome.end_reason)
        except Exception as error:  # noqa: BLE001 - in any case the data is kept
            outcome.end_reason += f"; {error}"


def _check_stop(stop: StopRequest) -> None:
    if stop.count:
        raise _Stopped


def _mean(values: Iterable[float]) -> float:
    """Return the mean of the finite values, NaN without any."""
    numbers = [value for value in values if math.isfinite(value)]
    return fmean(numbers) if numbers else math.nan


@contextmanager
def _quiet_collector() -> Iterator[None]:
    """Switch garbage collection off: a full one can stop the loop for 100 ms."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
