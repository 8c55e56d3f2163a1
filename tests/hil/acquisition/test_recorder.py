"""The control loop: the right set-points, the true rows, and torque off at every way out."""

from __future__ import annotations

import math
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from drivers.servo import BadReply, Command, DeviceFault, DriverError, LinkLost, NoReply, Quantity, Sample, Status
from hil.acquisition import excitation, recorder
from hil.acquisition.excitation import Profile
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.limits import LimitReached
from hil.acquisition.phases import Outcome
from hil.acquisition.recorder import Recorder, tick_count
from hil.acquisition.sink import Memory
from hil.errors import WrongUse
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.stand.file import Stand, parse

from ..conftest import SpringServo, lost

RATE = 100.0
STAND = """
[stand]
gear_ratio = 4.0
torque_source = "joint"
[limits]
torque = 0.1
deflection = 0.06
velocity = 50.0
temperature = 70.0
"""


def profile(quantity: Quantity = Quantity.TORQUE, amplitude: float = 0.05, duration: float = 2.0) -> Profile:
    return excitation.make(
        "sine",
        quantity,
        amplitude=amplitude,
        default_amplitude=1.0,
        duration=duration,
        band=(1.0, 1.0),
        rate=RATE,
        fade=0.2,
    )


class Bench:
    """A run on the spring servo, and the recording it left."""

    def __init__(self, folder: Path, *, stand: str = STAND, asked: Profile | None = None) -> None:
        self.servo = SpringServo()
        self.stop = StopRequest()
        self.profile = asked or profile()
        self.stand: Stand = parse(stand)
        self._path = folder / "a.h5"

    def run(self) -> Outcome:
        header = Header(profile=self.profile.attributes())
        with RecordingWriter(self._path, header, tick_count(self.profile, RATE), batch=3) as part:
            self.outcome = Recorder(self.stand, self.servo, self.profile, RATE, part).run(self.stop)
            if self.outcome.samples:
                part.finish(self.outcome.end_reason)
        return self.outcome

    def channel(self, name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        with Recording(self._path) as recording:
            return recording.channel(name)

    def events(self) -> list[str]:
        with Recording(self._path) as recording:
            return [event.code for event in recording.events()]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_a_run_holds_every_tick_at_its_time(bench: Bench) -> None:
    outcome = bench.run()
    assert (outcome.samples, outcome.lost, outcome.end_reason, outcome.error) == (201, 0, "done", None)
    np.testing.assert_allclose(bench.channel("time"), np.arange(201) / RATE, atol=1e-9)
    np.testing.assert_allclose(bench.channel("read_time"), np.arange(201) / RATE + 1e-4, atol=1e-9)
    assert bench.channel("status").tolist() == [0.0] * 201


def test_rows_hold_what_the_spring_did(bench: Bench) -> None:
    """The servo is a spring of 2 N m/rad: deflection is half the torque, and the torque is the set-point."""
    bench.run()
    command = bench.channel("command")
    np.testing.assert_allclose(command, bench.profile.at(np.arange(201) / RATE))
    np.testing.assert_allclose(bench.channel("torque"), command, atol=1e-12)
    np.testing.assert_allclose(bench.channel("dtheta"), command / 2.0, atol=1e-12)
    np.testing.assert_allclose(bench.channel("motor_torque"), command / 4.0, atol=1e-12)


def test_set_points_are_sent_at_the_motor_shaft(bench: Bench) -> None:
    bench.run()
    sent = [command.value for command in bench.servo.driven]
    assert {command.quantity for command in bench.servo.driven} == {Quantity.TORQUE}
    np.testing.assert_allclose(sent, bench.profile.at(np.arange(201) / RATE) / 4.0)


def test_positions_are_commanded_from_where_the_joint_rests(tmp_path: Path) -> None:
    bench = Bench(tmp_path, asked=profile(Quantity.POSITION, amplitude=0.04))
    bench.run()
    sent = [command.value for command in bench.servo.driven]
    np.testing.assert_allclose(sent, 7.0 + 4.0 * bench.profile.at(np.arange(201) / RATE))
    np.testing.assert_allclose(bench.channel("dtheta"), bench.channel("command"), atol=1e-12)


def test_limits_reach_the_servo_at_the_motor_shaft(bench: Bench) -> None:
    bench.run()
    limits = bench.servo.limits
    assert limits is not None
    assert (limits.torque, limits.velocity, limits.temperature) == pytest.approx((0.025, 200.0, 70.0))
    assert limits.position == pytest.approx((7.0 - 0.24, 7.0 + 0.24))


def test_torque_from_the_motor_is_recorded_at_the_joint(tmp_path: Path) -> None:
    bench = Bench(tmp_path, stand=STAND.replace('"joint"', '"motor"'))
    bench.run()
    np.testing.assert_allclose(bench.channel("torque"), 4.0 * bench.channel("motor_torque"), atol=1e-15)


@pytest.mark.parametrize(("error", "status"), [(NoReply("-"), Status.NO_REPLY), (BadReply("-"), Status.BAD_REPLY)])
def test_a_lost_reply_is_a_counted_gap_and_no_value_is_invented(
    bench: Bench, error: DriverError, status: Status
) -> None:
    bench.servo.script = {50: error, 90: error}
    outcome = bench.run()
    assert (outcome.lost, outcome.samples, outcome.end_reason) == (2, 201, "done")
    assert np.flatnonzero(bench.channel("status") == int(status)).tolist() == [50, 90]
    for name in ("torque", "dtheta", "motor_position", "read_time", "temperature"):
        assert np.flatnonzero(np.isnan(bench.channel(name))).tolist() == [50, 90]
    np.testing.assert_allclose(bench.channel("time"), np.arange(201) / RATE, atol=1e-9)
    np.testing.assert_allclose(bench.channel("command"), bench.profile.at(np.arange(201) / RATE))


def test_silence_ends_the_run_with_the_torque_off(bench: Bench) -> None:
    bench.servo.script = lost(50, start=60)
    outcome = bench.run()
    assert isinstance(outcome.error, NoReply)
    assert len(bench.servo.driven) == 63
    assert not bench.servo.armed
    assert bench.events() == ["NoReply"]


@pytest.mark.parametrize(
    "error", [LinkLost("cable"), DeviceFault(32, "overload"), OSError(5, "I/O error"), ZeroDivisionError("of our own")]
)
def test_a_fault_ends_the_run_at_once_and_keeps_the_data(bench: Bench, error: Exception) -> None:
    bench.servo.script = {70: error}
    outcome = bench.run()
    assert outcome.error is error
    assert outcome.samples == 70
    assert not bench.servo.armed
    assert bench.events() == [type(error).__name__]


@pytest.mark.parametrize(
    ("changes", "ticks"),
    [
        ({"joint_torque": 0.12}, 3),
        ({"joint_torque": -0.16}, 1),
        ({"motor_position": 7.0 + 4 * 0.07}, 3),
        ({"motor_velocity": 4 * 80.0}, 1),
        ({"temperature": 66.0}, 1),
    ],
)
def test_a_limit_passed_ends_the_run_in_few_ticks(bench: Bench, changes: dict[str, float], ticks: int) -> None:
    bench.servo.script = dict.fromkeys(range(80, 201), changes)
    outcome = bench.run()
    assert isinstance(outcome.error, LimitReached)
    assert len(bench.servo.driven) == 80 + ticks
    assert not bench.servo.armed


def test_one_odd_reading_does_not_throw_a_recording_away(bench: Bench) -> None:
    bench.servo.script = {80: {"joint_torque": 0.12}, 82: {"joint_torque": 0.12}}
    assert bench.run().end_reason == "done"


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        ({"motor_position": math.nan}, "no position"),
        ({"motor_position": 1e300}, "home the drive"),
        ({"motor_position": -3.4e38}, "home the drive"),
        ({"joint_torque": math.nan}, "torque_source"),
    ],
)
def test_a_stand_that_cannot_measure_is_not_driven(bench: Bench, rest: dict[str, float], message: str) -> None:
    bench.servo.rest = rest
    outcome = bench.run()
    assert message in str(outcome.error)
    assert bench.servo.driven == []


def test_one_request_to_stop_ramps_the_torque_to_zero_within_a_tenth_of_a_second(bench: Bench) -> None:
    """A tenth of a second at 100 Hz is ten ticks, each a tenth less of what the profile asks."""
    bench.servo.clock.plans = [(100.0 + 0.15 + 1.2, lambda: os.kill(os.getpid(), signal.SIGINT))]
    with bench.stop.listening():
        outcome = bench.run()
    assert (outcome.end_reason, outcome.signal, outcome.error) == ("stopped on request", signal.SIGINT, None)
    wanted = bench.profile.at(np.arange(outcome.samples) / RATE)
    share = bench.channel("command")[-10:] / wanted[-10:]
    np.testing.assert_allclose(share, np.arange(1.0, 0.05, -0.1), atol=1e-6)
    assert not bench.servo.armed
    assert bench.events() == ["stop-requested", "torque-off"]


def test_a_second_request_ends_the_run_at_the_next_tick(bench: Bench) -> None:
    def twice() -> None:
        bench.stop.count = 2

    bench.servo.clock.plans = [(100.0 + 0.15 + 1.0, twice)]
    outcome = bench.run()
    assert len(bench.servo.driven) == outcome.samples <= 101
    assert not bench.servo.armed


def test_no_number_of_signals_skips_the_torque_off(bench: Bench) -> None:
    def many() -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) * 7:
            os.kill(os.getpid(), number)

    bench.servo.clock.plans = [(100.0 + 0.15 + 1.0, many)]
    before = signal.getsignal(signal.SIGINT)
    with bench.stop.listening():
        outcome = bench.run()
    assert outcome.signal == signal.SIGINT
    assert not bench.servo.armed
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    "trouble", [NoReply("no answer to torque off"), OSError(5, "I/O error"), RuntimeError("a fault of the driver's")]
)
def test_a_torque_off_that_is_not_confirmed_is_shouted(bench: Bench, trouble: Exception) -> None:
    bench.servo.disarm_error = trouble
    outcome = bench.run()
    assert outcome.alarm.startswith("CUT THE POWER: ")
    assert outcome.alarm in outcome.end_reason
    assert outcome.error is trouble
    assert bench.servo.disarms == 100


def test_a_torque_off_that_is_not_confirmed_is_shouted_over_an_earlier_error(bench: Bench) -> None:
    bench.servo.script = {70: LinkLost("cable")}
    bench.servo.disarm_error = LinkLost("still no cable")
    outcome = bench.run()
    assert outcome.alarm == "CUT THE POWER: the torque-off is not confirmed (still no cable)"
    assert "LinkLost: cable; CUT THE POWER" in outcome.end_reason
    assert outcome.error is bench.servo.script[70]


def test_a_torque_off_is_requested_until_it_is_confirmed(bench: Bench) -> None:
    bench.servo.disarm_error, bench.servo.heard_after = NoReply("a moment's silence"), 7
    outcome = bench.run()
    assert (bench.servo.disarms, bench.servo.armed) == (7, False)
    assert (outcome.alarm, outcome.error, outcome.end_reason) == ("", None, "done")
    assert bench.servo.clock.t - 102.16 == pytest.approx(6 * 0.05)


class Listed(list[float]):
    """Stands in for the set-points on disk."""

    def __init__(self, folder: Path) -> None:
        assert folder.is_dir()
        super().__init__()

    def __enter__(self) -> Listed:
        return self

    def __exit__(self, *exception: object) -> None:
        pass


def test_ctrl_c_at_any_line_of_the_recorder_leaves_the_torque_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Raised by the tracer before the n-th line that is executed, for every n; servo and store are closed forms."""
    monkeypatch.setattr(recorder, "_REST_SAMPLES", 2)
    monkeypatch.setattr(recorder, "SetPoints", Listed)
    short = excitation.make(
        "sine", Quantity.TORQUE, amplitude=0.05, default_amplitude=1.0, duration=0.03, band=(2.0, 2.0), rate=RATE
    )
    for at in count(1):
        servo, lines = SpringServo(), count(1)

        def trace(frame: FrameType, event: str, _: object, at: int = at, lines: Iterator[int] = lines) -> Any:
            if frame.f_code.co_filename != recorder.__file__:
                return None
            if event == "line" and next(lines) == at:
                raise KeyboardInterrupt
            return trace

        run = Recorder(parse(STAND), servo, short, RATE, Memory(), scratch=tmp_path)
        raised: BaseException | None = None
        sys.settrace(trace)
        try:
            outcome = run.run(StopRequest())
        except KeyboardInterrupt as error:
            raised = error
        finally:
            sys.settrace(None)
        assert not servo.armed, at
        if raised is None and outcome.error is None and next(lines) <= at:
            break
    assert at > 200
    assert len(servo.driven) == 4


@pytest.mark.parametrize("replies", [1, 16])
def test_a_request_to_stop_is_heeded_between_any_two_requests_before_the_start(bench: Bench, replies: int) -> None:
    """After the last reply at rest nothing is left but to arm."""
    asked = 0

    class Watched(SpringServo):
        def exchange(self, command: Command) -> Sample:
            nonlocal asked
            asked += 1
            bench.stop.count = int(asked == replies)
            return super().exchange(command)

    bench.servo = Watched()
    assert bench.run().end_reason == "stopped on request"
    assert (asked, bench.servo.limits) == (replies, None)


@pytest.mark.parametrize("name", ["joint_torque", "motor_position", "motor_velocity", "temperature"])
def test_a_sensor_that_goes_blind_ends_the_run_at_the_third_reply(bench: Bench, name: str) -> None:
    nothing = {name: math.nan}
    bench.servo.script = dict.fromkeys([20, 21, 30, *range(80, 201)], nothing)
    outcome = bench.run()
    assert isinstance(outcome.error, BadReply)
    assert "missing from 3 replies" in str(outcome.error)
    assert len(bench.servo.driven) == 83
    assert not bench.servo.armed


def test_a_sensor_the_stand_does_not_have_is_not_missed(bench: Bench) -> None:
    blind = {"temperature": math.nan, "motor_velocity": math.nan}
    bench.servo.rest = blind
    bench.servo.script = dict.fromkeys(range(201), blind)
    assert bench.run().end_reason == "done"


def test_a_missing_reading_does_not_hide_that_a_limit_is_passed(bench: Bench) -> None:
    beyond, nothing = {"joint_torque": 0.12}, {"joint_torque": math.nan}
    bench.servo.script = {80: beyond, 81: nothing, 82: beyond, 83: nothing, 84: beyond}
    outcome = bench.run()
    assert isinstance(outcome.error, LimitReached)
    assert len(bench.servo.driven) == 85


def test_a_drive_whose_clock_stands_still_ends_the_run(bench: Bench) -> None:
    """Three replies are too few where they come every 10 ms: 50 ms of them are asked for."""
    stale = {"status": float(int(Status.STALE))}
    bench.servo.script = dict.fromkeys([20, 21, 22, 23, *range(80, 201)], stale)
    outcome = bench.run()
    assert isinstance(outcome.error, BadReply)
    assert len(bench.servo.driven) in {85, 86}  # the fifth is 50 ms after the last fresh one, give or take rounding
    assert not bench.servo.armed


def test_an_encoder_that_stands_still_while_the_torque_moves_ends_the_run(bench: Bench) -> None:
    """The torque swings by 0.05 N m either way; in the half second from its peak it changes by more than that."""
    stuck = {"motor_position": 7.0 + 4.0 * 0.05 / 2.0}
    bench.servo.script = dict.fromkeys(range(75, 201), stuck)
    outcome = bench.run()
    assert isinstance(outcome.error, BadReply)
    assert "encoder" in str(outcome.error)
    assert 75 + 20 < len(bench.servo.driven) < 75 + 30
    assert not bench.servo.armed


def test_an_axis_that_rests_is_not_taken_for_a_frozen_one(tmp_path: Path) -> None:
    steps = excitation.make(
        "steps", Quantity.TORQUE, amplitude=0.05, default_amplitude=1.0, duration=4.0, band=(0.25, 0.25), rate=RATE
    )
    assert Bench(tmp_path, asked=steps).run().end_reason == "done"


@pytest.mark.parametrize(("temperature", "starts"), [(55.0, True), (55.5, False)])
@pytest.mark.parametrize("before", [True, False])
def test_a_motor_is_started_up_to_fifteen_and_runs_up_to_five_degrees_below_its_limit(
    bench: Bench, temperature: float, starts: bool, before: bool
) -> None:
    if before:
        bench.servo.rest = {"temperature": temperature}
    else:
        bench.servo.script = {100: {"temperature": temperature + 10.0}}
    outcome = bench.run()
    assert (outcome.end_reason == "done") == starts
    assert isinstance(outcome.error, LimitReached) != starts
    assert starts or not before or (outcome.samples, bench.servo.driven) == (0, [])


def test_every_set_point_is_worked_out_before_the_motor_is_live(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    armed = []

    def shape(time: np.ndarray[tuple[int], np.dtype[np.float64]]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        armed.append(bench.servo.limits is not None)
        return np.sin(time)

    bench.profile = replace(profile(duration=20.0), shape=shape)
    assert bench.run().samples == 2001
    assert armed == [False] * 4
    np.testing.assert_allclose(bench.channel("command"), bench.profile.at(np.arange(2001) / RATE))


def test_a_set_point_that_is_no_number_ends_the_run_before_the_motor_is_live(bench: Bench) -> None:
    bench.profile = replace(bench.profile, shape=lambda time: np.where(time > 1.5, np.nan, 0.0))
    outcome = bench.run()
    assert isinstance(outcome.error, WrongUse)
    assert bench.servo.limits is None


def test_a_rate_the_servo_cannot_answer_at_is_refused_before_the_motor_is_live(bench: Bench) -> None:
    class Slow(SpringServo):
        def exchange(self, command: Command) -> Sample:
            sample = super().exchange(command)
            self.clock.t += 0.0160
            return sample

    bench.servo = Slow()
    outcome = bench.run()
    assert isinstance(outcome.error, WrongUse)
    assert "16 ms to answer, so it reaches at most 62 Hz" in str(outcome.error)
    assert bench.servo.limits is None


def test_a_computer_that_is_busy_before_the_run_is_not_taken_for_a_slow_servo(bench: Bench) -> None:
    class Delayed(SpringServo):
        asked = 0

        def exchange(self, command: Command) -> Sample:
            sample = super().exchange(command)
            self.asked += 1
            self.clock.t += 0.016 * (self.limits is None and self.asked % 3 > 0)
            return sample

    bench.servo = Delayed()
    assert bench.run().error is None


def test_what_is_ignored_stays_ignored_and_what_ends_a_process_is_a_flag() -> None:
    """nohup has SIGHUP ignored; the run it shields must not be ended by a closed terminal."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        stop = StopRequest()
        with stop.listening():
            os.kill(os.getpid(), signal.SIGHUP)
            assert stop.count == 0
            for number in (signal.SIGQUIT, signal.SIGTSTP, signal.SIGUSR1):
                os.kill(os.getpid(), number)
            assert (stop.count, stop.number) == (3, signal.SIGQUIT)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


class Stalled:
    """A run at 1 kHz whose computer stalls for `stall` s before the tick at 1 s; `sent` holds the time of each tick."""

    def __init__(self, folder: Path, stall: float) -> None:
        self.servo, self.rows, self.sent = SpringServo(), Memory(), list[float]()
        clock, exchange = self.servo.clock, self.servo.exchange

        def timed(command: Command) -> Sample:
            if self.servo.armed:
                self.sent.append(clock.now() - self.start)
            return exchange(command)

        def stalls() -> None:
            clock.t += stall

        self.start = 100.0 + 15e-3 + 1e-3  # sixteen readings at rest, and a period to the first tick
        clock.plans = [(self.start + 1.0 - 1e-9, stalls)]
        self.servo.exchange = timed  # type: ignore[method-assign]  # watched
        profile_ = profile()
        self.outcome = Recorder(parse(STAND), self.servo, profile_, 1000.0, self.rows, scratch=folder).run(
            StopRequest()
        )
        self.status = self.rows.channel("status").astype(int)
        self.wanted = profile_.at(np.arange(len(self.status)) / 1000.0)


def test_a_late_tick_is_marked_and_lateness_does_not_add_up(tmp_path: Path) -> None:
    run = Stalled(tmp_path, 0.7e-3)
    assert (run.outcome.late, run.outcome.missed, run.outcome.error) == (1, 0, None)
    assert np.flatnonzero(run.status).tolist() == [1000]
    assert run.status[1000] == int(Status.LATE)
    assert run.rows.channel("time")[-1] == pytest.approx(2.0)


def test_missed_ticks_are_rows_and_their_set_points_are_not_replayed(tmp_path: Path) -> None:
    """After 5.5 ms the five ticks that are over are skipped, and the sixth is sent at once, 0.5 ms late."""
    run = Stalled(tmp_path, 5.5e-3)
    assert (run.outcome.late, run.outcome.missed, run.outcome.lost) == (5, 5, 0)
    assert run.outcome.error is None
    missed = np.flatnonzero(run.status & int(Status.MISSED))
    assert missed.tolist() == list(range(1000, 1005))
    assert np.isnan(run.rows.channel("dtheta")[missed]).all()
    np.testing.assert_array_equal(run.rows.channel("command")[missed], run.wanted[999])  # what the drive kept
    assert len(run.status) == 2001 == len(run.servo.driven) + 5
    assert np.diff(run.sent).min() > 0.49e-3
    driven = np.array([command.value for command in run.servo.driven])
    np.testing.assert_allclose(driven, np.delete(run.wanted, missed) / 4.0)
    assert (np.diff(run.rows.channel("time")) > 0.0).all()


def test_a_tick_more_than_ten_milliseconds_late_ramps_the_torque_to_zero_and_one_of_fifty_is_the_last(
    tmp_path: Path,
) -> None:
    run = Stalled(tmp_path, 51e-3)  # more than 50 ms: it is the last
    assert isinstance(run.outcome.error, LimitReached)
    assert (len(run.servo.driven), run.servo.armed, run.servo.disarms) == (1000, False, 1)
    run = Stalled(tmp_path, 30.2e-3)
    assert isinstance(run.outcome.error, LimitReached)
    assert "30 ms late" in run.outcome.end_reason
    assert not run.servo.armed
    assert len(run.status) == 1100
    np.testing.assert_allclose(run.rows.channel("command")[1030:], run.wanted[1030:] * np.linspace(0.7, 0.01, 70))


class Slow:
    """A run at 1 kHz in which the drive takes `wait` s at each of some ticks, and answers or not."""

    def __init__(self, folder: Path, wait: float, ticks: set[int], *, answers: bool) -> None:
        servo = SpringServo()
        clock, exchange = servo.clock, servo.exchange

        def slow(command: Command) -> Sample:
            sample = exchange(command)
            if len(servo.driven) in ticks:
                clock.t += wait
                if not answers:
                    raise NoReply("-")
            return sample

        servo.exchange = slow  # type: ignore[method-assign]  # slowed down
        self.servo = servo
        self.outcome = Recorder(parse(STAND), servo, profile(), 1000.0, Memory(), scratch=folder).run(StopRequest())


@pytest.mark.parametrize("answers", [True, False])
def test_the_wait_for_a_reply_is_silence_of_the_link_and_no_lateness_of_the_computer(
    tmp_path: Path, answers: bool
) -> None:
    """Each of two replies in a row is waited for by 12 ms, as two lost ones are with a timeout of 8 ms."""
    run = Slow(tmp_path, 12e-3, {500, 501}, answers=answers)
    assert (run.outcome.error, run.outcome.lost) == (None, 0 if answers else 2)


def test_a_drive_that_takes_longer_to_answer_than_a_silence_may_last_is_ramped_down(tmp_path: Path) -> None:
    run = Slow(tmp_path, 25e-3, {500}, answers=True)
    assert isinstance(run.outcome.error, LimitReached)
    assert "slow to answer" in run.outcome.end_reason
    assert not run.servo.armed


def test_saturated_rows_are_counted(bench: Bench) -> None:
    bench.servo.script = {number: {"status": float(int(Status.SATURATED))} for number in (5, 6)}
    assert bench.run().saturated == 2


def test_a_servo_that_never_answers_ends_the_run(bench: Bench) -> None:
    class Mute(SpringServo):
        def exchange(self, command: Command) -> object:  # type: ignore[override]
            raise NoReply(f"nothing after {command}")

    bench.servo = Mute()
    outcome = bench.run()
    assert isinstance(outcome.error, NoReply)
    assert "check power" in str(outcome.error)


def test_a_drive_that_confirms_torque_off_and_pulls_on_raises_the_alarm(bench: Bench) -> None:
    class Deaf(SpringServo):
        def disarm(self) -> None:
            self.rest = {"motor_torque": 0.1}
            super().disarm()

    bench.servo = Deaf()
    outcome = bench.run()
    assert "CUT THE POWER" in outcome.alarm
    assert "still reports 0.1 N m" in outcome.alarm
    assert outcome.phases.history[-1][1] != "off"
