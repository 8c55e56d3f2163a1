"""Faults that only an ODrive has; those of every drive are in test_fault_contract.py."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.servo import Command, DriverError, Limits, Quantity
from sim_backend.wire.odrive.device import WATCHDOG

Make = Callable[..., Any]
LIMITS = Limits(torque=0.4, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.1)
FIRMWARES = ["0.5.6", "0.6.10"]


def armed(rig: Any, **changes: Any) -> Any:
    servo = rig.armed(LIMITS, **changes)
    rig.wait(2e-3)
    servo.exchange(PUSH)
    return servo


def test_parameters_over_can_are_refused_for_firmware_that_has_none(make_odrive: Make, tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="remove it"):
        make_odrive("0.5.6").open(endpoints=str(tmp_path))


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_watchdog_that_ran_out_before_we_came_is_no_fault(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    rig.device.endpoints.put("axis0.config.enable_watchdog", 1.0)
    rig.device.endpoints.put("axis0.config.watchdog_timeout", 0.2)
    rig.device.fail(WATCHDOG[rig.device.layout])
    servo = armed(rig)
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_an_axis_that_is_not_calibrated_is_reported(make_odrive: Make) -> None:
    rig = make_odrive()
    servo = rig.open()
    rig.device.calibrated = False
    with pytest.raises(DriverError, match="calibrate motor and encoder"):
        servo.arm(LIMITS)


def test_cyclic_messages_of_torque_are_no_offence(make_odrive: Make) -> None:
    rig = make_odrive()
    rig.device.endpoints.put("axis0.config.can.torques_msg_rate_ms", 10.0)
    servo = armed(rig)
    for _ in range(50):
        rig.wait(2e-3)
        assert servo.exchange(PUSH).motor_torque > 0.0
