"""Frames that no drive would send: an adapter raises errors of its own only, and can switch the torque off."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.servo import Command, DriverError, Limits, Quantity
from sim_backend.wire.canbus.bus import CanDelivery
from sim_backend.wire.canbus.frames import CanFrame

from ..conftest import sampled

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


def damaged(frame: CanFrame, rng: np.random.Generator) -> CanFrame:
    """A reply that is cut short, empty, changed, or a heartbeat of any node in any state."""
    kind = int(rng.integers(4))
    if kind == 0:
        return replace(frame, data=frame.data[: int(rng.integers(len(frame.data) + 1))])
    if kind == 1:
        return replace(frame, data=b"")
    if kind == 2:
        return replace(frame, ident=0x700 + int(rng.integers(128)), data=rng.bytes(int(rng.integers(9))))
    return mangled(frame, rng)


@sampled(5)
@pytest.mark.parametrize("kind", ["odrive", "mit", "moteus", "cia402", "robstride"])
def test_damaged_replies_while_it_is_opened_armed_and_stopped_raise_only_named_errors(
    request: pytest.FixtureRequest, kind: str, nth: int
) -> None:
    make: Callable[..., Any] = request.getfixturevalue(f"make_{kind}")
    opened = 0
    for seed in range(0, 30, nth):
        rng, rig = np.random.default_rng(seed), make()
        share = (0.02, 0.1, 0.3)[seed % 3]

        rig.bus.receive = partial(damaging, rig.bus.receive, rng, share)
        with contextlib.suppress(DriverError):
            servo = rig.open()
            opened += 1
            for call in (partial(servo.arm, LIMITS), partial(servo.exchange, PUSH), servo.disarm) * 2:
                with contextlib.suppress(DriverError):
                    call()
            servo.close()
    assert opened >= 10 // nth


def damaging(receive: Any, rng: np.random.Generator, share: float, frame: CanFrame, now: float) -> list[CanDelivery]:
    """The replies to a frame, of which a share is damaged."""
    return [CanDelivery(at, damaged(one, rng) if rng.random() < share else one) for at, one in receive(frame, now)]
