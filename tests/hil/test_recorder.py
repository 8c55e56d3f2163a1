"""The control loop: the right set-points, the true rows, and torque off at every way out."""

from __future__ import annotations

import math
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from drivers.servo import BadReply, Command, DeviceFault, DriverError, LinkLost, NoReply, Quantity, Status
from hil import profiles
from hil.guard import LimitReached, StopRequest
from hil.part import Header, PartFile
from hil.profiles import Profile
from hil.recorder import Outcome, Recorder, tick_count
from hil.stand import Stand, parse
from hil.store import Recording

from .conftest import SpringServo, lost

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
    return profiles.make(
        "sine",
        quantity,
        amplitude=amplitude,
        default_amplitude=1.0,
        duration=duration,
        band=(1.0, 1.0),
        rate=RATE,
        soft=0.2,
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
        with PartFile(self._path, header, tick_count(self.profile, RATE), batch=3) as part:
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


def test_silence_ends_the_run_with_the_torque_off(bench: Bench) -> None:
    bench.servo.script = lost(50, start=60)
    outcome = bench.run()
    assert isinstance(outcome.error, NoReply)
    assert len(bench.servo.driven) == 63
    assert not bench.servo.armed
    assert bench.events() == ["NoReply"]


@pytest.mark.parametrize("error", [LinkLost("cable"), DeviceFault(32, "overload"), OSError(5, "I/O error")])
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


def test_a_warm_motor_is_not_started(bench: Bench) -> None:
    bench.servo.rest = {"temperature": 56.0}
    outcome = bench.run()
    assert isinstance(outcome.error, LimitReached)
    assert (outcome.samples, bench.servo.driven) == (0, [])


@pytest.mark.parametrize(
    ("rest", "said"), [({"motor_position": math.nan}, "no position"), ({"joint_torque": math.nan}, "torque_source")]
)
def test_a_stand_that_cannot_measure_is_not_driven(bench: Bench, rest: dict[str, float], said: str) -> None:
    bench.servo.rest = rest
    outcome = bench.run()
    assert said in str(outcome.error)
    assert bench.servo.driven == []


def test_one_request_to_stop_lets_the_cable_down_within_a_tenth_of_a_second(bench: Bench) -> None:
    """A tenth of a second at 100 Hz is ten ticks, each a tenth less of what the profile asks."""
    bench.servo.clock.plans = [(100.0 + 0.15 + 1.2, lambda: os.kill(os.getpid(), signal.SIGINT))]
    with bench.stop.listening():
        outcome = bench.run()
    assert (outcome.end_reason, outcome.signal, outcome.error) == ("stopped on request", signal.SIGINT, None)
    wanted = bench.profile.at(np.arange(outcome.samples) / RATE)
    share = bench.channel("command")[-10:] / wanted[-10:]
    np.testing.assert_allclose(share, np.arange(1.0, 0.05, -0.1), atol=1e-6)
    assert not bench.servo.armed
    assert bench.events() == ["stop-requested"]


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


def test_an_error_nobody_foresaw_still_leaves_the_torque_off(bench: Bench) -> None:
    bench.servo.script = {10: ZeroDivisionError("a fault of our own")}
    with pytest.raises(ZeroDivisionError):
        bench.run()
    assert not bench.servo.armed


def test_a_torque_off_that_is_not_confirmed_is_shouted(bench: Bench) -> None:
    bench.servo.disarm_error = NoReply("no answer to torque off")
    outcome = bench.run()
    assert "CUT THE POWER" in outcome.end_reason
    assert outcome.error is bench.servo.disarm_error


def test_late_ticks_are_marked(bench: Bench) -> None:
    clock = bench.servo.clock

    def stall() -> None:
        clock.t += 0.017

    clock.plans = [(100.0 + 0.15 + 1.0, stall)]
    outcome = bench.run()
    assert outcome.late == 2
    assert np.count_nonzero(bench.channel("status") == int(Status.LATE)) == 2
    assert bench.channel("time")[-1] == pytest.approx(2.0)  # lateness does not add up


def test_saturated_rows_are_counted(bench: Bench) -> None:
    bench.servo.script = {number: {"status": float(int(Status.SATURATED))} for number in (5, 6)}
    assert bench.run().saturated == 2


def test_a_servo_that_never_answers_is_given_up(bench: Bench) -> None:
    class Mute(SpringServo):
        def exchange(self, command: Command) -> object:  # type: ignore[override]
            raise NoReply(f"nothing after {command}")

    bench.servo = Mute()
    outcome = bench.run()
    assert isinstance(outcome.error, NoReply)
    assert "check power" in str(outcome.error)
