"""The modes of an emulated Damiao beside MIT, byte by byte."""

from __future__ import annotations

import struct

import pytest

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.mit.device import FORCE_POSITION, POSITION_SPEED, SPEED, SPEED_GAIN, MitDevice

ENTER = bytes([0xFF] * 7 + [0xFC])
TORQUE_RANGE = 10.0  # N m, of the DM-J4310


def motor_in(mode: int) -> MitDevice:
    device = MitDevice("dm-j4310", 5, reply_id=0x15)
    device.handle(CanFrame(0x7FF, bytes([5, 0, 0x55, 10, mode, 0, 0, 0])), 0.0)
    device.handle(CanFrame(5, ENTER), 0.0)
    return device


def tell(device: MitDevice, mode: int, data: bytes) -> CanFrame:
    (reply,) = device.handle(CanFrame(0x100 * (mode - 1) + 5, data), 0.0)
    return reply


def fastest(device: MitDevice, seconds: float) -> float:
    """Return the highest speed on the way, rad/s."""
    highest = 0.0
    for step in range(1, int(seconds * 1000) + 1):
        device.advance(step * 1e-3)
        highest = max(highest, abs(device.motor.velocity))
    return highest


def test_a_register_is_kept_without_power_once_it_is_stored() -> None:
    device = motor_in(SPEED)
    store = CanFrame(0x7FF, bytes([5, 0, 0xAA, 1, 0, 0, 0, 0]))
    device.handle(store, 0.0)  # not while it is enabled
    device.reboot(0.0)
    assert device.values[10] == 1.0
    device.handle(CanFrame(0x7FF, bytes([5, 0, 0x55, 10, SPEED, 0, 0, 0])), 1.0)
    device.handle(store, 1.0)
    device.reboot(1.0)
    assert device.values[10] == float(SPEED)


def test_force_position_goes_to_its_position_within_the_speed_that_it_is_given() -> None:
    device = motor_in(FORCE_POSITION)
    tell(device, FORCE_POSITION, struct.pack("<fHH", 0.2, 200, 10_000))  # 2 rad/s
    assert 1.0 < fastest(device, 3.0) < 2.0 * 1.2
    assert device.motor.position > 0.1


@pytest.mark.parametrize("share", [500, 100, 0])
def test_force_position_has_no_more_torque_than_the_share_that_it_is_given(share: int) -> None:
    device = motor_in(FORCE_POSITION)
    tell(device, FORCE_POSITION, struct.pack("<fHH", 3.0, 10_000, share))
    assert device.motor.demand == pytest.approx(share * 1e-4 * TORQUE_RANGE)
    device.advance(2.0)
    assert abs(device.motor.torque) <= share * 1e-4 * TORQUE_RANGE * 1.001


def test_more_than_the_whole_is_the_whole() -> None:
    device = motor_in(FORCE_POSITION)
    tell(device, FORCE_POSITION, struct.pack("<fHH", 1e6, 0xFFFF, 0xFFFF))
    assert device.motor.demand == min(TORQUE_RANGE, SPEED_GAIN * device.model.span[2] * 100.0)


def test_position_and_speed_keeps_to_the_speed_that_it_is_given() -> None:
    device = motor_in(POSITION_SPEED)
    tell(device, POSITION_SPEED, struct.pack("<ff", 0.2, 2.0))
    assert 1.0 < fastest(device, 3.0) < 2.0 * 1.2
    still = motor_in(POSITION_SPEED)
    tell(still, POSITION_SPEED, struct.pack("<ff", 0.2, 0.0))
    assert fastest(still, 0.5) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("mode", [POSITION_SPEED, SPEED, FORCE_POSITION])
def test_the_identifier_of_another_mode_is_not_heard(mode: int) -> None:
    device = motor_in(1)
    assert device.handle(CanFrame(0x100 * (mode - 1) + 5, struct.pack("<ff", 1.0, 1.0)), 0.0) == []
    assert device.motor.demand == 0.0
