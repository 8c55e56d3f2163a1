"""Frames that no drive would send: an adapter raises errors of its own only, and can switch the torque off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.servo import Command, DeviceFault, DriverError, Limits, Quantity
from sim_backend.wire.canbus.bus import CanDelivery
from sim_backend.wire.canbus.frames import CanFrame

LIMITS = Limits(torque=0.4, velocity=60.0, temperature=85.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.1)


def mangled(frame: CanFrame, rng: np.random.Generator) -> CanFrame:
    data = bytearray(frame.data)
    for _ in range(int(rng.integers(4))):
        if data:
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
    if rng.random() < 0.3:
        data = data[: int(rng.integers(len(data) + 1))]
    ident = frame.ident ^ (1 << int(rng.integers(11))) if rng.random() < 0.2 else frame.ident
    return replace(frame, ident=ident, data=bytes(data), remote=bool(rng.random() < 0.05))


@pytest.mark.parametrize("kind", ["odrive", "mit", "moteus", "cia402"])
def test_whatever_arrives_only_named_errors_come_out_and_the_torque_goes_off(
    request: pytest.FixtureRequest, kind: str
) -> None:
    rng = np.random.default_rng(17)
    make: Callable[..., Any] = request.getfixturevalue(f"make_{kind}")
    rig = make()
    servo = rig.open(watchdog=2.0)
    servo.arm(LIMITS)
    receive = rig.bus.receive

    def spoil(frame: CanFrame, now: float) -> list[CanDelivery]:
        return [CanDelivery(at, mangled(reply, rng)) for at, reply in receive(frame, now)]

    for _ in range(400):
        rig.bus.receive = spoil
        rig.wait(2e-3)
        try:
            servo.exchange(PUSH)
        except DeviceFault:  # a mangled status is believed, as any status is: the recorder would stop here
            rig.bus.receive = receive
            servo.disarm()
            servo.arm(LIMITS)
        except DriverError:
            continue
    rig.bus.receive = receive
    servo.disarm()
    assert rig.device.motor.torque == 0.0
    assert not rig.device.motor.enabled
    servo.close()
