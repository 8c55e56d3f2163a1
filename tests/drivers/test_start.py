"""A servo is opened and armed over a link that loses 2 % of its replies; in a run nothing is asked twice."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.servo import Command, NoReply
from sim_backend.wire.faults import DropReplies

from .conftest import RIGS

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
        servo = rig.armed(limits)
        assert rig.motor.enabled
        lost += int(np.count_nonzero(drops < rig.faults.replies))
        servo.close()


@pytest.mark.parametrize("name", RIGS)
def test_in_a_run_a_lost_reply_is_a_gap_and_is_not_waited_for_again(name: str) -> None:
    make, limits = RIGS[name]
    rig = make()
    servo = rig.armed(limits)
    servo.exchange(Command.rest())
    rig.faults.inject(DropReplies(count=10))
    begin = servo.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(Command.rest())
    assert servo.clock.now() - begin < 2.0 * servo._config.reply_timeout
    rig.faults.clear()
    servo.close()
