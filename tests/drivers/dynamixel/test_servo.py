"""What reaches the servo and what comes back, held against the emulated servo's own registers and plant."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.dynamixel.models import POSITION_LSB, VELOCITY_LSB, models
from drivers.servo import Command, Limits, Quantity, Status, UnsafeCommand
from drivers.tick import WRAP, Freshness, TickClock
from sim_backend.wire.dynamixel.tables import MODELS

from ..conftest import drive, position, torque

Rig = Any
Make = Callable[..., Rig]


QUICK = {"mx-64", "mx-64-2", "xl330-m288", "xl430-w250"}  # both protocols, with and without a sensor of current


@pytest.mark.parametrize(
    "model", [pytest.param(one, marks=() if one in QUICK else pytest.mark.study) for one in sorted(models())]
)
def test_every_model_is_opened_armed_driven_and_closed(make_rig: Make, limits: Limits, model: str) -> None:
    rig = make_rig(model)
    servo = rig.open()
    (quantity,) = servo.info.quantities
    generous = Limits(torque=0.5, velocity=3.0, temperature=60.0, position=limits.position)
    servo.arm(generous)
    assert rig.device.motor.enabled
    last = drive(rig, servo, Command(quantity, 0.02))
    assert last.motor_position > 0.0
    servo.close()
    assert not rig.device.motor.enabled
    assert rig.port.closed


def test_driver_and_emulator_agree_about_each_servo() -> None:
    for model, theirs in MODELS.items():
        ours, items = models()[model], {item.name: item for item in theirs.items}
        assert (ours.number, ours.current_lsb) == (theirs.number, theirs.current_lsb), model
        assert ours.velocity_max == items["velocity_limit"].high, model
        assert ours.temperature_max == items["temperature_limit"].initial, model
        if ours.current_lsb:
            assert ours.current_max == items["current_limit"].high, model
            assert theirs.stall in ours.stall, model


@pytest.mark.parametrize(("model", "printed"), [("xm540-w270", 2.378), ("xm540-w150", 1.640)])
def test_the_torque_constant_is_what_the_manual_prints_where_it_prints_one(model: str, printed: float) -> None:
    assert models()[model].torque_constant == pytest.approx(printed, rel=1e-3)


def test_samples_in_si_agree_with_the_plant(rig: Rig, limits: Limits) -> None:
    servo = rig.armed(limits)
    last = drive(rig, servo, torque(0.01), ticks=60)
    motor = rig.device.motor
    assert last.motor_position == pytest.approx(motor.position, abs=5 * POSITION_LSB)
    assert last.motor_velocity == pytest.approx(motor.velocity, abs=VELOCITY_LSB)
    # the constant of the pages' stall points is the mean of three; the emulator's is one of them
    scale = models()["xl330-m288"].torque_constant / motor.law.torque_constant
    assert last.motor_torque == pytest.approx(scale * motor.torque, abs=servo.info.torque_lsb)
    assert last.temperature == pytest.approx(motor.temperature, abs=1.0)
    assert last.voltage == pytest.approx(5.0)


def test_a_torque_set_point_reaches_the_motor_to_half_a_count(rig: Rig, limits: Limits) -> None:
    servo = rig.armed(limits, torque_constant=0.52 / 1.47)
    for value in (0.0101, -0.0203):
        drive(rig, servo, torque(value))
        assert rig.device.motor.torque == pytest.approx(value, abs=0.51 * servo.info.torque_lsb)


def test_the_sign_turns_position_velocity_torque_and_set_point_round(rig: Rig, limits: Limits) -> None:
    servo = rig.armed(limits, sign=-1)
    last = drive(rig, servo, torque(0.01), ticks=8)
    assert rig.device.motor.position < 0.0
    assert min(last.motor_position, last.motor_velocity, last.motor_torque) > 0.0


def test_negative_values_come_back_negative(rig: Rig, limits: Limits) -> None:
    servo = rig.armed(limits)
    last = drive(rig, servo, torque(-0.01), ticks=8)
    assert max(last.motor_position, last.motor_velocity, last.motor_torque) < 0.0


def test_the_limits_are_in_the_servo_before_current_flows_and_gone_after_close(rig: Rig, limits: Limits) -> None:
    registers = rig.device.registers
    before = bytes(registers.memory[:64])
    servo = rig.armed(limits)
    assert registers.get("current_limit") == math.floor(0.03 / servo.info.torque_lsb)
    assert registers.get("temperature_limit") == 65
    assert registers.get("velocity_limit") == math.floor(40.0 / VELOCITY_LSB)
    assert registers.get("return_delay_time") == 0
    assert registers.get("bus_watchdog") == 5
    assert registers.get("operating_mode") == 0
    servo.close()
    assert bytes(registers.memory[:64]) == before
    assert registers.get("bus_watchdog") == 0


def test_a_limit_above_what_the_servo_can_do_is_never_written(rig: Rig) -> None:
    rig.armed(Limits(torque=50.0, velocity=1e4, temperature=200.0, position=(-1.0, 1.0)))
    registers = rig.device.registers
    assert [registers.get(f"{n}_limit") for n in ("current", "velocity", "temperature")] == [1750, 2047, 70]


def test_arming_sends_no_current_though_a_change_of_mode_sets_the_goal_to_the_limit(rig: Rig, limits: Limits) -> None:
    servo = rig.open()
    rest = rig.device.motor.position
    servo.arm(limits)
    rig.wait(0.05)
    assert rig.device.motor.enabled
    assert rig.device.motor.torque == 0.0
    assert rig.device.motor.position == rest


@pytest.mark.parametrize("mode", ["extended-position", "current-based-position"])
def test_position_modes_arm_without_a_jerk_and_follow(rig: Rig, limits: Limits, mode: str) -> None:
    servo = rig.open(mode=mode)
    rig.device.registers.put("goal_position", 3000)  # left by another program
    servo.arm(limits)
    assert drive(rig, servo, Command.rest()).motor_position == pytest.approx(0.0, abs=2 * POSITION_LSB)
    last = drive(rig, servo, position(-0.3), ticks=200)
    assert last.motor_position == pytest.approx(-0.3, abs=3 * POSITION_LSB)
    with pytest.raises(UnsafeCommand, match=r"dynamixel\.mode"):
        servo.exchange(torque(0.01))


def test_the_torque_limit_acts_in_current_based_position_mode(rig: Rig) -> None:
    servo = rig.armed(
        Limits(torque=3e-3, velocity=40.0, temperature=65.0, position=(-3.0, 3.0)),
        mode="current-based-position",
        torque_constant=0.52 / 1.47,
    )
    peak = 0.0
    for _ in range(200):
        drive(rig, servo, position(1.5), ticks=1)
        peak = max(peak, abs(rig.device.motor.torque))
    assert 2.5e-3 < peak <= 3e-3
    assert rig.device.motor.position < 0.3


def test_a_servo_without_current_measurement_reports_nan(make_rig: Make, limits: Limits) -> None:
    servo = make_rig("xl430-w250").open()
    assert servo.info.quantities == {Quantity.POSITION}
    assert math.isnan(servo.info.torque_lsb)
    servo.arm(limits)
    assert math.isnan(servo.exchange(position(0.0)).motor_torque)


def test_one_tick_is_one_round_trip(rig: Rig, limits: Limits) -> None:
    servo = rig.armed(limits)
    for _ in range(5):
        before, begin = len(rig.port.sent), rig.clock.now()
        servo.exchange(torque(0.001))
        # 31 bytes out, 38 back, 1 ms in the adapter, and no return delay
        assert len(rig.port.sent) - before == 31
        assert rig.clock.now() - begin == pytest.approx(69 * 10e-6 + 1e-3, abs=2e-4)


def test_a_tick_that_has_not_moved_makes_the_sample_stale(make_rig: Make, limits: Limits) -> None:
    rig = make_rig(baudrate=4_000_000)
    rig.bus._timing = None  # a line so fast that two samples fall into one millisecond of the servo's clock
    servo = rig.armed(limits)
    rig.wait(0.0015)
    statuses = [servo.exchange(torque(0.001)).status for _ in range(3)]
    assert statuses[-1] & Status.STALE


def test_the_servos_clock_is_unwrapped_over_the_end_of_its_count(rig: Rig) -> None:
    servo = rig.open()
    samples = []
    for _ in range(80):
        rig.wait(1.0)
        sample = servo.exchange(Command.rest())
        assert not sample.status
        samples.append((sample.t, servo._tick.seconds))
    (t0, d0), (t1, d1) = samples[0], samples[-1]
    assert d1 - d0 == pytest.approx(t1 - t0, abs=3e-3)
    assert d1 > 2.0 * WRAP * 1e-3


def test_the_clock_survives_a_pause_longer_than_its_count() -> None:
    clock = TickClock()
    clock.judge(100, 0.0, 0.001)
    assert clock.judge((100 + 100_000) % WRAP, 100.0, 100.001) is Freshness.FRESH
    assert clock.seconds == pytest.approx(100.0)


def test_a_reply_from_before_its_request_is_impossible() -> None:
    clock = TickClock()
    clock.judge(1000, 1.0, 1.001)
    assert clock.judge(1010, 1.05, 1.051) is Freshness.IMPOSSIBLE
    assert clock.judge(990, 1.05, 1.051) is Freshness.IMPOSSIBLE
    assert clock.judge(1050, 1.05, 1.051) is Freshness.FRESH


def test_the_page_on_it_shows_the_torque_constants_that_are_used() -> None:
    page = (Path(__file__).parents[3] / "docs" / "dynamixel.md").read_text(encoding="utf-8")
    for name, model in models().items():
        if model.current_lsb:
            assert f"| {name} | {model.torque_constant:.3f} | {model.torque_uncertainty:.0%} |" in page


def test_a_homing_offset_that_position_control_mode_ignores_moves_no_angle_when_the_servo_is_armed(
    rig: Rig, limits: Limits
) -> None:
    rig.device.registers.put("homing_offset", 2000)
    servo = rig.open()
    before = servo.exchange(Command.rest()).motor_position
    servo.arm(limits)
    assert servo.exchange(Command.rest()).motor_position == before
    servo.close()
    assert rig.device.registers.get("operating_mode") == 3
