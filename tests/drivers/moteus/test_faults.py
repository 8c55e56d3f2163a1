"""Faults that only a moteus has; those of every drive are in test_fault_contract.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.servo import Command, DeviceFault, DriverError, Limits, Quantity
from sim_backend.wire.moteus.device import OUTSIDE_LIMIT, STOPPED

Make = Callable[..., Any]
LIMITS = Limits(torque=0.4, velocity=60.0, temperature=70.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.1)


def test_firmware_without_a_register_is_named_with_its_remedy(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.device.unknown.add(0x070)
    with pytest.raises(DriverError, match=r"refuses reading register 0x070.*moteus_tool --flash"):
        rig.open()


def test_firmware_without_a_limit_is_named_and_stays_stopped(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = rig.open()
    del rig.device.console.values["servo.timeout_mode"]
    with pytest.raises(DriverError, match=r"servo\.timeout_mode.*firmware"):
        servo.arm(LIMITS)
    assert rig.device.mode == STOPPED


def test_a_position_outside_its_bounds_is_reported_on_arming(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = rig.open()
    rig.device.console.values["servopos.position_min"] = 0.5
    with pytest.raises(DeviceFault, match=r"servopos\.position_min") as caught:
        servo.arm(LIMITS)
    assert caught.value.code == OUTSIDE_LIMIT
