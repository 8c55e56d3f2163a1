"""A hand on a line at the factory's baud rate, where the reading of a neighbour takes as long as half an exchange."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from drivers.servo import Quantity
from hil.acquisition import excitation
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.phases import Outcome
from hil.acquisition.recorder import Recorder
from hil.acquisition.sink import Memory
from hil.doctor.checks import CheckList
from hil.doctor.link_check import check_link
from hil.stand.file import parse
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.feetech.device import FeetechDevice

from ...drivers.conftest import Rig, feetech_rig, new_rig, small_joint

STAND = parse(
    "[stand]\ntorque_stays_on_if_host_dies = true\n[limits]\ntorque = 0.03\ndeflection = 3.0\nvelocity = 60.0\n"
)
LINES: dict[str, tuple[Callable[..., Rig], Callable[..., Any]]] = {
    "dynamixel": (new_rig, partial(DynamixelDevice, "xl330-m288")),
    "feetech": (feetech_rig, partial(FeetechDevice, "hls3930m")),
}


def opened(family: str) -> tuple[Rig, Any]:
    make, servo = LINES[family]
    rig = make(baudrate=57600)
    rig.bus.devices += [servo(ident, baudrate=57600, parameters=small_joint()) for ident in (2, 3)]
    found = rig.open(baudrate=57600)
    found.join_hand({"a": 1, "b": 2, "c": 3})
    return rig, found


def outcome_at(rate: float, family: str) -> Outcome:
    rig, servo = opened(family)
    profile = excitation.make(
        "sine",
        Quantity.TORQUE,
        amplitude=0.01,
        default_amplitude=0.01,
        duration=2.0,
        band=(1.0, 1.0),
        rate=rate,
        fade=0.2,
    )
    outcome = Recorder(STAND, servo, profile, rate, Memory()).run(StopRequest())
    servo.close()
    assert not any(device.motor.enabled for device in rig.bus.devices)
    return outcome


@pytest.mark.parametrize("family", LINES)
def test_a_rate_that_is_too_high_with_neighbours_is_refused_with_one_at_which_no_tick_is_late(family: str) -> None:
    refused = outcome_at(300.0, family)
    assert refused.samples == 0  # nothing was driven
    (most,) = re.findall(r"it reaches at most (\d+) Hz", str(refused.error))
    ended = outcome_at(float(most), family)
    assert (ended.error, ended.late, ended.missed) == (None, 0, 0)
    highest = next(rate for rate in range(3 * int(most) // 2, 0, -1) if outcome_at(rate, family).error is None)
    accepted = outcome_at(highest, family)
    assert (accepted.late, accepted.missed) == (0, 0)
    checks, (_, servo) = CheckList(), opened(family)
    check_link(checks, servo, 300.0, StopRequest())
    assert checks.bus is not None
    assert checks.bus.rate == pytest.approx(float(most), rel=0.05)
    servo.close()
