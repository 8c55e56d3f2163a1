"""What the emulated servo does inside, held against the manual's words."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sim_backend.integrator import STATE
from sim_backend.plant import MOTOR
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.emulator import serve
from sim_backend.wire.dynamixel.tables import MODELS, RPM
from sim_backend.wire.packets.bus import PacketBus, PacketTiming
from sim_backend.wire.packets.frames import Error, Frame, Instruction, packet, status
from sim_backend.wire.packets.regulator import COUNT

TORQUE_ENABLE, WATCHDOG = 64, 98
GOAL_CURRENT, GOAL_VELOCITY, GOAL_POSITION, GOAL_PWM = (102, 2), (104, 4), (116, 4), (100, 2)


def put(device: DynamixelDevice, where: tuple[int, int], value: int) -> Error:
    return device.write(where[0], value.to_bytes(where[1], "little", signed=True))


def running(mode: int, model: str = "xl330-m288") -> DynamixelDevice:
    device = DynamixelDevice(model)
    assert device.write(11, bytes([mode])) == Error.NONE
    device.write(TORQUE_ENABLE, b"\x01")
    return device


def test_every_register_of_every_model_answers_and_begins_within_its_range() -> None:
    devices = {model: DynamixelDevice(model) for model in MODELS}
    for model, item in [(one, item) for one in MODELS for item in MODELS[one].items]:
        error, data = devices[model].read(item.address, item.size, 0.1)
        assert (error, len(data)) == (Error.NONE, item.size), model
        if item.writable:
            assert item.low <= item.initial <= item.high, (model, item.name)


def test_position_control_loses_the_turns_and_ignores_an_offset_of_more_than_a_quarter() -> None:
    """E-manual, "Homing Offset(20)" and "Present Position(132)"; the numbers are those of forum.robotis.com/t/7814."""
    device = DynamixelDevice("xl330-m288")
    device.registers.put("homing_offset", -512)
    device.motor._path[STATE, MOTOR] = 4212 * COUNT
    assert device.read(132, 4, 0.1)[1] == (3700).to_bytes(4, "little")
    device.write(TORQUE_ENABLE, b"\1")
    assert device.read(132, 4, 0.1)[1] == (-396).to_bytes(4, "little", signed=True)
    device.write(TORQUE_ENABLE, b"\0")
    device.registers.put("homing_offset", 1025)
    assert device.read(132, 4, 0.1)[1] == (116).to_bytes(4, "little")
    device.write(11, b"\4")
    assert device.read(132, 4, 0.1)[1] == (116 + 1025).to_bytes(4, "little")


def test_addresses_nobody_defined_are_refused() -> None:
    device = DynamixelDevice("xl330-m288")
    assert device.read(72, 1, 0.0)[0] == Error.ACCESS
    assert device.read(228, 1, 0.0)[0] == Error.ACCESS
    assert device.write(72, b"\x01") == Error.ACCESS


def test_the_watchdog_goes_through_the_eight_steps_of_the_manuals_example() -> None:
    device = running(1)
    assert put(device, GOAL_VELOCITY, 50) == Error.NONE
    device.advance(1.0)
    assert device.motor.velocity > 0.0
    device.write(WATCHDOG, b"\x64")  # 2 s
    device.life.heard = 1.0
    device.advance(2.9)
    assert device.registers.get("bus_watchdog") == 100
    device.advance(8.0)
    assert device.tripped
    assert abs(device.motor.velocity) < 0.5 * RPM
    assert put(device, GOAL_VELOCITY, 150) == Error.DATA_RANGE
    assert device.write(WATCHDOG, b"\x00") == Error.NONE
    assert put(device, GOAL_VELOCITY, 150) == Error.NONE


def test_the_watchdog_sleeps_while_the_torque_is_off_and_is_fed_by_talk_with_others() -> None:
    bus = PacketBus([DynamixelDevice("xl330-m288", 1), DynamixelDevice("xl330-m288", 2)])
    first = bus.devices[0]
    first.write(WATCHDOG, b"\x01")
    bus.advance(1.0)
    assert first.registers.get("bus_watchdog") == 1
    bus.receive(packet(1, b"\x03\x40\x00\x01"), 1.0)
    for step in range(10):
        bus.receive(packet(2, b"\x01"), 1.0 + 0.015 * step)
    assert first.registers.get("bus_watchdog") == 1
    bus.advance(1.3)
    assert first.tripped


def test_in_current_mode_a_still_motor_settles_at_torque_over_stiffness() -> None:
    device = running(0)
    put(device, GOAL_CURRENT, 20)
    device.advance(3.0)
    expected = 20e-3 * device.motor.law.torque_constant
    assert device.motor.torque == pytest.approx(expected, rel=1e-6)
    # the friction of the cable holds some of it
    assert device.motor.coupling_torque == pytest.approx(expected, rel=1e-3)
    assert device.motor.position == pytest.approx(expected / (0.4 * device.model.stall[2]), rel=0.05)


@pytest.mark.parametrize("mode", [3, 4, 5])
def test_position_modes_reach_their_goal(mode: int) -> None:
    device = running(mode)
    put(device, GOAL_POSITION, 200)
    device.advance(3.0)
    assert device.motor.position == pytest.approx(200 * COUNT, abs=1.5 * COUNT)


def test_pwm_mode_stalls_at_the_voltages_share_of_the_stall_torque() -> None:
    device = running(16)
    put(device, GOAL_PWM, 20)
    device.advance(5.0)
    assert device.motor.torque == pytest.approx(20 / 885 * 0.52, rel=1e-3)


def test_a_goal_outside_the_position_limits_is_refused_in_position_mode_only() -> None:
    assert put(running(3), GOAL_POSITION, -1) == Error.DATA_LIMIT
    assert put(running(4), GOAL_POSITION, -1) == Error.NONE
    assert put(running(4), GOAL_POSITION, 256 * 4096 + 1) == Error.DATA_LIMIT


def test_a_change_of_mode_resets_the_goals_to_the_limits() -> None:
    device = DynamixelDevice("xl330-m288")
    device.write(11, b"\x00")
    assert device.registers.get("goal_current") == 1750
    assert device.registers.get("goal_pwm") == 885


def test_the_drive_mode_turns_the_servo_round() -> None:
    device = DynamixelDevice("xl330-m288")
    device.write(10, b"\x01")
    device.write(11, b"\x00")
    device.write(TORQUE_ENABLE, b"\x01")
    put(device, GOAL_CURRENT, 20)
    device.advance(1.0)
    device.read(132, 4, 1.0)
    assert device.motor.position < 0.0 < device.registers.get("present_position")


def test_a_damaged_request_is_answered_with_the_error_for_it() -> None:
    request = bytearray(packet(1, b"\x02\x84\x00\x04\x00"))
    request[-1] ^= 1
    (reply,) = PacketBus([DynamixelDevice("xl330-m288")]).receive(bytes(request), 0.0)
    assert reply.data == status(1, Error.CRC)


def test_what_it_does_not_know_is_an_instruction_error() -> None:
    bus = PacketBus([DynamixelDevice("xl330-m288")])
    for instruction in (0x05, 0x7F):  # an Action without Reg Write; none at all
        (reply,) = bus.receive(packet(1, bytes([instruction])), 0.0)
        assert reply.data == status(1, Error.INSTRUCTION)


def test_a_shadow_id_obeys_and_is_silent() -> None:
    bus = PacketBus([DynamixelDevice("xl330-m288", 1)])
    bus.devices[0].write(12, b"\x05")
    assert bus.receive(packet(5, b"\x03\x41\x00\x01"), 0.0) == []
    assert bus.devices[0].registers.get("led") == 1


def test_timing_is_the_sum_of_its_parts() -> None:
    bus = PacketBus([DynamixelDevice("xl330-m288")], timing=PacketTiming(usb_latency=1e-3))
    (reply,) = bus.receive(packet(1, b"\x02\x84\x00\x04\x00"), 2.0, 1_000_000)
    assert reply.at == pytest.approx(2.0 + (14 + 15) * 10e-6 + 500e-6 + 1e-3, abs=1e-9)


def test_time_runs_on_the_ticks_of_the_servo_and_wraps() -> None:
    device = DynamixelDevice("xl330-m288", now=5.0)
    for now in (5.0, 5.0401, 5.0 + 32.768, 5.0 + 40.0):
        device.advance(now)
        _, data = device.read(120, 2, now)
        assert int.from_bytes(data, "little") == math.floor((now - 5.0) * 1e3 + 1e-9) % 32768


def test_a_link_is_made_and_taken_away_and_never_put_over_a_file(tmp_path: Path) -> None:
    link = tmp_path / "ttyDXL"
    with serve(link, "xl330-m288", (1, 2)):
        assert link.is_symlink()
    assert not link.is_symlink()
    link.write_text("mine")
    with pytest.raises(FileExistsError):
        serve(link, "xl330-m288")
    assert link.read_text() == "mine"


def test_serving_in_the_foreground_ends_with_stop_and_takes_the_link_away(tmp_path: Path) -> None:
    line = serve(tmp_path / "ttyDXL", "xl330-m288")
    line.stop()
    line.serve()
    assert not line.link.is_symlink()


@pytest.mark.parametrize(("model", "newest"), [("xh540-w150", True), ("mx-64-2", False)])
def test_an_mx_with_protocol_2_has_neither_backups_nor_fast_reads(model: str, newest: bool) -> None:
    device = DynamixelDevice(model)
    assert (Instruction.FAST_SYNC_READ in device.line.together) == newest
    error, _ = device.answer(Frame(1, Instruction.BACKUP, b"\x01CTRL", True, 15), 0.1) or (None, b"")
    assert error == (Error.NONE if newest else Error.INSTRUCTION)
    assert device.read(40, 4, 0.1)[0] == (Error.ACCESS if newest else Error.NONE)  # Acceleration Limit


def test_a_goal_switches_the_torque_on_where_the_drive_mode_says_so_and_the_off_path_leaves_it_off(
    make_rig: Callable[..., Any],
) -> None:
    rig = make_rig("xl330-m288")
    assert rig.device.write(10, b"\x08") == Error.NONE
    servo = rig.open()
    assert put(rig.device, GOAL_POSITION, 100) == Error.NONE
    assert rig.device.motor.enabled
    for frame in servo.off_path().off:
        rig.bus.receive(frame, rig.clock.now())
    assert not rig.device.motor.enabled
    servo.close()
