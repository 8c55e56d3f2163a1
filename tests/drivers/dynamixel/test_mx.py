"""MX servos with protocol 1.0: the emulator against the manual and the vendor's client, the adapter on the emulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dynamixel_sdk import Protocol1PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from drivers.dynamixel.models import POSITION_LSB, models
from drivers.servo import Command, DeviceFault, DriverError, Limits, NoReply, Quantity
from sim_backend.parameters import CouplingParameters
from sim_backend.wire.dynamixel.mx_device import (
    MX_ANGLE,
    MX_HEAT,
    MX_OVERLOAD,
    MX_RANGE,
    MxDevice,
)
from sim_backend.wire.dynamixel.tables import MX_MODELS
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.packets.frames import Framer
from sim_backend.wire.packets.frames_1 import status_1, take_packet_1
from sim_backend.wire.packets.regulator import COUNT

from ..conftest import drive, small_joint, torque

Make = Callable[..., Any]
PACKETS = Protocol1PacketHandler()
LIMITS = Limits(torque=0.5, velocity=6.0, temperature=65.0, position=(-40.0, 40.0))
TURN = 2.0 * math.pi


def soft(model: str = "mx-64", stiffness: float = 0.05) -> MxDevice:
    """A servo on a cable so soft that it turns far."""
    coupling = CouplingParameters(stiffness=stiffness, damping=2e-3, coulomb_friction=0.0)
    return MxDevice(model, parameters=small_joint(coupling))


# --- the emulator -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        ("ff ff 01 02 01 fb", "ff ff 01 02 00 fc"),  # the manual's ping
        ("ff ff 01 05 04 1e f4 01 e2", "ff ff 01 02 00 fc"),  # its reg write of 500 to Goal Position(30)
        ("ff ff fe 02 05 fa", ""),  # its action to all
        ("ff ff fe 0e 83 1e 04 00 10 00 50 01 01 20 02 60 03 67", ""),  # its sync write
        ("ff ff 01 02 01 fa", "ff ff 01 02 10 ec"),  # a wrong checksum
        ("ff ff 01 02 05 f7", "ff ff 01 02 40 bc"),  # an action without a reg write
        ("ff ff 01 02 77 85", "ff ff 01 02 40 bc"),  # an unknown instruction
        ("ff ff 01 04 02 00 03 f5", "ff ff 01 05 00 36 01 29 99"),  # model number and firmware
    ],
)
def test_the_emulator_answers_the_manuals_packets(request_: str, reply: str) -> None:
    bus = PacketBus([MxDevice("mx-64")], protocol=1)
    replies = bus.receive(bytes.fromhex(request_), 0.1)
    assert b"".join(data for _, data in replies) == bytes.fromhex(reply)


def test_the_manuals_sync_write_reaches_the_servo_it_names() -> None:
    device = MxDevice("mx-106", 1)
    bus = PacketBus([device], protocol=1)
    bus.receive(bytes.fromhex("ff ff fe 0e 83 1e 04 00 10 00 50 01 01 20 02 60 03 67"), 0.1)
    assert (device.get("goal_position"), device.get("moving_speed")) == (0x220, 0x360)


@given(
    junk=st.binary(max_size=8).filter(lambda data: b"\xff" not in data),
    pieces=st.lists(st.integers(1, 5), max_size=12),
    parameters=st.binary(max_size=12),
)
def test_packets_are_found_whatever_pieces_they_come_in(junk: bytes, pieces: list[int], parameters: bytes) -> None:
    body = bytes([7, 2 + len(parameters), 3]) + parameters
    data = junk + b"\xff\xff" + body + bytes([~sum(body) & 0xFF])
    framer, frames = Framer(take_packet_1), []
    for size in pieces:
        frames += framer.feed(data[:size])
        data = data[size:]
    frames += framer.feed(data)
    assert [(frame.id, frame.instruction, frame.parameters, frame.sound) for frame, _ in frames] == [
        (7, 3, parameters, True)
    ]


def test_a_status_packet_has_the_manuals_checksum() -> None:
    assert status_1(1, 0x24) == bytes.fromhex("ff ff 01 02 24 d8")
    assert status_1(1, 0, b"\x20") == bytes.fromhex("ff ff 01 03 00 20 db")


@pytest.mark.parametrize("model", MX_MODELS)
def test_every_register_answers_and_begins_within_its_range(model: str) -> None:
    device = MxDevice(model)
    for item in MX_MODELS[model].items:
        error, data = device.read(item.address, item.size, 0.1)
        assert (error, len(data)) == (0, item.size)
        if item.writable:
            assert item.low <= item.initial <= item.high


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (0, b"\x01\x00", MX_RANGE),  # read only
        (9, b"\x01", MX_RANGE),  # the middle of an item
        (14, b"\x00\x04", MX_RANGE),  # 1024 of 1023
        (30, b"\xff\x7f", MX_RANGE),
        (30, b"\x00\x10", MX_ANGLE),  # 4096 of 4095 in joint mode
        (30, b"\x00\x08", 0),
    ],
)
def test_a_write_keeps_to_the_rules_of_the_table(address: int, data: bytes, error: int) -> None:
    assert MxDevice("mx-64").write(address, data) == error


def test_heat_sets_the_torque_limit_to_zero_and_is_reported_while_it_lasts() -> None:
    device = MxDevice("mx-64")
    device.motor.warm_to(90.0)
    device.advance(0.1)
    assert device.alerted(0) == MX_HEAT
    assert device.get("torque_limit") == 0
    device.motor.warm_to(30.0)
    device.advance(0.2)
    assert device.alerted(0) == 0
    assert device.get("torque_limit") == 0


def test_bulk_read_is_answered_in_its_order() -> None:
    bus = PacketBus([MxDevice("mx-64", 1), MxDevice("mx-64", 2)], protocol=1)
    replies = bus.receive(bytes.fromhex("ff ff fe 09 92 00 02 01 1e 02 02 24 1d"), 0.1)  # the manual's
    assert [data[2] for _, data in replies] == [1, 2]
    assert {len(data) for _, data in replies} == {8}


def test_a_set_lock_protects_the_eeprom_and_itself_until_the_power_is_off(make_rig: Make) -> None:
    rig = make_rig("mx-64")
    device = rig.device
    assert device.write(47, b"\x00") == 0
    device.write(47, b"\x01")
    assert [device.write(47, b"\x00"), device.write(11, b"\x46"), device.write(34, b"\x10\x00")] == [
        MX_RANGE,
        MX_RANGE,
        0,
    ]
    assert (device.get("lock"), device.get("temperature_limit")) == (1, 80)
    with pytest.raises(DriverError, match=r"EEPROM is locked.+power off and on"):
        rig.open()
    assert not rig.motor.enabled
    device.reboot(5.0)
    assert device.write(11, b"\x46") == 0


# --- the adapter on it ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MX_MODELS)
def test_driver_and_emulator_have_the_same_tables(model: str) -> None:
    ours, theirs = models()[model], MX_MODELS[model]
    items = {item.name: item for item in theirs.items}
    assert (ours.protocol, ours.number, ours.current_lsb) == (1, theirs.number, theirs.current_lsb)
    assert (ours.current_max, ours.temperature_max) == (items["max_torque"].high, items["temperature_limit"].initial)
    assert theirs.stall in ours.stall


@pytest.mark.parametrize("value", [0.2, -0.3])
def test_a_torque_reaches_the_motor_with_its_sign_to_half_a_count(make_rig: Make, value: float) -> None:
    rig = make_rig("mx-64")
    rig.bus.devices[0] = soft(stiffness=1.0)
    servo = rig.armed(LIMITS, torque_constant=6.0 / 4.1)
    last = drive(rig, servo, torque(value), ticks=100)
    motor = rig.device.motor
    assert motor.torque == pytest.approx(value, abs=0.51 * servo.info.torque_lsb)
    assert last.motor_torque == pytest.approx(motor.torque, abs=0.51 * servo.info.torque_lsb)
    assert last.motor_position == pytest.approx(motor.position, abs=2 * COUNT)
    assert last.motor_velocity == pytest.approx(motor.velocity, abs=0.1)
    assert last.voltage == pytest.approx(12.0)
    assert last.temperature == pytest.approx(motor.temperature, abs=1.0)
    servo.close()


def test_turns_are_counted_although_the_servo_does_not(make_rig: Make) -> None:
    rig = make_rig("mx-64")
    rig.bus.devices[0] = soft()
    servo = rig.armed(LIMITS)
    positions = [drive(rig, servo, torque(0.45), ticks=1).motor_position for _ in range(400)]
    assert max(positions) > TURN
    assert max(np.abs(np.diff(positions))) < 0.25 * TURN
    assert positions[-1] == pytest.approx(rig.device.motor.position, abs=0.2)
    assert 0 <= rig.device.get("present_position") < 4096


@pytest.mark.study
def test_positions_are_followed_beyond_a_turn_from_wherever_it_stands(make_rig: Make) -> None:
    rig = make_rig("mx-106")
    rig.bus.devices[0] = soft("mx-106")
    servo = rig.open(mode="extended-position", sign=-1)
    before = servo.exchange(Command.rest()).motor_position
    servo.arm(LIMITS)
    resting = drive(rig, servo, Command.rest(), ticks=50)
    assert resting.motor_position == pytest.approx(before, abs=2 * POSITION_LSB)
    goal = before + 1.2 * TURN
    last = drive(rig, servo, Command(Quantity.POSITION, goal), ticks=800)
    assert last.motor_position == pytest.approx(goal, abs=0.02)
    assert rig.device.motor.position < 0.0


def test_the_limits_are_in_the_servo_before_current_flows_and_the_eeprom_is_put_back(make_rig: Make) -> None:
    rig = make_rig("mx-64")
    before = bytes(rig.device.registers.memory[:24])
    servo = rig.armed(LIMITS, mode="extended-position")
    device = rig.device
    largest = max(servo.info.torque_lsb, 7.3 / 1023)
    assert device.get("torque_limit") == math.floor(0.5 / largest)
    assert device.get("temperature_limit") == 65
    assert device.get("moving_speed") == math.floor(6.0 / (0.114 * TURN / 60.0))
    assert (device.get("cw_angle_limit"), device.get("ccw_angle_limit")) == (4095, 4095)
    servo.close()
    assert bytes(device.registers.memory[:24]) == before
    assert not device.motor.enabled


@pytest.mark.parametrize("torque_on", [0, 1])
@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_that_confirms_no_writes_or_answers_no_reads_does_so_for_a_run_only(
    make_rig: Make, level: int, torque_on: int
) -> None:
    rig = make_rig("mx-64")
    device = rig.device
    device.registers.put("status_return_level", level)
    device.write(24, bytes([torque_on]))
    before = bytes(device.registers.memory[:24])
    servo = rig.open()
    assert (device.get("status_return_level"), device.motor.enabled) == (2, False)
    assert any(frame == servo._table.unanswered("status_return_level", level) for frame in servo.off_path().restore)
    servo.arm(LIMITS)
    servo.close()
    assert bytes(device.registers.memory[:24]) == before
    assert not device.motor.enabled


def test_a_mute_servo_that_is_not_the_stand_files_is_left_mute(make_rig: Make) -> None:
    rig = make_rig("mx-64")
    rig.device.registers.put("status_return_level", 0)
    with pytest.raises(DriverError, match="not the mx-106"):
        rig.open(model="mx-106")
    assert rig.device.get("status_return_level") == 0


def test_a_mute_servo_that_takes_no_settings_is_named_with_its_register(make_rig: Make) -> None:
    rig = make_rig("mx-64")
    rig.device.registers.put("status_return_level", 0)
    rig.device.registers.put("lock", 1)
    with pytest.raises(NoReply, match=r"answers a ping and nothing else: its Status Return Level\(16\) is 0"):
        rig.open()


@pytest.mark.parametrize("bits", [MX_HEAT, MX_OVERLOAD])
def test_a_shutdown_ends_the_run_and_keeps_the_servo_from_being_armed(make_rig: Make, bits: int) -> None:
    rig = make_rig("mx-64")
    servo = rig.armed(LIMITS)
    drive(rig, servo, torque(0.1), ticks=3)
    rig.device.put("shutdown", 36)
    rig.device.fail(bits)
    if bits == MX_HEAT:
        rig.device.motor.warm_to(95.0)
    with pytest.raises(DeviceFault) as fault:
        drive(rig, servo, torque(0.1), ticks=3)
    assert fault.value.code == bits
    servo.disarm()
    with pytest.raises(DeviceFault):
        servo.arm(LIMITS)
    assert not rig.device.motor.enabled


def test_older_firmware_has_no_tick_and_works_without(make_rig: Make) -> None:
    rig = make_rig("mx-64", firmware=36)
    servo = rig.armed(LIMITS)
    assert drive(rig, servo, torque(0.1)).status == 0
