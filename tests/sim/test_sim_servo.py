"""What the simulated servo does beyond the contract; judged by the plant's true state, not by the servo's own flags."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from drivers.clock import MonotonicClock, VirtualClock
from drivers.servo import Command, DeviceFault, DriverError, NoReply, Quantity, Sample, Status
from sim_backend.drive import FaultCode
from sim_backend.parameters import SimParameters
from sim_backend.servo import SimServo

if TYPE_CHECKING:
    from drivers.clock import Clock
    from drivers.servo import Limits, Servo


def torque(value: float) -> Command:
    return Command(Quantity.TORQUE, value)


def driven(servo: SimServo, command: Command, ticks: int, period: float = 2e-3) -> list[Sample]:
    """Samples of a set-point repeated from now on."""
    start, samples = servo.clock.now(), []
    for tick in range(ticks):
        servo.clock.sleep_until(start + tick * period)
        try:
            samples.append(servo.exchange(command))
        except NoReply:
            samples.append(Sample.missing(servo.clock.now()))
    servo.clock.sleep_until(start + ticks * period)
    return samples


def opened(parameters: SimParameters, clock: Clock | None = None) -> SimServo:
    return SimServo(parameters, seed=3, clock=clock or VirtualClock())


def test_the_simulator_is_a_servo(servo: Servo) -> None:
    assert servo.info.backend == "sim"


def test_the_same_seed_gives_the_same_samples_and_another_seed_others(limits: Limits) -> None:
    def run(seed: int) -> list[str]:
        servo = SimServo(SimParameters(), seed=seed, clock=VirtualClock())
        servo.arm(limits)
        return [repr(sample) for sample in driven(servo, torque(1e-3), 300)]

    assert run(7) == run(7)
    assert run(7) != run(8)


def test_looking_at_the_truth_changes_no_sample(limits: Limits) -> None:
    plain, watched = opened(SimParameters()), opened(SimParameters())
    for servo in (plain, watched):
        servo.arm(limits)
    for _ in range(100):
        left = driven(plain, torque(1e-3), 1)
        right = driven(watched, torque(1e-3), 1)
        watched.true_state()
        assert left[0].motor_position == pytest.approx(right[0].motor_position, abs=1e-6, nan_ok=True)


def test_a_torque_set_point_becomes_that_torque(frictionless: SimParameters, limits: Limits) -> None:
    servo = opened(frictionless)
    servo.arm(limits)
    driven(servo, torque(1.2e-3), 400)
    state = servo.true_state()
    assert state.motor_torque == pytest.approx(1.2e-3, rel=1e-6)
    assert state.coupling_torque == pytest.approx(4.0 * 1.2e-3, rel=1e-6)
    deflection = state.motor_position / 4.0 - state.joint_position
    assert deflection == pytest.approx(4.8e-3 / 17.75e-3, rel=1e-6)
    assert state.joint_position == pytest.approx(4.8e-3 / 20.0, rel=1e-6)


@pytest.mark.parametrize(("asked", "range_", "held"), [(1.0, 3.0, 1.0), (2.0, 0.5, 0.5)])
def test_a_position_or_the_end_of_the_range_is_reached_and_held(
    limits: Limits, asked: float, range_: float, held: float
) -> None:
    servo = opened(SimParameters())
    servo.arm(replace(limits, position=(-range_, range_)))
    driven(servo, Command(Quantity.POSITION, asked), 500)
    assert servo.true_state().motor_position == pytest.approx(held, abs=3e-3)


@pytest.mark.parametrize(("asked", "limit", "drive"), [(9e-3, 2e-3, 5e-3), (4e-3, 6e-3, 2e-3)])
def test_the_lower_of_the_two_torque_limits_acts_and_the_sample_says_so(
    frictionless: SimParameters, limits: Limits, asked: float, limit: float, drive: float
) -> None:
    servo = opened(replace(frictionless, drive=replace(frictionless.drive, torque_limit=drive)))
    servo.arm(replace(limits, torque=limit))
    samples = driven(servo, torque(asked), 20)
    assert servo.true_state().torque_demand == pytest.approx(min(limit, drive))
    assert all(Status.SATURATED in sample.status for sample in samples[2:])
    samples = driven(servo, torque(1e-3), 20)
    assert not any(sample.status for sample in samples[2:])


def test_arming_refuses_a_torque_limit_no_count_can_say(limits: Limits) -> None:
    with pytest.raises(DriverError, match="one count"):
        opened(SimParameters()).arm(replace(limits, torque=1e-6))


@pytest.mark.parametrize("end", ["disarm", "close"])
def test_stopping_leaves_no_torque_in_the_plant(frictionless: SimParameters, limits: Limits, end: str) -> None:
    servo = opened(frictionless)
    servo.arm(limits)
    driven(servo, torque(2e-3), 100)
    assert servo.true_state().motor_torque > 1e-3
    getattr(servo, end)()
    assert servo.true_state().motor_torque == 0.0
    servo.clock.sleep_until(servo.clock.now() + 2.0)
    state = servo.true_state()
    assert (state.motor_torque, state.torque_demand, state.enabled) == (0.0, 0.0, False)
    assert abs(state.motor_position) < 1e-6


def test_a_set_point_under_way_does_not_outlive_disarming(quiet: SimParameters, limits: Limits) -> None:
    servo = opened(replace(quiet, drive=replace(quiet.drive, command_delay=0.02)))
    servo.arm(limits)
    servo.exchange(torque(2e-3))
    servo.disarm()
    servo.arm(limits)
    servo.clock.sleep_until(0.05)
    assert servo.true_state().motor_torque == 0.0


def test_a_host_that_falls_silent_loses_the_torque_by_the_drives_own_watchdog(limits: Limits) -> None:
    servo = opened(SimParameters())
    servo.arm(limits)
    driven(servo, torque(2e-3), 10)
    servo.clock.sleep_until(servo.clock.now() + 0.09)
    assert servo.true_state().enabled
    servo.clock.sleep_until(servo.clock.now() + 0.02)
    state = servo.true_state()
    assert (state.motor_torque, state.enabled) == (0.0, False)
    with pytest.raises(DeviceFault, match="no set-point came in time") as caught:
        servo.exchange(torque(2e-3))
    assert caught.value.code == FaultCode.WATCHDOG
    with pytest.raises(DeviceFault):
        servo.arm(limits)
    servo.close()


def test_a_disarmed_servo_may_be_left_alone(limits: Limits) -> None:
    servo = opened(SimParameters())
    servo.clock.sleep_until(5.0)
    servo.arm(limits)
    assert math.isfinite(servo.exchange(Command.rest()).motor_position)


@pytest.mark.parametrize(
    ("velocity", "temperature", "code"),
    [(5.0, 80.0, FaultCode.OVER_VELOCITY), (400.0, 23.5, FaultCode.OVER_TEMPERATURE)],
)
def test_too_fast_or_too_hot_turns_the_torque_off_and_latches(
    limits: Limits, velocity: float, temperature: float, code: FaultCode
) -> None:
    servo = opened(SimParameters())
    servo.arm(replace(limits, velocity=velocity, temperature=temperature))
    with pytest.raises(DeviceFault) as caught:
        driven(servo, torque(3.5e-3), 5000)
    assert caught.value.code == code
    assert servo.true_state().motor_torque == 0.0
    servo.disarm()
    with pytest.raises(DeviceFault):
        servo.exchange(Command.rest())


class HastyClock:
    """Time that passes by itself: every look at it costs 50 us."""

    def __init__(self) -> None:
        self._t = 1e5

    def now(self) -> float:
        self._t += 5e-5
        return self._t

    def sleep_until(self, t: float) -> None:
        self._t = max(self._t, t) + 1e-4


def test_the_plant_keeps_up_with_a_clock_that_does_not_wait(frictionless: SimParameters, limits: Limits) -> None:
    servo = opened(frictionless, HastyClock())
    servo.arm(limits)
    samples = driven(servo, torque(1e-3), 500)
    assert samples[0].t > 1e5
    assert servo.true_state().t == pytest.approx(servo.clock.now(), abs=1e-3)
    assert servo.true_state().coupling_torque == pytest.approx(4e-3, rel=1e-6)


def test_it_runs_on_the_machines_own_clock(limits: Limits) -> None:
    clock = MonotonicClock()
    before = clock.now()
    servo = opened(SimParameters(), clock)
    servo.arm(limits)
    sample = servo.exchange(torque(1e-3))
    assert before <= sample.t < sample.t_read <= clock.now()
    servo.close()


def test_the_truth_is_what_the_plant_was_given() -> None:
    base = SimParameters()
    parameters = replace(base, coupling=replace(base.coupling, stiffness=0.5, gap=0.01))
    truth = opened(parameters.resolved(gear_ratio=7.0, motor_inertia=3e-6)).truth()
    assert (truth["Kc"], truth["Bc"], truth["gap"]) == (0.5, 0.19e-3, 0.01)
    assert (truth["gear_ratio"], truth["motor_inertia"], truth["motor_damping"]) == (7.0, 3e-6, 1e-7)
    assert all(math.isfinite(value) for value in truth.values())


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="seed -1"):
        SimServo(SimParameters(), seed=-1, clock=VirtualClock())


def test_delays_beyond_what_is_remembered_are_an_error_not_a_wrong_value(quiet: SimParameters, limits: Limits) -> None:
    rigid = replace(quiet.fixture, stiffness=1e6)
    servo = opened(replace(quiet, fixture=rigid, sensors=replace(quiet.sensors, joint_torque_delay=0.02)))
    servo.arm(limits)
    with pytest.raises(DriverError, match="cannot be computed"):
        driven(servo, torque(1e-3), 50)
