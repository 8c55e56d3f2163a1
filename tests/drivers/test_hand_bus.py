"""A hand of many servos on one line: one is driven, the others are watched, and all are switched off together."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import pytest

from drivers.servo import Command, DriverError, Limits, Quantity
from drivers.torque_off import confirm_torque_off
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.feetech.device import FeetechDevice

from .conftest import FEETECH_LIMITS, MX_LIMITS, SERVO_LIMITS, Rig, feetech_rig, new_rig, small_joint

JOINTS = {f"joint {ident}": ident for ident in range(1, 5)}


class Family(NamedTuple):
    """A family of servos: its rig, a further servo, the limits, and the address of Torque Enable."""

    rig: Callable[[], Rig]
    servo: Callable[..., Any]
    limits: Limits
    enable: int


FAMILIES = {
    "dynamixel": Family(new_rig, partial(DynamixelDevice, "xl330-m288"), SERVO_LIMITS, 64),
    "dynamixel mx": Family(partial(new_rig, "mx-64"), partial(MxDevice, "mx-64"), MX_LIMITS, 24),
    "feetech": Family(feetech_rig, partial(FeetechDevice, "hls3930m"), FEETECH_LIMITS, 40),
}


@pytest.fixture(params=FAMILIES)
def family(request: pytest.FixtureRequest) -> Family:
    return FAMILIES[request.param]


def hand_of(family: Family) -> tuple[Rig, Any]:
    """Return the rig of a hand, all of whose servos but the first hold torque; and the servo 1, which is open."""
    rig = family.rig()
    rig.bus.devices += [family.servo(ident, parameters=small_joint()) for ident in JOINTS.values() if ident > 1]
    for device in rig.bus.devices[1:]:
        device.write(family.enable, b"\1")
    servo = rig.open()
    servo.join_hand(JOINTS)
    return rig, servo


def on(rig: Rig) -> list[int]:
    return [device.line.id for device in rig.bus.devices if device.motor.enabled]


def drive(rig: Rig, servo: Any, limits: Limits, exchanges: int) -> None:
    for _ in range(exchanges):
        servo.exchange(Command(Quantity.TORQUE, 0.5 * limits.torque))
        rig.wait(2e-3)


def test_a_torque_off_switches_off_all_servos_of_the_hand_with_one_packet_and_opening_one_none(family: Family) -> None:
    rig, servo = hand_of(family)
    assert on(rig) == [2, 3, 4]
    for switch_off in (servo.disarm, lambda: [rig.port.writePort(packet) for packet in servo.off_path().off]):
        for device in rig.bus.devices[1:]:
            device.write(family.enable, b"\1")
        servo.arm(family.limits)
        drive(rig, servo, family.limits, 12)
        assert on(rig) == [1, 2, 3, 4]
        switch_off()
        rig.wait(5e-3)
        assert on(rig) == []
    servo.join_hand({str(ident): ident for ident in range(1, 18)})
    assert max(map(len, servo.off_path().off)) == (48 if family.enable == 64 else 42)
    servo.close()


def test_every_servo_that_does_not_confirm_is_named_and_the_others_are_off(family: Family) -> None:
    rig, servo = hand_of(family)
    servo.arm(family.limits)
    rig.bus.devices[1].life.ignores_off = rig.bus.devices[3].life.ignores_off = True
    with pytest.raises(DriverError, match=r"servo 2 .joint 2. is still on; servo 4 .joint 4. is still on"):
        servo.disarm()
    assert on(rig) == [2, 4]
    servo.close()


def test_the_alarm_names_them_although_the_last_request_had_no_time_for_its_replies() -> None:
    rig, servo = hand_of(FAMILIES["feetech"])
    servo.arm(FEETECH_LIMITS)
    rig.bus.devices[1].life.ignores_off = True
    alarms: list[str] = []
    assert not confirm_torque_off(servo, alarm=alarms.append).confirmed
    assert "CUT THE POWER: the torque-off is not confirmed (servo 2 (joint 2) is still on)" in alarms[0]
    servo.close()


def reports_an_error(rig: Rig) -> None:
    rig.bus.devices[3].fail(0x20)  # an overload in every family


def is_unplugged(rig: Rig) -> None:
    del rig.bus.devices[3]


def obeys_the_id_of_another(rig: Rig) -> None:
    rig.bus.devices[3].motor.follow(rig.motor.law)  # what turns the driven motor turns this one


FAULTS: dict[Callable[[Rig], None], str] = {
    reports_an_error: r"servo 4 .joint 4. of this hand reports an error .0x",
    is_unplugged: r"servo 4 .joint 4. of this hand does not answer any more",
    obeys_the_id_of_another: r"servo 1 is driven and turned by .* servo 4 .joint 4. turned by .* the wrong joint",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_happens_to_a_neighbour_ends_the_run_of_the_driven_one(
    family: Family, fault: Callable[[Rig], None]
) -> None:
    rig, servo = hand_of(family)
    servo.arm(family.limits)
    drive(rig, servo, family.limits, 35)
    fault(rig)
    with pytest.raises(DriverError, match=FAULTS[fault]):
        drive(rig, servo, family.limits, 60)
    servo.close()
    assert on(rig) == []


def test_a_hand_of_which_one_servo_does_not_answer_is_not_driven(family: Family) -> None:
    rig, servo = hand_of(family)
    is_unplugged(rig)
    with pytest.raises(DriverError, match=r"servo 4 .joint 4. of this hand does not answer .* nothing was driven"):
        servo.arm(family.limits)
    assert not rig.motor.enabled
    servo.close()
