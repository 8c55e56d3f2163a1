"""Every drive on a CAN bus: what it reports has the stand's sign and is SI."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from drivers.servo import Command, Quantity
from sim_backend.wire.mit.tables import MODELS as MIT_MODELS

from ..conftest import (
    CIA402_LIMITS,
    MIT_LIMITS,
    ODRIVE_LIMITS,
    Rig,
    cia402_rig,
    mit_rig,
    moteus_rig,
    odrive_rig,
    robstride_rig,
)

TURN = 2.0 * math.pi
# make, limits, push N m, the drive's own torque limit N m, one count of the torque N m and of the angle rad
DRIVES: dict[str, tuple[Callable[[], Rig], Any, float, float, float, float]] = {
    **{
        f"odrive {firmware}": (lambda f=firmware: odrive_rig(f), ODRIVE_LIMITS, 0.2, 2.0, 0.02 * 0.04, TURN / 16384)  # type: ignore[misc]  # bound now
        for firmware in ("0.5.6", "0.6.10")
    },
    **{
        f"cia402 {model}": (lambda m=model: cia402_rig(m), CIA402_LIMITS, 0.02, 0.09, 30e-6, TURN / 4096)  # type: ignore[misc]  # bound now
        for model in ("epos4", "epos2", "generic")
    },
    **{
        f"mit {model}": (
            lambda m=model: mit_rig(m),  # type: ignore[misc]  # bound now
            MIT_LIMITS,
            1.0,
            MIT_MODELS[model].span[2],
            3.0 * MIT_MODELS[model].span[2] / 4095,
            2.0 * MIT_MODELS[model].span[0] / 65535,
        )
        for model in ("ak80-9", "dm-j4310")
    },
    "robstride": (
        robstride_rig,
        MIT_LIMITS,
        1.0,
        14.0,
        6.0 * 14.0 / 65535,
        8.0 * math.pi / 65535,
    ),
    "moteus": (moteus_rig, ODRIVE_LIMITS, 0.2, 5.0, 2e-3, TURN / 16384),
}


@pytest.mark.parametrize("name", DRIVES)
def test_torque_and_motion_have_the_stands_sign_and_are_si(name: str) -> None:
    make, limits, push, most, torque_count, angle_count = DRIVES[name]
    rig = make()
    servo = rig.armed(limits, sign=-1)
    for _ in range(500):  # until a heavy rotor rests
        rig.wait(2e-3)
        sample = servo.exchange(Command(Quantity.TORQUE, push))
    assert sample.motor_torque == pytest.approx(push, abs=torque_count)
    assert sample.motor_position == pytest.approx(-rig.motor.position, abs=angle_count)
    assert sample.motor_position == pytest.approx(0.5 * push / (0.2 * most), rel=0.02)
    assert rig.motor.torque < 0.0
    servo.close()
    assert not rig.motor.enabled
