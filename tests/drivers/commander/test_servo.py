"""A SimpleFOC board over its emulator: what is sent, what is made of the replies, and everything that can go wrong."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import pytest

from drivers.clock import VirtualClock
from drivers.commander.lines import RESOLUTION, same, state, target
from drivers.commander.servo import CommanderServo
from drivers.servo import BadReply, Command, DriverError, Limits, NoReply, Quantity
from sim_backend.wire.commander.device import number
from sim_backend.wire.commander.emulator import CommanderTiming
from sim_backend.wire.faults import (
    CorruptReplies,
    DropReplies,
    DuplicateReplies,
    NoiseBefore,
    TruncateReplies,
)
from sim_backend.wire.loadcell.emulator import EmulatedLoadCell

from ...loopback import SerialLoopback

Rig = Any
Make = Callable[..., Rig]
KT = 0.0145
LIMITS = Limits(torque=4e-3, velocity=400.0, temperature=80.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 2e-3)


@pytest.fixture
def foc(make_foc: Make) -> Rig:
    return make_foc()


def armed(rig: Rig, **changes: Any) -> CommanderServo:
    servo: CommanderServo = rig.armed(LIMITS, **changes)
    rig.wait(4e-3)
    servo.exchange(PUSH)
    return servo


def drive_on(rig: Rig, servo: CommanderServo, ticks: int) -> None:
    """Go on as a recorder does, until something ends it."""
    for _ in range(ticks):
        rig.wait(4e-3)
        with contextlib.suppress(NoReply, BadReply):
            servo.exchange(PUSH)


def off(rig: Rig) -> bool:
    """Whether no current can flow, nor would by enabling it."""
    return not rig.bus.motor.enabled and rig.bus.motor.law.target == 0.0


# -- what is sent and read ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
def test_a_torque_arrives_as_current_and_the_state_comes_back_in_si(foc: Rig, sign: int) -> None:
    servo = armed(foc, sign=sign)
    for _ in range(100):
        foc.wait(4e-3)
        sample = servo.exchange(PUSH)
    motor = foc.bus.motor
    assert motor.law.target == pytest.approx(sign * 2e-3 / KT, abs=2 * RESOLUTION)
    assert sample.motor_torque == pytest.approx(2e-3, abs=KT * 1e-3)
    assert sample.motor_position == pytest.approx(sign * motor.law.angle(motor), abs=2e-3)
    assert sample.motor_position > 0.1


def test_the_limits_reach_the_board(foc: Rig) -> None:
    armed(foc)
    assert foc.bus.motor.law.current_limit == pytest.approx(4e-3 / KT, rel=1e-4)
    assert foc.bus.motor.law.current_limit <= 4e-3 / KT
    assert foc.bus.motor.law.velocity_limit == 400.0
    assert foc.bus.device.torque_type == 2


@pytest.mark.parametrize("firmware", ["2.3", "2.4"])
def test_a_target_is_bounded_here_whether_or_not_the_library_does(make_foc: Make, firmware: str) -> None:
    rig = make_foc(firmware=firmware)
    servo = armed(rig)
    servo.exchange(Command(Quantity.TORQUE, -1.0))
    assert -4e-3 / KT <= rig.bus.motor.law.target == pytest.approx(-4e-3 / KT, abs=3 * RESOLUTION)


def test_a_target_left_over_from_another_mode_never_becomes_a_torque(foc: Rig) -> None:
    motor = foc.bus.motor
    motor.law.mode, motor.law.target = 2, 3.0  # 3 rad would be 3 A
    foc.bus.device.restart = lambda: None
    servo = foc.open()
    assert off(foc)
    servo.arm(LIMITS)
    assert motor.law.target == 0.0


def test_a_tick_is_one_round_trip_of_the_length_it_is_reckoned_with(foc: Rig) -> None:
    servo = armed(foc)
    foc.wait(0.01)
    foc.port.sent.clear()
    before = foc.clock.now()
    servo.exchange(PUSH)
    assert bytes(foc.port.sent).split(b"\n")[1:] == [b"MMG7", b"ME", b""]
    wire = 10.0 * (len(foc.port.sent) + 90) / 1_000_000
    assert foc.clock.now() - before < wire + CommanderTiming().usb_latency + 3 * CommanderTiming().loop + 2e-3


@pytest.mark.parametrize("current", [0.0, 1e-5, 0.137, -0.137, 12.34567, -39.9999])
def test_a_target_identifies_its_request_and_survives_the_boards_arithmetic(current: float) -> None:
    sent = [target(current, count) for count in range(10)]
    assert len(set(sent)) == 10
    for text in sent:
        assert abs(float(text) - current) <= RESOLUTION
        assert len(f"M{text}\n") <= 20
        assert [other for other in sent if same(other, float(f"{number(text):.5f}"))] == [text]


@pytest.mark.parametrize(
    "text",
    ["0.00000", "0.00000;" * 6, "0.00000;" * 7, "0.000;" * 6 + "0.000", "nan;" + "0.00000;" * 5 + "0.00000", "err", ""],
)
def test_what_is_not_seven_whole_numbers_is_no_state(text: str) -> None:
    assert state(text) is None


# -- the line -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fault", [DuplicateReplies(count=9), NoiseBefore(count=9, noise=b"\xffMOT: junk\r\nME0.5\n\r")]
)
def test_junk_and_doubled_lines_cost_nothing(foc: Rig, fault: Any) -> None:
    servo = armed(foc)
    foc.bus.faults.inject(fault)
    for _ in range(10):
        foc.wait(4e-3)
        assert servo.exchange(PUSH).motor_position >= 0.0


def test_a_digit_lost_on_the_way_to_the_board_is_put_right_within_the_tick(foc: Rig) -> None:
    servo = armed(foc)
    foc.wait(4e-3)
    foc.bus.garble("M0.1", "M1")  # ten times the current
    with pytest.raises(BadReply):
        servo.exchange(PUSH)
    assert foc.bus.motor.law.target == pytest.approx(2e-3 / KT, abs=2 * RESOLUTION)
    foc.wait(4e-3)
    servo.exchange(PUSH)


def test_a_restart_between_two_runs_does_not_leave_the_motor_on(foc: Rig) -> None:
    servo = foc.open()
    foc.bus.reboot(foc.clock.now())
    foc.wait(4.0)
    printer = foc.bus.device.printer  # of a program that prints like this by itself
    printer.verbose, printer.decimals = 3, 5
    assert foc.bus.motor.enabled
    servo.exchange(Command.rest())
    assert off(foc)


@pytest.mark.parametrize("damage", [CorruptReplies(), TruncateReplies(keep=7)])
def test_a_damaged_reply_about_the_format_is_a_gap_and_no_restart(foc: Rig, damage: Any) -> None:
    servo = armed(foc)
    foc.bus.faults.inject(DropReplies(count=3))
    foc.wait(4e-3)
    with pytest.raises(NoReply):
        servo.exchange(PUSH)  # so that the board is asked for its format next
    foc.bus.faults.clear()
    foc.bus.faults.inject(damage)
    foc.wait(4e-3)
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    foc.wait(4e-3)
    assert servo.exchange(PUSH).motor_torque > 0.0


# -- opening and arming ---------------------------------------------------------------------------------------------


def test_a_board_that_is_still_booting_is_waited_for(foc: Rig) -> None:
    foc.bus.reboot(0.0)
    servo = foc.open()
    assert foc.clock.now() > CommanderTiming().boot
    assert off(foc)
    assert servo.exchange(Command.rest()).motor_torque == 0.0


def test_the_wrong_baud_rate_and_silence_are_distinguished(make_foc: Make) -> None:
    rig = make_foc(baudrate=115200)
    rig.port = SerialLoopback(rig.bus, rig.clock, 1_000_000)
    with pytest.raises(BadReply, match="no Commander"):
        rig.open(baudrate=1_000_000)
    assert rig.port.closed
    silent = make_foc()
    silent.bus.faults.inject(DropReplies(count=10_000))
    with pytest.raises(NoReply, match="nothing answers on loopback at 1000000 baud"):
        silent.open()
    assert off(silent)


def test_another_device_at_the_port_is_named_by_its_output(foc: Rig) -> None:
    clock = VirtualClock()
    foc.clock, foc.port = clock, SerialLoopback(EmulatedLoadCell(), clock)
    with pytest.raises(BadReply, match=r"no Commander of SimpleFOC 2.2 or later \('\d+,84000'\)"):
        foc.open()


def test_a_motor_under_another_letter_is_reported_with_the_letters_of_the_board(foc: Rig) -> None:
    with pytest.raises(DriverError, match="no motor 'A' that can be read: it has M:motor"):
        foc.open(motor="A")


def test_a_board_that_streams_is_made_to_stop_even_after_a_restart(foc: Rig) -> None:
    foc.bus.device.program_downsample = foc.bus.device.downsample = 10
    servo = armed(foc)
    drive_on(foc, servo, 3)
    assert foc.bus.device.watched == "0000000"
    foc.bus.reboot(foc.clock.now())
    foc.wait(4.0)
    servo.disarm()
    assert off(foc)
