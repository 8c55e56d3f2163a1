"""A Feetech servo through the adapter: position mode, current mode, limits, what it refuses, and what it cannot do."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from drivers.feetech.config import FeetechConfig
from drivers.feetech.identity import search
from drivers.feetech.models import models
from drivers.servo import Command, DeviceFault, DriverError, Limits, Quantity, Status
from hil.cli.app import run
from hil.doctor.checks import CheckList
from hil.doctor.examine import examine
from hil.stand.file import parse
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.packets.frames import Framer, Instruction
from sim_backend.wire.packets.frames_1 import take_packet_1, writes_1

from ..conftest import drive, position, torque

Make = Callable[..., Any]
LIMITS = Limits(torque=0.4, velocity=30.0, temperature=60.0, position=(-20.0, 20.0))
COUNT = math.tau / 4096.0
TORQUE_ENABLE = 40


def written(sent: bytes) -> list[tuple[int, bytes]]:
    """Address and data of each write among the requests in `sent`."""
    found = []
    for frame, _ in Framer(take_packet_1).feed(bytes(sent)):
        if frame.instruction == Instruction.WRITE:
            found.append((frame.parameters[0], frame.parameters[1:]))
        elif frame.instruction == Instruction.SYNC_WRITE:
            found += [(address, data) for _, address, data in writes_1(frame)]
    return found


@pytest.mark.parametrize("model", ["sts3215", "sts3250", "hls3930m", "scs0009"])
def test_position_mode_arms_without_a_jerk_and_follows(make_feetech: Make, model: str) -> None:
    rig = make_feetech(model)
    servo = rig.open(mode="position")
    before = drive(rig, servo, Command.rest()).motor_position
    limits = Limits(0.2, 30.0, 60.0, (before - 1.0, before + 1.0))
    servo.arm(limits)
    assert drive(rig, servo, Command.rest()).motor_position == pytest.approx(before, abs=1e-9)
    after = drive(rig, servo, position(before + 0.3), ticks=200).motor_position
    assert after == pytest.approx(before + 0.3, abs=3 * servo.info.position_lsb)
    servo.close()
    assert not rig.motor.enabled


def test_samples_in_si_agree_with_the_plant(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    servo = rig.armed(LIMITS, torque_constant=2.94 / 2.7)
    last = drive(rig, servo, position(0.5), ticks=12)
    motor = rig.motor
    assert last.motor_position == pytest.approx(motor.position, abs=0.3)
    assert last.motor_position > 5 * COUNT
    assert last.motor_velocity == pytest.approx(motor.velocity, rel=0.3)
    assert last.motor_torque == pytest.approx(motor.torque, abs=0.1 * abs(motor.torque) + servo.info.torque_lsb)
    assert last.temperature == pytest.approx(motor.temperature, abs=1.0)
    assert last.voltage == pytest.approx(12.0)


def test_a_torque_set_point_of_an_hls_reaches_the_motor_to_half_a_count(make_feetech: Make) -> None:
    rig = make_feetech("hls3930m")
    servo = rig.armed(LIMITS, torque_constant=3.43 / 2.8)
    for value in (0.031, -0.052):
        last = drive(rig, servo, torque(value))
        assert rig.motor.torque == pytest.approx(value, abs=0.51 * servo.info.torque_lsb)
        assert last.motor_torque == pytest.approx(value, abs=0.51 * servo.info.torque_lsb)


def test_the_sign_turns_position_velocity_torque_and_set_point_round(make_feetech: Make) -> None:
    rig = make_feetech("hls3930m")
    servo = rig.armed(LIMITS, sign=-1)
    last = drive(rig, servo, torque(0.05), ticks=8)
    assert rig.motor.position < 0.0
    assert min(last.motor_position, last.motor_velocity, last.motor_torque) > 0.0


def test_a_position_that_wraps_within_a_turn_is_counted_on(make_feetech: Make) -> None:
    rig = make_feetech("hls3930m")
    servo = rig.armed(LIMITS)
    for value in (0.1, -0.1):
        seen = [drive(rig, servo, torque(value), ticks=1) for _ in range(200)]
        assert abs(seen[-1].motor_position) > math.pi  # beyond half a turn from the middle: the servo's own wraps
        assert seen[-1].motor_position == pytest.approx(rig.motor.position, abs=0.3)
        steps = [abs(b.motor_position - a.motor_position) for a, b in pairwise(seen)]
        assert max(steps) < math.pi


def test_a_goal_beyond_the_servos_own_limits_is_clipped_and_marked_and_multi_turn_reaches_it(
    make_feetech: Make,
) -> None:
    rig = make_feetech("sts3215")  # at 0, the lower end of its single turn
    servo = rig.armed(LIMITS)
    assert drive(rig, servo, position(-0.5)).status & Status.SATURATED
    assert rig.device.get("goal_position") == 0
    servo.disarm()
    for name, value in (("max_position_limit", 0), ("phase", 0x1C)):
        rig.device.put(name, value)
    servo.arm(LIMITS)
    last = drive(rig, servo, position(-0.5), ticks=200)
    assert not last.status & Status.SATURATED
    assert rig.device.get("goal_position") == round(-0.5 / COUNT)
    assert last.motor_position == pytest.approx(-0.5, abs=4 * COUNT)


def test_a_servo_outside_its_position_limits_is_not_switched_on_since_it_would_jump(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    rig.device.put("min_position_limit", 1000)
    servo = rig.open()
    with pytest.raises(DriverError, match=r"at 0, outside its position limits 1000 to 4095, and would jump"):
        servo.arm(LIMITS)
    assert not rig.motor.enabled


def test_the_limits_are_in_the_servo_before_current_flows_and_gone_after_close(make_feetech: Make) -> None:
    for model, name, counts in (("sts3215", "torque_limit", 136), ("hls3930m", "protection_current", 50)):
        rig = make_feetech(model)
        device = rig.device
        before, flash = {item.name: device.get(item.name) for item in device.model.items}, device.eeprom()
        servo = rig.armed(LIMITS)
        assert device.get(name) == counts
        assert device.get("temperature_limit") == 60
        unit = 1 if model == "sts3215" else 50  # steps/s
        assert device.get("goal_velocity") == math.floor(30.0 / (unit * COUNT))
        assert device.eeprom() == flash  # also in the run: the lock is on
        servo.close()
        changed = {key for key, value in before.items() if device.get(key) != value}
        assert changed <= {"lock", "goal_position", "present_voltage", "present_temperature", "present_position"}
        assert device.eeprom() == flash


def test_a_limit_above_what_the_servo_can_do_is_never_written(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    rig.open().arm(Limits(torque=50.0, velocity=1e4, temperature=200.0, position=(-1.0, 1.0)))
    values = [rig.device.get(name) for name in ("torque_limit", "goal_velocity", "temperature_limit")]
    assert values == [1000, 32767, 70]


@pytest.mark.parametrize("model", sorted(models()))
def test_nothing_but_0_and_1_is_ever_written_to_torque_enable(make_feetech: Make, model: str) -> None:
    rig = make_feetech(model)
    servo = rig.armed(LIMITS, torque_constant=None if model == "scs0009" else 1.0, mode="position")
    drive(rig, servo, Command.rest())
    rig.device.life.ignores_off = True
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    rig.device.life.ignores_off = False
    servo.close()
    values = {data for address, data in written(rig.port.sent) if address == TORQUE_ENABLE}
    assert values == {b"\x00", b"\x01"}
    assert not any(address < TORQUE_ENABLE < address + len(data) for address, data in written(rig.port.sent))


def test_a_torque_off_that_is_not_done_is_followed_by_a_torque_limit_of_zero_that_closing_leaves(
    make_feetech: Make,
) -> None:
    rig = make_feetech("sts3215")
    servo = rig.armed(LIMITS)
    drive(rig, servo, position(0.5), ticks=200)
    assert rig.motor.torque > 0.0
    rig.device.life.ignores_off = True
    servo.close()
    rig.wait(0.2)
    assert rig.device.get("torque_limit") == 0
    assert abs(rig.motor.torque) < 1e-6


def test_a_host_that_dies_leaves_the_servo_holding_within_its_torque_limit(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    servo = rig.open()
    assert (servo.info.watchdog, servo.info.watchdog_remedy) == (0.0, "")
    servo.arm(Limits(torque=0.006, velocity=30.0, temperature=60.0, position=(-3.0, 3.0)))
    drive(rig, servo, position(1.0))
    rig.wait(5.0)  # nobody asks any more
    assert rig.motor.enabled
    assert 0.0 < rig.motor.torque <= 0.006


@pytest.mark.study
def test_a_servo_left_alone_under_overload_reduces_its_torque_by_itself(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    rig.device.put("protective_torque", 1)  # %, where the factory sets 20, since the paper's joint is soft
    servo = rig.open()
    rig.device.write(TORQUE_ENABLE, b"\x80")
    servo.arm(LIMITS)
    drive(rig, servo, position(math.pi + 2.5), ticks=400)
    assert rig.motor.torque > 1.2 * 0.0294
    rig.device.fail(32)
    rig.wait(0.5)
    assert 0.0 < rig.motor.torque <= 0.0294 * 1.01


def test_without_a_torque_constant_an_sts_reports_no_torque(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    servo = rig.open(torque_constant=None)
    assert math.isnan(drive(rig, servo, Command.rest()).motor_torque)
    assert math.isnan(servo.info.torque_lsb)


def test_an_overload_in_the_run_is_a_fault_though_the_servo_goes_on_with_less(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    servo = rig.armed(LIMITS)
    rig.device.fail(32)
    with pytest.raises(DeviceFault, match="load was too high") as caught:
        servo.exchange(Command.rest())
    assert caught.value.code == 32
    rig.device.write(42, b"\x64\x00")  # a new goal ends the protection, so that under set-points the limit remains
    assert rig.device.errors == 0
    servo.disarm()
    assert not rig.motor.enabled


# -- what it refuses ------------------------------------------------------------------------------------------------


def test_a_servo_of_an_unknown_kind_is_refused_with_its_registers_and_nothing_is_written(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    rig.device.put("sub_version", 99)
    with pytest.raises(
        DriverError, match=r"not known here \(version 9\.99, firmware 3\.10\).+ 0: 03 0a 00 09 63.+ 64: "
    ) as e:
        rig.open()
    assert "nothing was written" in str(e.value)
    assert written(rig.port.sent) == []
    assert rig.closed


@pytest.mark.parametrize("model", ["sts3215", "hls3930m"])
def test_another_process_that_switches_off_leaves_the_torque_limit_at_zero(make_feetech: Make, model: str) -> None:
    rig = make_feetech(model)
    servo = rig.armed(LIMITS, torque_constant=1.0, mode="position")
    path = servo.off_path()
    limits = {address for address, _ in written(b"".join(path.off))} - {TORQUE_ENABLE}
    assert limits
    assert not limits & {address for address, _ in written(b"".join(path.restore))}
    servo.close()


def test_another_model_than_the_stand_files_is_refused_by_name(make_feetech: Make) -> None:
    with pytest.raises(DriverError, match=r"of the kind sts3250 .+ not the sts3215"):
        make_feetech("sts3250").open(model="sts3215")


def test_firmware_without_the_registers_that_are_needed_is_refused(make_feetech: Make) -> None:
    with pytest.raises(DriverError, match=r"firmware 3\.39.+torque limit and mode.+3\.40.+install"):
        make_feetech("hls3930m", firmware=(3, 39)).open()
    make_feetech("hls3930m", firmware=(3, 40)).open()


def test_the_search_names_what_answers_with_other_settings(make_feetech: Make) -> None:
    rig = make_feetech("sts3215", baudrate=115_200)
    rig.bus.devices.append(FeetechDevice("sts3250", 7, baudrate=115_200))
    found = search(FeetechConfig("loopback", "sts3215"), rig.clock, rig.port)
    assert found == ["a sts3215 answers with id 1 at 115200 baud", "a sts3250 answers with id 7 at 115200 baud"]


def test_a_torque_is_not_commanded_of_a_servo_without_a_torque_mode(tmp_path: Path, capsys: Any) -> None:
    stand = tmp_path / "stand.toml"
    stand.write_text(STAND.format(table='model = "sts3215"', source="motor"))
    assert run(["record", "--stand", str(stand), "-o", str(tmp_path / "run.h5")]) == 2
    said = capsys.readouterr().err
    assert "accepts no torque as set-point" in said
    assert "torque cell at the joint" in said
    assert "--mode position" in said
    assert not (tmp_path / "run.h5").exists()


STAND = """
[stand]
backend = "feetech"
torque_source = "{source}"
torque_stays_on_if_host_dies = true
[limits]
torque = 0.4
deflection = 1.0
velocity = 30.0
[feetech]
port = "loop://"
{table}
"""


@pytest.mark.parametrize(
    ("table", "source", "words"),
    [
        ('model = "sts3215"', "motor", "without feetech.torque_constant"),
        ('model = "sts3215"\ntorque_constant = 1.0', "motor", "counts of 6.5 mN m"),
        ('model = "scs0009"', "motor", "measures no current"),
        ('model = "sts3215"', "joint", ""),
    ],
)
def test_doctor_and_record_say_first_what_the_servo_cannot_do(
    tmp_path: Path, capsys: Any, table: str, source: str, words: str
) -> None:
    text = STAND.format(table=table, source=source)
    checks = CheckList()
    examine(checks, parse(text), Quantity.POSITION, rate=100.0, move=False)
    said = [check.message for check in checks.checks if check.name == "drive"]
    assert [words in message and "torque cell at the joint" in message for message in said] == [True] * bool(words)
    (tmp_path / "stand.toml").write_text(text)
    run(["record", "--stand", str(tmp_path / "stand.toml"), "--mode", "position", "-o", str(tmp_path / "run.h5")])
    assert ("restricted-drive" in capsys.readouterr().err) == bool(words)
