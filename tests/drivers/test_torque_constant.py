"""A torque constant that is wrong by a factor of 1000, both ways, and one that was measured."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import pytest

from drivers.servo import DriverError

from . import conftest as rigs

CASES: dict[str, tuple[Callable[[], rigs.Rig], Any, float]] = {
    "dynamixel": (rigs.new_rig, rigs.SERVO_LIMITS, 0.36),
    "feetech hls of the table": (lambda: rigs.feetech_rig("hls3930m"), rigs.FEETECH_LIMITS, 1.2),
    "feetech hls": (lambda: rigs.feetech_rig("hls3606m"), rigs.FEETECH_LIMITS, 0.5),
    "feetech sts": (lambda: rigs.feetech_rig("sts3215"), rigs.STS_LIMITS, 1.09),
    "odrive": (rigs.odrive_rig, rigs.ODRIVE_LIMITS, 0.04),
    "epos4": (lambda: rigs.cia402_rig("epos4"), rigs.CIA402_LIMITS, 0.02),
    "epos2": (lambda: rigs.cia402_rig("epos2"), rigs.CIA402_LIMITS, 0.02),
    "commander": (rigs.new_foc, rigs.SIM_LIMITS, 0.0145),
}


# no table and no reading of these contradicts them
CANNOT_BE_KNOWN = {("commander", 0.02), ("commander", 50.0), ("odrive", 0.02), ("epos2", 50.0)}
WRONG = [case for case in product(CASES, (1e-3, 0.02, 50.0, 1e3)) if case not in CANNOT_BE_KNOWN]


@pytest.mark.parametrize(("name", "factor"), WRONG)
def test_a_wrong_torque_constant_is_refused_with_its_number(name: str, factor: float) -> None:
    make, limits, constant = CASES[name]
    rig = make()
    with pytest.raises((ValueError, DriverError), match=f"torque_constant.* {constant * factor:g} N m/A"):
        rig.open(torque_constant=constant * factor).arm(limits)
    assert not rig.motor.commanded


@pytest.mark.parametrize("share", [0.6, 1.6])
@pytest.mark.parametrize(
    "name", sorted(CASES.keys() - {"epos4"})
)  # an EPOS4 states its constant, which the stand file repeats
def test_a_measured_torque_constant_within_the_spread_of_the_makers_is_accepted(name: str, share: float) -> None:
    make, limits, constant = CASES[name]
    rig = make()
    rig.open(torque_constant=constant * share).arm(limits)
    assert rig.motor.enabled


def test_a_rated_torque_that_is_not_the_drive_s_is_refused() -> None:
    with pytest.raises(DriverError, match=r"rated_torque is 30 N m .+ and 0\.03 N m in the drive"):
        rigs.cia402_rig("epos4").open(rated_torque=30.0)
