"""The joint of an emulated drive whose plant is not given."""

from __future__ import annotations

from typing import Any

import pytest

from sim_backend.wire.canbus.impedance import Impedance
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.cia402.tables import MODELS as CIA402
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.dynamixel.tables import MODELS as DYNAMIXEL
from sim_backend.wire.dynamixel.tables import MX_MODELS
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.feetech.tables import MODELS as FEETECH
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.mit.tables import MODELS as MIT
from sim_backend.wire.moteus.device import MoteusDevice
from sim_backend.wire.odrive.device import OdriveDevice
from sim_backend.wire.robstride.device import RobstrideDevice
from sim_backend.wire.robstride.tables import MODELS as ROBSTRIDE

DRIVES: list[tuple[str, Any, float]] = [
    *((name, lambda n=name: DynamixelDevice(n), spec.stall[2]) for name, spec in DYNAMIXEL.items()),
    *((name, lambda n=name: MxDevice(n), spec.stall[2]) for name, spec in MX_MODELS.items()),
    *((name, lambda n=name: FeetechDevice(n), spec.stall[2]) for name, spec in FEETECH.items()),
    *((name, lambda n=name: MitDevice(n), spec.span[2]) for name, spec in MIT.items()),
    *((name, lambda n=name: RobstrideDevice(n), spec.span[1]) for name, spec in ROBSTRIDE.items()),
    *((name, lambda n=name: Cia402Device(n), 0.09) for name in CIA402),  # 4.5 A, or three times the rated torque
    *((f"odrive {name}", lambda n=name: OdriveDevice(firmware=n), 2.0) for name in ("0.5.6", "0.6.10")),
    ("moteus", MoteusDevice, 5.0),
]


@pytest.mark.parametrize(("make", "most"), [row[1:] for row in DRIVES], ids=[row[0] for row in DRIVES])
def test_a_fifth_of_the_torque_limit_turns_the_default_joint_by_half_a_radian(make: Any, most: float) -> None:
    motor = make().motor
    motor.enable()
    motor.follow(Impedance(feedforward=0.2 * most))
    motor.run(3.0)  # a heavy rotor comes to rest slowly
    assert motor.position == pytest.approx(0.5, rel=0.03)
