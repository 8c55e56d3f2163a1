"""The rules of `drivers/servo.py`, held against every servo the fixture `bench` gives: simulated or on a wire."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest

from drivers.servo import Command, DriverError, Limits, LinkLost, NoReply, Quantity, Sample, Status, UnsafeCommand

if TYPE_CHECKING:
    from drivers.servo import Servo

PERIOD = 0.004


@pytest.fixture
def servo(bench: tuple[Servo, Limits]) -> Servo:
    return bench[0]


@pytest.fixture
def limits(bench: tuple[Servo, Limits]) -> Limits:
    return bench[1]


def ask(servo: Servo, command: Command, tries: int = 5) -> Sample:
    """The next sample that arrives; a lost reply is not an offence."""
    for _ in range(tries - 1):
        servo.clock.sleep_until(servo.clock.now() + PERIOD)
        try:
            return servo.exchange(command)
        except NoReply:
            continue
    return servo.exchange(command)


def push(servo: Servo, limits: Limits, share: float) -> Command:
    """A set-point of a share of the limit: a torque, or a position where the servo takes no torque."""
    if Quantity.TORQUE in servo.info.quantities:
        return Command(Quantity.TORQUE, share * limits.torque)
    low, high = limits.position
    return Command(Quantity.POSITION, 0.5 * (low + high) + share * 0.5 * (high - low))


def test_it_reports_its_identity_and_the_quantities_it_supports(servo: Servo) -> None:
    assert servo.info.backend
    assert servo.info.model
    assert servo.info.quantities


def test_a_disarmed_servo_is_read_and_not_driven(servo: Servo) -> None:
    first = ask(servo, Command.rest())
    for _ in range(10):
        last = ask(servo, Command.rest())
    assert math.isfinite(last.motor_position)
    assert last.motor_position == pytest.approx(first.motor_position, abs=0.01)


def test_a_disarmed_servo_refuses_every_set_point_but_rest(servo: Servo) -> None:
    for command in (Command(Quantity.TORQUE, 1e-4), Command(Quantity.POSITION, 0.0), Command(Quantity.POSITION, 0.1)):
        with pytest.raises(UnsafeCommand):
            servo.exchange(command)


def test_a_set_point_that_is_no_number_is_refused_and_moves_nothing(servo: Servo, limits: Limits) -> None:
    wrong = [Command(quantity, value) for quantity in Quantity for value in (math.nan, math.inf, -math.inf)]
    for command in wrong:
        with pytest.raises(UnsafeCommand):
            servo.exchange(command)
    servo.arm(limits)
    before = ask(servo, Command.rest())
    for command in wrong:
        with pytest.raises(UnsafeCommand):
            servo.exchange(command)
    after = ask(servo, Command.rest())
    assert after.motor_position == pytest.approx(before.motor_position, abs=0.01)


def test_samples_never_go_back_in_time_and_are_read_after_their_request(servo: Servo, limits: Limits) -> None:
    servo.arm(limits)
    samples = [ask(servo, Command.rest()) for _ in range(20)]
    for earlier, later in pairwise(samples):
        assert earlier.t < later.t
        assert earlier.t_read < later.t_read
    for sample in samples:
        assert sample.t <= sample.t_read <= servo.clock.now()


def test_arming_drives_nothing_until_a_set_point_does(servo: Servo, limits: Limits) -> None:
    before = ask(servo, Command.rest())
    servo.arm(limits)
    for _ in range(10):
        after = ask(servo, Command.rest())
    assert after.motor_position == pytest.approx(before.motor_position, abs=0.01)


def test_a_positive_set_point_turns_the_motor_forwards(servo: Servo, limits: Limits) -> None:
    servo.arm(limits)
    before = ask(servo, Command.rest())
    for _ in range(10):
        after = ask(servo, push(servo, limits, 0.25))
    assert after.motor_position > before.motor_position
    assert not after.motor_torque <= 0.0  # NaN where the servo reports none


def test_a_set_point_beyond_the_limit_is_clamped_to_it(servo: Servo, limits: Limits) -> None:
    servo.arm(limits)
    samples = [ask(servo, push(servo, limits, 10.0)) for _ in range(5)]
    assert not max(sample.motor_torque for sample in samples) > 1.1 * limits.torque
    if Quantity.TORQUE not in servo.info.quantities:
        assert max(sample.motor_position for sample in samples) < limits.position[1] + 0.1


def test_torque_off_twice_is_harmless_and_the_servo_can_be_armed_again(servo: Servo, limits: Limits) -> None:
    servo.disarm()
    servo.arm(limits)
    ask(servo, push(servo, limits, 0.25))
    servo.disarm()
    servo.disarm()
    with pytest.raises(UnsafeCommand):
        servo.exchange(push(servo, limits, 0.25))
    servo.arm(limits)
    ask(servo, push(servo, limits, 0.25))


def test_closing_twice_is_harmless_whatever_came_before(servo: Servo, limits: Limits) -> None:
    servo.arm(limits)
    ask(servo, push(servo, limits, 0.25))
    servo.close()
    servo.close()
    servo.disarm()


def test_a_closed_servo_neither_arms_nor_answers(servo: Servo, limits: Limits) -> None:
    servo.close()
    with pytest.raises(DriverError):
        servo.arm(limits)
    with pytest.raises(DriverError):
        servo.exchange(Command.rest())


def test_a_set_point_that_a_limit_changed_is_marked_and_another_is_not(servo: Servo, limits: Limits) -> None:
    servo.arm(limits)
    assert ask(servo, push(servo, limits, 10.0)).status & Status.SATURATED
    ask(servo, Command.rest())
    assert not ask(servo, push(servo, limits, 0.5)).status & Status.SATURATED


# -- the gate, seen on the wire (`wired`: conftest.py) --------------------------------------------------------------


def refused(wired: Any, command: Command) -> None:
    before = wired.sent()
    with pytest.raises(UnsafeCommand):
        wired.servo.exchange(command)
    assert wired.sent() == before


def test_nothing_is_sent_for_a_set_point_that_is_refused(wired: Any) -> None:
    for quantity in Quantity:
        refused(wired, Command(quantity, 0.1))  # disarmed
    wired.servo.arm(wired.limits)
    for quantity in Quantity:
        for value in (math.nan, math.inf, -math.inf):
            refused(wired, Command(quantity, value))
        if quantity not in wired.servo.info.quantities:
            refused(wired, Command(quantity, 0.1))


def test_no_current_can_flow_before_arming_and_after_disarming_and_closing(wired: Any) -> None:
    assert not wired.live()
    for end in (wired.servo.disarm, wired.servo.close):
        wired.servo.arm(wired.limits)
        ask(wired.servo, push(wired.servo, wired.limits, 0.25))
        assert wired.live()
        end()
        assert not wired.live()


def test_nothing_is_sent_after_closing(wired: Any) -> None:
    wired.servo.close()
    before = wired.sent()
    wired.servo.disarm()
    wired.servo.close()
    with pytest.raises(LinkLost):
        wired.servo.arm(wired.limits)
    with pytest.raises(LinkLost):
        wired.servo.exchange(Command.rest())
    assert wired.sent() == before


def test_a_lost_link_ends_the_run_and_torque_off_may_be_requested_until_it_is_confirmed(wired: Any) -> None:
    wired.servo.arm(wired.limits)
    ask(wired.servo, push(wired.servo, wired.limits, 0.25))
    wired.unplug(True)
    with pytest.raises(LinkLost):
        wired.servo.exchange(push(wired.servo, wired.limits, 0.25))
    for _ in range(2):
        with pytest.raises(LinkLost, match="not confirmed"):
            wired.servo.disarm()
    wired.unplug(False)
    wired.servo.disarm()
    assert not wired.live()
    with pytest.raises(UnsafeCommand):
        wired.servo.exchange(push(wired.servo, wired.limits, 0.25))


def test_a_device_that_an_earlier_program_left_armed_has_no_torque_once_it_is_opened(wired: Any) -> None:
    wired.servo.arm(wired.limits)
    ask(wired.servo, push(wired.servo, wired.limits, 0.25))
    again = wired.reopen()
    assert not wired.live()
    again.close()


def test_a_limit_below_what_the_device_resolves_is_refused_without_torque(wired: Any) -> None:
    tiny = Limits(1e-9, wired.limits.velocity, wired.limits.temperature, wired.limits.position)
    try:
        wired.servo.arm(tiny)
    except DriverError:
        assert not wired.live()
        with pytest.raises(UnsafeCommand):
            wired.servo.exchange(push(wired.servo, tiny, 0.1))
    else:  # a drive whose limits are floats takes it
        ask(wired.servo, push(wired.servo, wired.limits, 1.0))


MEASURES_NO_TEMPERATURE = {"odrive 0.5.6", "cia402 epos2", "cia402 generic", "commander", "commander with a loadcell"}


def test_temperature_and_voltage_come_with_the_ticks(wired: Any, request: pytest.FixtureRequest) -> None:
    name = request.node.callspec.params["wired"]
    wired.device.motor.warm_to(41.5)
    for _ in range(40):
        wired.wait(2e-3)
        sample = ask(wired.servo, Command.rest())
    if name in MEASURES_NO_TEMPERATURE:
        assert math.isnan(sample.temperature)
    else:
        assert sample.temperature == pytest.approx(41.5, abs=1.0)
    assert sample.voltage == pytest.approx(24.0) or name not in {"odrive 0.6.10", "cia402 epos4"}
