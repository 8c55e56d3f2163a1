"""Torque-off on CAN is sent at once, whatever was lost before and whatever other nodes send."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import can
import pytest

from drivers.servo import BadReply, Command, DriverError, Limits, NoReply, Quantity
from sim_backend.wire.faults import DropReplies, DuplicateReplies

LIMITS = Limits(torque=0.4, velocity=60.0, temperature=85.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.2)


@pytest.fixture(params=["odrive", "mit", "moteus", "cia402", "robstride"])
def pushing(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    make: Callable[..., Any] = request.getfixturevalue(f"make_{request.param}")
    rig = make()
    servo = rig.armed(LIMITS, watchdog=2.0)
    for _ in range(5):
        rig.wait(2e-3)
        servo.exchange(PUSH)
    return rig, servo


def test_torque_off_does_not_wait_for_replies_that_are_still_due(
    pushing: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, servo = pushing
    rig.bus.faults.inject(DropReplies(count=1000))
    for _ in range(3):
        rig.wait(2e-3)
        with contextlib.suppress(NoReply, BadReply):
            servo.exchange(PUSH)
    off: list[float] = []
    disable = rig.device.motor.disable

    def noted() -> None:
        off.append(rig.clock.now())
        disable()

    monkeypatch.setattr(rig.device.motor, "disable", noted)
    begin = rig.clock.now()
    with contextlib.suppress(DriverError):
        servo.disarm()
    assert off[0] - begin < 1e-3
    assert rig.device.motor.torque == 0.0


def test_torque_off_goes_out_though_the_bus_never_falls_silent(pushing: tuple[Any, Any]) -> None:
    rig, servo = pushing
    stranger = can.Message(arbitration_id=0x7A5, data=b"noise", is_extended_id=False)
    rig.port._recv_internal = lambda _: (stranger, False)
    with pytest.raises(DriverError, match="cut the"):
        servo.disarm()
    assert not rig.device.motor.enabled


@pytest.mark.parametrize("kind", ["odrive", "mit", "moteus", "cia402", "robstride"])
def test_a_drive_that_is_refused_when_it_is_opened_is_left_without_torque(
    request: pytest.FixtureRequest, kind: str
) -> None:
    make: Callable[..., Any] = request.getfixturevalue(f"make_{kind}")
    rig = make()
    before = rig.open()
    before.arm(LIMITS)
    before.exchange(PUSH)
    assert rig.device.motor.enabled
    rig.bus.faults.inject(DuplicateReplies(count=3))
    with pytest.raises(BadReply, match="answers twice"):
        rig.open()
    assert not rig.device.motor.enabled
