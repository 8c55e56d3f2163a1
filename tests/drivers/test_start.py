"""A servo is opened and armed over a link that loses 2 % of its replies; in a run nothing is asked twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.servo import Command, Limits, NoReply
from sim_backend.wire.faults import DropReplies

from .conftest import (
    CIA402_LIMITS,
    MIT_LIMITS,
    MX_LIMITS,
    ODRIVE_LIMITS,
    SERVO_LIMITS,
    SIM_LIMITS,
    cia402_rig,
    feetech_rig,
    mit_rig,
    moteus_rig,
    new_foc,
    new_rig,
    odrive_rig,
    robstride_rig,
)

RIGS: dict[str, tuple[Callable[[], Any], Limits]] = {
    "dynamixel": (new_rig, SERVO_LIMITS),
    "dynamixel mx": (lambda: new_rig("mx-64"), MX_LIMITS),
    "feetech": (feetech_rig, SERVO_LIMITS),
    "odrive 0.5.6": (lambda: odrive_rig("0.5.6"), ODRIVE_LIMITS),
    "odrive 0.6.10": (lambda: odrive_rig("0.6.10"), ODRIVE_LIMITS),
    "mit ak80-9": (lambda: mit_rig("ak80-9"), MIT_LIMITS),
    "mit dm-j4310": (lambda: mit_rig("dm-j4310"), MIT_LIMITS),
    "robstride": (robstride_rig, MIT_LIMITS),
    "moteus": (moteus_rig, ODRIVE_LIMITS),
    "cia402 epos4": (lambda: cia402_rig("epos4"), CIA402_LIMITS),
    "commander": (new_foc, SIM_LIMITS),
}
REPLIES, LOST = 1000, 0.02


@pytest.mark.study
@pytest.mark.parametrize("name", RIGS)
def test_every_start_succeeds_where_two_percent_of_the_replies_are_lost(name: str) -> None:
    make, limits = RIGS[name]
    rng, lost = np.random.default_rng(0), 0
    while lost < 20:
        rig = make()
        drops = np.flatnonzero(rng.random(REPLIES) < LOST)
        for reply in drops:
            rig.faults.inject(DropReplies(after=int(reply)))
        servo = rig.open()
        servo.arm(limits)
        lost += int(np.count_nonzero(drops < rig.faults.replies))
        servo.close()


@pytest.mark.parametrize("name", RIGS)
def test_in_a_run_a_lost_reply_is_a_gap_and_is_not_waited_for_again(name: str) -> None:
    make, limits = RIGS[name]
    rig = make()
    servo = rig.open()
    servo.arm(limits)
    servo.exchange(Command.rest())
    rig.faults.inject(DropReplies(count=10))
    begin = servo.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(Command.rest())
    assert servo.clock.now() - begin < 2.0 * servo._config.reply_timeout
    rig.faults.clear()
    servo.close()
