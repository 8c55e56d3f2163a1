"""An AK that was left in servo mode: what it does with its own frames, and how it is recognised."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import pytest

from drivers.servo import DriverError
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.mit.servo_mode import BRAKE, CURRENT, DUTY, ORIGIN, POSITION, POSITION_SPEED, SPEED, UPLOAD


def driven(kind: int, data: bytes, seconds: float = 1.0) -> MitDevice:
    device = MitDevice("ak80-9", 104, servo=True)
    assert device.handle(CanFrame(kind << 8 | 104, data, extended=True), 0.0) == []
    device.advance(seconds)
    return device


def test_it_reports_by_itself_and_does_not_hear_mit_frames() -> None:
    device = MitDevice("ak80-9", 104, servo=True)
    device.motor.warm_to(31.0)
    (report,) = device.unasked(device.due())
    assert (report.ident, report.extended, report.data) == (0x2968, True, bytes([0, 0, 0, 0, 0, 0, 31, 0]))
    assert device.due() == pytest.approx(UPLOAD)
    assert device.handle(CanFrame(104, bytes([0xFF] * 7 + [0xFC])), 0.0) == []
    assert not device.motor.enabled


def test_its_commands_do_what_the_manual_says() -> None:
    model = MitDevice("ak80-9").model
    device = driven(CURRENT, struct.pack(">i", 2000), 0.3)  # mA
    assert device.motor.torque == pytest.approx(2.0 * model.torque_constant, rel=1e-3)
    current = struct.unpack_from(">h", device.unasked(device.due() + 1.0)[0].data, 4)[0]
    assert current == pytest.approx(200, abs=1)
    assert abs(driven(POSITION, struct.pack(">i", 100_000)).motor.position) > math.radians(2.0)  # 10 deg
    slow = struct.pack(">ihh", 100_000, 10, 0)
    assert 0.0 < driven(POSITION_SPEED, slow, 0.2).motor.position < driven(POSITION, slow, 0.2).motor.position
    for kind, value in ((SPEED, 30_000), (DUTY, 50_000)):
        assert driven(kind, struct.pack(">i", value), 0.05).motor.demand > 0.0
    assert driven(BRAKE, struct.pack(">i", 5000)).motor.demand == pytest.approx(0.0, abs=1e-6)
    assert not driven(ORIGIN, b"\0").motor.enabled
    assert not driven(9, bytes(8)).motor.enabled


@pytest.mark.parametrize("rate", [10.0, 50.0, 500.0])
def test_it_is_recognised_and_its_current_is_switched_off(
    make_mit: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, rate: float
) -> None:
    monkeypatch.setattr("sim_backend.wire.mit.servo_mode.UPLOAD", 1.0 / rate)
    rig = make_mit("ak80-9", servo=True)
    rig.device.handle(CanFrame(CURRENT << 8 | 1, struct.pack(">i", 3000), extended=True), 0.0)
    with pytest.raises(DriverError, match=r"motor 1 is in servo mode .*29 bits.*choose MIT mode"):
        rig.open()
    assert rig.motor.demand == 0.0
    assert rig.closed
