"""What an emulated Feetech servo does that the adapter never asks for: calibration, instructions, goals."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from drivers.packets.wire import Wire1
from drivers.servo import Command, Limits, Quantity
from sim_backend.wire.feetech.device import RESTART, FeetechDevice
from sim_backend.wire.packets.bus import PacketBus

Make = Callable[..., Any]
WIRE = Wire1(0)
OFFSET, TORQUE, GOAL, SPEED, LOCK, POSITION = 31, 40, 42, 46, 55, 56


def asked(device: FeetechDevice, instruction: int, parameters: str = "", now: float = 0.0) -> str:
    """The error and the parameters of the reply as hexadecimal digits, "" if there is none."""
    replies = PacketBus([device], protocol=1).receive(WIRE.frame(1, instruction, bytes.fromhex(parameters)), now)
    return b"".join(data for _, data in replies)[4:-1].hex(" ")


def position(device: FeetechDevice) -> int:
    raw = int.from_bytes(device.read(POSITION, 2, 0.0)[1], "little")
    return raw & 0x7FFF if raw < 0x8000 else -(raw & 0x7FFF)


def word(value: int) -> bytes:
    return value.to_bytes(2, "little")


def test_an_offset_is_subtracted_from_the_encoders_position_with_bit_11_as_its_sign() -> None:
    device = FeetechDevice("sts3215")
    device.mount_at_middle()
    for raw, read in ((100, 1948), (0x800 | 100, 2148), (0x800 | 2047, 4095), (0x1000, 0), (0, 2048)):
        device.write(OFFSET, word(raw))
        assert device.read(OFFSET, 2, 0.0)[1] == word(raw)
        assert position(device) == read
    hls = FeetechDevice("hls3930m")
    hls.mount_at_middle()
    hls.write(OFFSET, word(0x8000 | 100))
    assert position(hls) == 2148


def test_the_calibration_of_lerobot_ends_at_the_middle_whatever_offset_was_there() -> None:
    for mount, old in ((3000, 0), (3000, 500), (100, 0x800 | 500)):
        device = FeetechDevice("sts3215")
        device._centre = mount
        device.write(OFFSET, word(old))
        device.write(OFFSET, word(0))
        homing = position(device) - 2047
        device.write(OFFSET, word(abs(homing) | (0x800 if homing < 0 else 0)))
        assert position(device) == 2047


@pytest.mark.parametrize(
    ("model", "firmware", "instruction", "parameters", "read"),
    [
        ("sts3215", None, 0x0B, "", 2048),
        ("sts3215", None, 0x0B, "0b 0e", 3595),  # as orca_core sends it
        ("sts3215", (3, 9), 0x0B, "", None),
        ("hls3930m", None, 0x0B, "f4 01", 500),
        ("hls3606m", None, 0x0B, "", 2048),
        ("hls3606m", None, 0x0B, "f4 01", None),
        ("sts3215", None, 0x03, "28 80", 2048),
        ("hls3930m", None, 0x03, "28 80", 0),
    ],
)
def test_a_calibration_moves_the_reading_and_not_the_shaft_and_outlives_the_power_where_the_servo_has_it(
    model: str, firmware: Any, instruction: int, parameters: str, read: int | None
) -> None:
    device = FeetechDevice(model, firmware=firmware)
    device.write(TORQUE, b"\x01")
    assert asked(device, instruction, parameters) == ("" if read is None else "00")
    device.advance(0.5)
    assert device.motor.position == pytest.approx(0.0, abs=1e-3)
    device.reboot(1.0)
    assert position(device) == (read or 0)


def is_on(device: FeetechDevice) -> bool:
    return device.motor.enabled


@pytest.mark.parametrize("model", ["sts3215", "hls3930m", "scs0009"])
def test_a_write_of_the_goal_switches_the_torque_on_and_of_the_speed_in_speed_mode(model: str) -> None:
    device = FeetechDevice(model)
    device.write(SPEED, b"\x00\x10")
    assert not is_on(device)
    device.write(GOAL, b"\x00\x10")
    assert is_on(device)
    assert device.read(TORQUE, 1, 0.0)[1] == b"\x01"
    if model != "scs0009":
        device.write(TORQUE, b"\x00")
        device.write(33, b"\x01")
        device.write(GOAL, b"\x00\x10")
        assert not is_on(device)
        device.write(SPEED, b"\x00\x00")
        assert is_on(device)


@pytest.mark.parametrize(("model", "mode"), [("sts3215", "position"), ("hls3930m", "position"), ("hls3930m", "torque"),
                                             ("scs0009", "position")])  # fmt: skip
def test_a_goal_that_arrives_after_another_process_switched_off_makes_no_torque(
    make_feetech: Make, model: str, mode: str
) -> None:
    rig = make_feetech(model)
    servo = rig.armed(Limits(0.2, 30.0, 60.0, (-20.0, 20.0)), mode=mode)
    late = servo._goal(servo._gate.admit(Command(Quantity.TORQUE if mode == "torque" else Quantity.POSITION, 0.1)))[0]
    for frame in servo.off_path().off:
        rig.bus.receive(frame, rig.clock.now())
    assert not rig.motor.enabled
    rig.bus.receive(servo._bus.unanswered(*late), rig.clock.now())
    rig.device.advance(rig.clock.now() + 0.5)
    assert abs(rig.motor.torque) < 1e-9
    servo.arm(Limits(0.2, 30.0, 60.0, (-20.0, 20.0)))  # and it is usable again
    assert rig.device.get("torque_limit" if model != "scs0009" else "max_torque") > 0
    servo.close()


def test_the_adapter_holds_and_follows_with_an_offset_set(make_feetech: Make) -> None:
    rig = make_feetech("sts3215")
    rig.device.mount_at_middle()
    rig.device.write(OFFSET, word(0x800 | 1000))
    servo = rig.open()
    before = servo.exchange(Command.rest()).motor_position
    servo.arm(Limits(0.4, 30.0, 60.0, (-20.0, 20.0)))
    angle = rig.motor.position
    for _ in range(200):
        rig.wait(2e-3)
        last = servo.exchange(Command(Quantity.POSITION, before + 0.3)).motor_position
    count = math.tau / 4096.0
    assert before == pytest.approx(3048 * count)
    assert last - before == pytest.approx(rig.motor.position - angle, abs=2 * count)
    assert rig.motor.position - angle == pytest.approx(0.3, abs=3 * count)
    servo.close()


def test_the_factory_settings_and_a_backup_come_back_but_not_the_id() -> None:
    device = FeetechDevice("sts3215")
    device.write(LOCK, b"\x00")
    device.write(13, b"\x32")
    assert asked(device, 0x06) == "00"
    assert (device.get("id"), device.get("temperature_limit")) == (1, 70)
    device.write(13, b"\x37")
    assert asked(device, 0x09) == "00"
    device.write(13, b"\x32")
    assert asked(device, 0x06) == "00"
    device.reboot(1.0)
    assert device.get("temperature_limit") == 55


def test_turns_are_forgotten_by_their_instruction_and_without_power() -> None:
    for forget in (lambda device: asked(device, 0x0A), lambda device: device.reboot(0.0)):
        device = FeetechDevice("hls3930m")  # it counts over many turns
        device._centre = 2 * 4096 + 10
        assert position(device) == 2 * 4096 + 10
        forget(device)
        assert position(device) == 10


def test_a_reboot_has_no_reply_and_an_instruction_that_the_servo_does_not_have_neither() -> None:
    device = FeetechDevice("sts3215")
    for instruction in (0x07, 0x10, 0x55, 0x92):
        assert asked(device, instruction, "38 02") == ""
    device.write(TORQUE, b"\x01")
    assert asked(device, 0x08) == ""
    assert not device.motor.enabled
    assert asked(device, 0x01, now=RESTART - 0.1) == ""
    assert asked(device, 0x01, now=RESTART + 0.1) == "00"
    # of the instructions for several, each series has its own
    read = bytes.fromhex("38 02 01")
    assert PacketBus([device], protocol=1).receive(WIRE.frame(254, 0x82, read), 3.0)
    assert not PacketBus([FeetechDevice("scs0009")], protocol=1).receive(WIRE.frame(254, 0x82, read), 3.0)
    assert not PacketBus([device], protocol=1).receive(WIRE.frame(254, 0x92, bytes.fromhex("00 02 01 38")), 3.0)


def test_values_are_stored_or_ignored_as_the_memory_table_says() -> None:
    device = FeetechDevice("sts3215")
    device.write(TORQUE, b"\x05")
    assert (device.get("torque_enable"), device.motor.enabled) == (0, False)
    device.write(85, b"\xfe")  # LeRobot's Maximum_Acceleration
    assert device.read(85, 1, 0.0)[1] == b"\xfe"
    device.write(POSITION, b"\x01\x02")
    assert position(device) == 0
    hls = FeetechDevice("hls3930m")
    hls.write(5, b"\x09")
    assert hls.line.shadow == 9
    hls.write(21, b"\x28")
    hls.write(LOCK, b"\x00")
    hls.write(21, b"\x28")
    hls.reboot(0.0)
    assert hls.get("p_gain_now") == 40
