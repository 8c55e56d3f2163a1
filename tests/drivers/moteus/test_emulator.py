"""The modes, the telemetry and the zero of an emulated moteus, byte by byte."""

from __future__ import annotations

import math
import struct

import pytest

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.moteus.command import (
    BRAKE,
    CURRENT,
    POSITION,
    STAY_WITHIN,
    TORQUE_CONSTANT,
    TURN,
    VOLTAGE_DQ,
    ZERO_VELOCITY,
)
from sim_backend.wire.moteus.device import FAULT, NOT_CONFIGURED, STOPPED, MoteusDevice


def commanded(device: MoteusDevice, mode: int, now: float, *registers: tuple[int, float]) -> None:
    """Command a mode with float registers, in one frame."""
    data = bytes([0x01, 0x00, mode])
    for number, value in registers:
        data += bytes([0x0D, number]) + struct.pack("<f", value)
    device.handle(CanFrame(0x0001, data, fd=True), now)


def running(mode: int, *registers: tuple[int, float]) -> MoteusDevice:
    device = MoteusDevice(1)
    for step in range(3):
        commanded(device, mode, 1e-3 * step, *registers)
    return device


def asked(device: MoteusDevice, number: int, now: float) -> float:
    (reply,) = device.handle(CanFrame(0x8001, bytes([0x1D, number]), fd=True), now)
    return float(struct.unpack_from("<f", reply.data, 2)[0])


def test_a_current_is_made_and_is_not_ended_by_the_watchdog() -> None:
    device = running(CURRENT, (0x1C, 2.0))
    assert asked(device, 0x000, 1.0) == CURRENT
    assert device.motor.torque == pytest.approx(2.0 * TORQUE_CONSTANT)


def test_a_voltage_in_the_rotors_frame_makes_the_current_of_the_winding() -> None:
    device = running(VOLTAGE_DQ, (0x1B, 0.2))
    device.advance(3.0)
    assert device.motor.torque == pytest.approx(0.2 / 0.1 * TORQUE_CONSTANT, rel=1e-3)


@pytest.mark.parametrize("mode", [ZERO_VELOCITY, BRAKE])
def test_zero_velocity_and_brake_oppose_motion_and_nothing_else(mode: int) -> None:
    device = running(CURRENT, (0x1C, 2.0))
    device.advance(0.01)
    commanded(device, mode, 0.011)
    assert device.mode == mode
    assert device.motor.velocity * device.motor.demand < 0.0
    device.advance(5.0)
    assert device.motor.torque == pytest.approx(0.0, abs=1e-4)


def test_within_its_bounds_the_motor_is_free_and_outside_it_is_pushed_back() -> None:
    device = running(STAY_WITHIN, (0x40, -0.1), (0x41, 0.1), (0x27, 10.0))
    assert asked(device, 0x000, 0.01) == STAY_WITHIN
    assert device.motor.demand == 0.0
    device = running(STAY_WITHIN, (0x40, 0.05), (0x27, 10.0))
    assert device.motor.demand > 0.0
    device = running(STAY_WITHIN, (0x41, -0.05), (0x45, 0.03), (0x27, 10.0))
    assert device.motor.demand == pytest.approx(-0.03)


@pytest.mark.parametrize("mode", [5, 6, 7, 14])
def test_modes_that_drive_the_phases_end_in_a_fault_that_has_a_name(mode: int) -> None:
    device = running(mode)
    assert (device.mode, device.fault) == (FAULT, NOT_CONFIGURED)
    assert not device.motor.enabled
    commanded(device, STOPPED, 0.1)
    assert (device.mode, device.fault) == (STOPPED, 0)


def test_a_mode_that_is_not_in_the_table_is_refused() -> None:
    (reply,) = MoteusDevice(1).handle(CanFrame(0x8001, bytes([0x01, 0x00, 16]), fd=True), 0.1)
    assert reply.data[0] == 0x30


def test_a_position_with_a_speed_limit_is_reached_in_its_time_and_then_the_trajectory_is_complete() -> None:
    way, speed = 0.02, 0.1  # rev, rev/s
    registers = ((0x20, way), (0x28, speed), (0x27, math.nan))
    device = running(POSITION, *registers)
    assert asked(device, 0x00B, 0.0021) == 0.0
    commanded(device, POSITION, 0.5 * way / speed, *registers)  # the same again does not begin anew
    assert asked(device, 0x00B, 0.9 * way / speed) == 0.0
    assert asked(device, 0x00B, 1.1 * way / speed) == 1.0


def test_a_limit_of_acceleration_makes_a_triangle_of_the_speed() -> None:
    way, acceleration = 0.02, 2.0  # rev, rev/s^2
    device = running(POSITION, (0x20, way), (0x29, acceleration), (0x27, math.nan))
    law = device.motor.law
    assert law.duration == pytest.approx(2.0 * math.sqrt(way / acceleration))
    position, velocity = law._at(0.5 * law.duration)
    assert position == pytest.approx(0.5 * way * TURN)
    assert velocity == pytest.approx(math.sqrt(way * acceleration) * TURN)


def test_without_limits_a_position_is_commanded_at_once() -> None:
    device = running(POSITION, (0x20, 0.1), (0x27, 1.0))
    assert asked(device, 0x00B, 0.01) == 1.0
