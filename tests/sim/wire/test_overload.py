"""The overload protection of emulated servos."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from sim_backend.parameters import CouplingParameters, FixtureParameters, SimParameters
from sim_backend.wire.dynamixel import device as dynamixel
from sim_backend.wire.dynamixel import tables as dynamixel_tables
from sim_backend.wire.feetech import device as feetech
from sim_backend.wire.feetech import tables as feetech_tables
from sim_backend.wire.packets.regulator import joint_at_horn


def blocked(model: Any) -> SimParameters:
    """Return a joint that turns by a quarter of a radian under the stall torque."""
    stall = model.stall[2]
    joint = joint_at_horn(model, None)
    motor = replace(joint.motor, inertia=1e-3 * stall)  # heavy, as with its gears: the loops reach the stall torque
    coupling = CouplingParameters(stiffness=4.0 * stall, damping=0.1 * stall)
    return replace(
        joint, motor=motor, coupling=coupling, fixture=FixtureParameters(stiffness=1e4, damping=1.0, inertia=1e-3)
    )


def test_an_sts_that_is_blocked_for_two_seconds_keeps_a_fifth_of_its_torque_until_it_is_sent_back() -> None:
    servo = feetech.FeetechDevice("sts3215", parameters=blocked(feetech_tables.MODELS["sts3215"]))
    servo.mount_at_middle()
    servo.write(42, (3000).to_bytes(2, "little"))
    stall = servo.model.stall[2]
    servo.advance(1.9)
    assert servo.motor.torque > 0.9 * stall
    assert not servo.errors
    servo.advance(3.0)
    assert servo.errors == feetech.OVERLOAD
    assert servo.motor.torque == pytest.approx(0.2 * stall, rel=0.02)
    servo.write(42, (3100).to_bytes(2, "little"))
    assert servo.errors == feetech.OVERLOAD
    servo.write(42, (1000).to_bytes(2, "little"))
    assert not servo.errors


def test_an_scs_that_rests_is_not_overloaded() -> None:
    servo = feetech.FeetechDevice("scs0009")
    servo.write(42, (520).to_bytes(2, "big"))
    servo.advance(5.0)
    assert not servo.errors


@pytest.mark.parametrize(("shutdown", "on"), [(0x34, False), (0x14, True)])
def test_a_dynamixel_at_its_largest_output_switches_off_if_shutdown_says_so(shutdown: int, on: bool) -> None:
    servo = dynamixel.DynamixelDevice("xm430-w350", parameters=blocked(dynamixel_tables.MODELS["xm430-w350"]))
    servo.registers.put("shutdown", shutdown)
    servo.write(64, b"\1")
    servo.write(116, (1500).to_bytes(4, "little"))
    servo.advance(1.9)
    assert servo.motor.enabled
    servo.advance(5.0)
    assert servo.motor.enabled is on
    assert servo.registers.get("hardware_error_status") == dynamixel.OVERLOAD
