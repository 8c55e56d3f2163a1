"""The control loop: drive the motor through a profile, tick by tick, and write every sample.

A tick is one `exchange`. A lost reply is counted as a gap; every other fault ends the run. However the run ends, the
torque is switched off before anything else, and the rows so far are kept.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from statistics import fmean

import numpy as np

from drivers.neighbours import SeesNeighbours
from drivers.servo import BadReply, Command, Limits, NoReply, Quantity, Sample, Servo, ServoInfo, Status
from drivers.torque_off import Alarm, Driven, confirm_torque_off, log_alarm
from hil.acquisition.excitation import Profile
from hil.acquisition.guard import Guard
from hil.acquisition.heat import heat_budget
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.limits import AtJoint, LimitReached
from hil.acquisition.phases import Outcome, Phase
from hil.acquisition.real_time import real_time
from hil.acquisition.setpoints import SetPoints
from hil.acquisition.sink import Sink
from hil.errors import WrongUse
from hil.recording.channels import Row, row_of
from hil.stand.file import Stand
from hil.stand.opening import innermost, limits_below_one_count, require_watchdog, slower_when_armed
from hil.stand.transmission import Transmission, Zero

_REST_SAMPLES = 16  # averaged for the zero of the deflection
_REST_TRIES = 100
_RESOLVED = 1e-6  # share of the deflection limit that the angle at rest must resolve
_TOO_LONG = 1.5  # periods that an answer at rest may take; some drives answer sooner once they are armed
_SPARE = 1.05  # of the mean time of an answer, with which late ticks catch up although some answers are longer
_RAMP_DOWN = 0.1  # s; a first request to stop ramps the torque to zero over this long
_BLOCK = 512  # set-points computed at a time
_GOOD, _LATE, _SATURATED = Status(0), int(Status.LATE), int(Status.SATURATED)
_MISSED = Status.MISSED | Status.LATE | Status.NO_REPLY

_Readings = Callable[[Sample], AtJoint]


class _Stopped(Exception):
    """The run was stopped on request before the motor was driven."""


def tick_count(profile: Profile, rate: float) -> int:
    """Return the number of rows of a run of `profile` at `rate` Hz."""
    return round(profile.duration * rate) + 1


class Recorder:
    """Records one run of `profile` on the open `servo`, at `rate` Hz, into `sink`.

    scratch: the folder for the set-points of a long run, which are kept on disk; None: the system's temporary folder.
    alarm: called at once if the torque may still be on, see `confirm_torque_off`; None: it is logged. Raises WrongUse
    for a stand without limits, or with one below a count of its drive, and for a drive whose torque stays on when this
    computer stops, unless the stand file accepts that.
    """

    def __init__(
        self,
        stand: Stand,
        servo: Servo,
        profile: Profile,
        rate: float,
        sink: Sink,
        *,
        scratch: Path | None = None,
        alarm: Alarm | None = None,
    ) -> None:
        limits = stand.checked_limits()
        require_watchdog(stand, servo.info)
        if too_small := limits_below_one_count(stand, servo.info):
            raise WrongUse(f"{too_small}. Nothing was driven")
        self._torque_source = stand.stand.torque_source
        self._transmission = Transmission.of(stand.stand)
        self._limits = limits
        self._has_joint = False
        self._servo = servo
        self._profile = profile
        self._rate, self._late = rate, 0.5 / rate  # s after its time from which a tick is late
        self._sink, self._append = sink, sink.append
        self._scratch = Path(tempfile.gettempdir()) if scratch is None else scratch
        self._alarm = alarm or log_alarm
        # a profile of torque swings by twice its amplitude; for a profile of position only the limit is known
        by_torque = profile.mode is Quantity.TORQUE
        self._heat = heat_budget(stand, servo.info, profile)
        self._guard = Guard(
            limits,
            moves=profile.amplitude if by_torque else 0.5 * limits.torque,
            more=() if self._heat is None else (self._heat,),
            counts=self._counts(servo.info),
        )
        self._check = self._guard.check
        self._outcome = Outcome()
        self._start, self._stopping_at = math.nan, math.inf  # s; of the run, at which the ramp-down begins
        self._at_motor: Limits | None = None  # once it may be driven
        self._last = Sample.missing(math.nan)  # reply while it was driven
        self._off_asked = False
        self._off_error: BaseException | None = None

    def _counts(self, info: ServoInfo) -> AtJoint:
        """Return the value of one count of each reading at the joint, NaN if it is not known."""
        way, drives = self._transmission, self._torque_source == "motor"
        angle, velocity = way.rate(info.position_lsb), way.rate(info.velocity_lsb)  # both are divided by the ratio
        return AtJoint(way.torque(info.torque_lsb) if drives else math.nan, angle, velocity)

    def run(self, stop: StopRequest) -> Outcome:
        """Record until the profile's end, a request to stop or a fault. The servo is disarmed on return.

        Never raises, because the rows must still be saved: the outcome holds the error.
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
        if not isinstance(outcome.error, LimitReached):
            outcome.exceeded = self._guard.exceeded(self._start)
        self._note_end()
        return outcome

    def _record(self, stop: StopRequest) -> None:
        with SetPoints(self._scratch) as set_points:
            for times in self._times():
                _check_stop(stop)
                set_points.extend(self._profile.at(times))
            zero = self._find_zero(stop)
            limits = self._transmission.motor_limits(self._limits, zero.motor)
            with real_time(self._servo.clock):
                _check_stop(stop)
                try:
                    self._enter(Phase.ARMING)
                    self._at_motor = limits
                    self._servo.arm(limits)
                    self._loop(set_points, zero, stop)
                finally:  # before anything else, which might take its time
                    self._torque_off()

    def _times(self) -> Iterator[np.ndarray[tuple[int], np.dtype[np.float64]]]:
        count = tick_count(self._profile, self._rate)
        for first in range(0, count, _BLOCK):
            yield np.arange(first, min(first + _BLOCK, count)) / self._rate

    def _find_zero(self, stop: StopRequest) -> Zero:
        """Return the motor's and the joint's angle at rest, read without driving the motor.

        Raises NoReply if the drive does not answer, BadReply if a necessary reading is missing, WrongUse if the drive
        answers too slowly for the rate, LimitReached if the winding is too warm.
        """
        samples = self._at_rest(stop)
        motor = _mean(sample.motor_position for sample in samples)
        joint = _mean(sample.joint_position for sample in samples)
        if not math.isfinite(motor):
            raise BadReply("the drive reports no position, so no deflection can be recorded: check its encoder")
        if math.ulp(motor) > _RESOLVED * self._limits.deflection * self._transmission.ratio:
            raise BadReply(
                f"the drive reports {motor:.3g} rad at rest, too far from zero to resolve a deflection: home the drive"
            )
        self._has_joint = math.isfinite(joint)
        zero = Zero(motor, joint if self._has_joint else 0.0)
        at_rest = [*map(self._readings(zero), samples)]
        if not any(math.isfinite(one.torque) for one in at_rest):
            raise BadReply(
                f"the stand file says torque_source = {self._torque_source!r}, but no torque is read from it"
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
        answer = sorted(took)[len(took) // 4]  # a computer that is busy with other things makes some of them longer
        usual, longest = slower_when_armed(self._servo)
        on_average, answer = _SPARE * (answer + usual) if longest else 0.0, answer + longest
        if max(on_average, answer / _TOO_LONG) > 1.0 / self._rate:
            raise WrongUse(
                f"--rate {self._rate:g}: this servo takes {answer * 1e3:.3g} ms to answer, so it reaches at "
                f"most {1.0 / answer:.0f} Hz: lower the rate"
            )
        return samples

    def _loop(self, set_points: Iterable[float], zero: Zero, stop: StopRequest) -> None:
        clock = self._servo.clock
        sleep_until, now_of, check_late, tick = clock.sleep_until, clock.now, self._guard.check_late, self._tick
        period = 1.0 / self._rate
        start = self._start = clock.now() + period
        commands, readings = self._transmission.commands(self._profile.mode, zero), self._readings(zero)
        self._enter(Phase.FADE_IN)
        sent, sent_at, answered = 0.0, start - period, start - period
        steady = False  # in the phase RUN, where the set-points are the profile's
        for seq, set_point in enumerate(set_points):
            due = seq * period
            sleep_until(start + due)
            now = now_of()
            too_late = check_late(now - sent_at - period, answered - sent_at - period)
            if stop.count or too_late or not steady:
                left = self._steered(stop, due, too_late)
                if left <= 0.0:
                    return
                set_point *= left  # noqa: PLW2901 - what is left of it
                steady = self._outcome.phases.now is Phase.RUN
            if now - start - due >= period:
                self._miss(seq, due, sent)
                continue
            sent, sent_at = set_point, now
            tick(seq, due, set_point, commands(set_point), readings)
            answered = now_of()

    def _steered(self, stop: StopRequest, due: float, too_late: str) -> float:
        """Enter the phase that begins at `due` s of the run; return the factor on the set-point: 1, less during a
        ramp-down.

        too_late: the reason to ramp down because a tick was late, "" without one.
        """
        stopping = math.isfinite(self._stopping_at)
        if (stop.count or too_late) and not stopping:
            self._ramp_down(stop, due, too_late)
        elif self._outcome.phases.now is Phase.FADE_IN and due >= self._profile.fade:
            self._enter(Phase.RUN)
        if stop.count > 1:
            return 0.0
        return min(1.0, 1.0 - (due - self._stopping_at) / _RAMP_DOWN)

    def _ramp_down(self, stop: StopRequest, due: float, too_late: str) -> None:
        self._stopping_at = due
        self._enter(Phase.RAMP_DOWN)
        if stop.count:
            self._stopped(stop)
            self._sink.event(due, "stop-requested", f"signal {stop.number}")
        else:
            self._outcome.error = LimitReached(too_late)
            self._outcome.end_reason = f"LimitReached: {too_late}"

    def _miss(self, seq: int, due: float, held: float) -> None:
        """Write the row of the tick number `seq`, which was skipped at `due` s; the drive keeps the set-point
        `held`.
        """
        sample = Sample.missing(self._start + due, _MISSED)
        self._outcome.missed += 1
        self._outcome.late += 1
        self._sink.append(self._row(seq, due, held, sample, AtJoint()))

    def _stopped(self, stop: StopRequest) -> None:
        self._outcome.end_reason = "stopped on request"
        self._outcome.signal = stop.number

    def _tick(self, seq: int, due: float, set_point: float, command: Command, at_joint: _Readings) -> None:
        try:
            sample = self._servo.exchange(command)
        except (NoReply, BadReply) as error:
            status = Status.BAD_REPLY if isinstance(error, BadReply) else Status.NO_REPLY
            sample = Sample.missing(self._start + due, status)
            self._outcome.lost += 1
            self._sink.append(self._row(seq, due, set_point, sample, AtJoint()))
            self._guard.check_silence(self._servo.clock.now())
            return
        self._last = sample
        readings = at_joint(sample)
        self._append(self._row(seq, due, set_point, sample, readings))
        self._check(sample, readings)

    def _readings(self, zero: Zero) -> _Readings:
        """Return the function that converts a sample to torque, deflection and velocity at the joint. zero: the angles
        at rest.
        """
        way, from_cell, has_joint = self._transmission, self._torque_source == "joint", self._has_joint

        def at_joint(sample: Sample) -> AtJoint:
            return AtJoint(
                sample.joint_torque if from_cell else way.torque(sample.motor_torque),
                way.deflection(sample.motor_position, sample.joint_position if has_joint else 0.0, zero),
                way.rate(sample.motor_velocity),
            )

        return at_joint

    def _row(self, seq: int, due: float, set_point: float, sample: Sample, at_joint: AtJoint) -> Row:
        start, flags = self._start, sample.status
        sent = sample.t - start
        status = 0 if flags is _GOOD else int(flags)  # an operation on flags takes as long as the rest of a tick
        if sent - due > self._late:
            status |= _LATE
            self._outcome.late += 1
        if status & _SATURATED:
            self._outcome.saturated += 1
        return row_of(
            (
                seq,
                sent,
                set_point,
                *at_joint,
                sample.motor_position,
                sample.motor_velocity,
                sample.motor_torque,
                sample.joint_position,
                sample.joint_torque,
                sample.t_read - start,
                sample.t_joint - start,
                sample.temperature,
                status,
            )
        )

    def _torque_off(self) -> None:
        driven = None if self._at_motor is None else Driven(self._at_motor, self._last)
        result = confirm_torque_off(self._servo, driven, self._alarm)
        self._outcome.alarm, self._off_error = result.alarm, result.error
        self._off_asked = True
        if result.confirmed and self._outcome.phases.now is not Phase.OFF:
            self._enter(Phase.OFF)

    def _enter(self, phase: Phase) -> None:
        self._outcome.phases.enter(phase, self._servo.clock.now())

    def _note_end(self) -> None:
        """Add to the recording's events when the torque of a stopped run was off, and the fault that ended the run. A
        failure to do so must not lose the recorded rows.
        """
        outcome = self._outcome
        outcome.error = outcome.error or self._off_error
        if outcome.alarm:
            outcome.end_reason = f"{outcome.end_reason}; {outcome.alarm}"
        try:
            for t, phase in outcome.phases.history:
                if phase is Phase.OFF and math.isfinite(self._stopping_at):
                    self._sink.event(t - self._start, "torque-off", "the drive confirmed it")
            since = self._servo.clock.now() - self._start if math.isfinite(self._start) else 0.0
            for text in outcome.exceeded:
                self._sink.event(since, "over-limit", text)
            inner = innermost(self._servo)
            if isinstance(inner, SeesNeighbours) and any((turned := inner.turned()).values()):
                name = max(turned, key=turned.__getitem__)
                outcome.neighbours = f"of the motors that are off, {name} turned most: {1e3 * turned[name]:.3g} mrad"
                self._sink.event(since, "neighbours", outcome.neighbours)
            if outcome.error is not None:
                self._sink.event(since, type(outcome.error).__name__, outcome.end_reason)
        except Exception as error:  # noqa: BLE001 - in any case the data is kept
            outcome.end_reason += f"; {error}"


def _check_stop(stop: StopRequest) -> None:
    if stop.count:
        raise _Stopped


def _mean(values: Iterable[float]) -> float:
    """Return the mean of the finite values, NaN if there are none."""
    numbers = [value for value in values if math.isfinite(value)]
    return fmean(numbers) if numbers else math.nan
