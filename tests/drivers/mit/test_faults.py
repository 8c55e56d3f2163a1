"""Faults that only a motor on MIT frames has; those of every drive are in test_fault_contract.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.servo import BadReply, Command, DriverError, Limits, NoReply, Quantity

Make = Callable[..., Any]
LIMITS = Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 1.0)
MOTORS = ["ak80-9", "dm-j4310"]


def test_a_reply_with_another_identifier_is_not_ours(make_mit: Make) -> None:
    with pytest.raises(NoReply, match=r"mit\.reply_id"):
        make_mit(reply_id=0x11).open()
    make_mit(reply_id=0x11).open(reply_id=0x11).close()


def test_the_wrong_model_is_an_error_that_names_both(make_mit: Make) -> None:
    rig = make_mit("dm-j6006")
    with pytest.raises(DriverError, match=r"torque_range of 20, and \[mit\] has 10 for the dm-j4310"):
        rig.open(model="dm-j4310", velocity_range=45.0)
    with pytest.raises(DriverError, match=r"velocity_range of 45"):
        make_mit("dm-j6006").open(model="dm-j4310")


def test_changed_ranges_can_be_set_in_the_stand_file(make_mit: Make) -> None:
    rig = make_mit()
    rig.device.values[23] = 5.0
    servo = rig.open(torque_range=5.0)
    assert servo.info.torque_lsb == pytest.approx(10.0 / 4095)


def test_a_position_at_the_end_of_its_range_is_no_sample(make_mit: Make) -> None:
    rig = make_mit()
    servo = rig.open()
    rig.device._zero = 20.0
    with pytest.raises(BadReply, match="end of its range"):
        servo.exchange(Command.rest())
    servo.arm(LIMITS)
    servo.disarm()  # is confirmed all the same
    assert not rig.motor.enabled
