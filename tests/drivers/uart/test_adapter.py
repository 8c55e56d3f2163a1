"""Adapters that hold replies back, and those that return what was sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.dynamixel.identity import search
from drivers.servo import Command, DriverError, Limits, NoReply, Quantity
from drivers.uart.adapter import Echo
from sim_backend.wire.canbus.bus import CanTiming
from sim_backend.wire.commander.emulator import CommanderTiming
from sim_backend.wire.faults import DropReplies
from sim_backend.wire.packets.bus import PacketTiming

from .. import conftest as rigs

HOLDS = 0.016
PACKETS: dict[str, tuple[Callable[[], Any], Limits]] = {
    "x": (rigs.new_rig, rigs.SERVO_LIMITS),
    "mx": (lambda: rigs.new_rig("mx-64"), rigs.MX_LIMITS),
    "hls": (rigs.feetech_rig, rigs.FEETECH_LIMITS),
}


CAN = {
    "odrive": rigs.odrive_rig,
    "mit": rigs.mit_rig,
    "robstride": rigs.robstride_rig,
    "moteus": rigs.moteus_rig,
    "cia402": rigs.cia402_rig,
}


def rig_with(name: str, **timing: Any) -> tuple[Any, Limits]:
    if name in CAN:
        rig = CAN[name]()
        rig.bus._timing = CanTiming(latency=timing["usb_latency"])
        return rig, rigs.ODRIVE_LIMITS
    if name == "commander":
        rig, limits = rigs.new_foc(), rigs.SIM_LIMITS
        rig.bus._timing = CommanderTiming(**timing)
        return rig, limits
    make, limits = PACKETS[name]
    rig = make()
    rig.bus._timing = PacketTiming(**timing)
    return rig, limits


@pytest.mark.parametrize("name", [*PACKETS, *CAN, "commander"])
def test_replies_that_the_adapter_holds_back_are_recognised_and_a_longer_timeout_reads_them(name: str) -> None:
    rig, limits = rig_with(name, usb_latency=HOLDS)
    with pytest.raises(DriverError, match=r"1[56][.\d]* ms late, and reply_timeout is (8|10) ms.*raise reply_timeout"):
        rig.open()
    servo = rig.armed(limits, reply_timeout=0.03)
    rig.faults.inject(DropReplies(count=3))  # a board's three lines
    with pytest.raises(NoReply):
        servo.exchange(Command(Quantity.TORQUE, 0.0))
    rig.faults.clear()
    begun = rig.clock.now()
    servo.exchange(Command(Quantity.TORQUE, 0.0))
    assert rig.clock.now() >= begun + 2.0 * HOLDS  # it waited until no late reply could come
    servo.close()


@pytest.mark.parametrize("name", PACKETS)
@pytest.mark.parametrize("latency", [1e-3, HOLDS])
def test_what_the_adapter_returns_of_our_own_is_read_past(name: str, latency: float) -> None:
    rig, limits = rig_with(name, usb_latency=latency, echo=True)
    servo = rig.armed(limits, reply_timeout=0.03)
    push = Command(Quantity.TORQUE, 0.5 * limits.torque)
    for _ in range(20):
        sample = servo.exchange(push)
    assert sample.motor_torque == pytest.approx(rig.motor.torque, rel=0.1)
    rig.faults.inject(DropReplies())
    with pytest.raises(NoReply):
        servo.exchange(push)
    servo.exchange(push)
    servo.disarm()
    assert not rig.motor.enabled
    servo.close()


def test_what_a_simplefoc_board_returns_of_our_own_confirms_nothing() -> None:
    rig, limits = rig_with("commander")
    rig.bus.device.echo = True
    servo = rig.armed(limits)
    for value in (1e-3, -2e-3):
        for _ in range(20):
            sample = servo.exchange(Command(Quantity.TORQUE, value))
        assert sample.motor_torque == pytest.approx(value, rel=0.1)
    rig.bus.garble("ME0", "MX0")  # every one of a request
    rig.bus.garble("ME0", "MX0")
    servo.disarm()
    assert not rig.motor.enabled
    servo.close()


def test_a_search_takes_no_echo_for_a_servo() -> None:
    rig, _ = rig_with("x", echo=True)
    port = rig.port
    assert [line.partition(" at ")[0] for line in search(rig.config, rig.clock, port)] == [
        "a xl330-m288 answers with id 1"
    ]


def test_a_reply_that_equals_its_request_is_a_reply_once_the_line_is_known() -> None:
    ping, read = b"\xff\xff\x01\x02\x01\xfb", b"\xff\xff\x01\x04\x02\x00\x05\xf3"
    reply = b"\xff\xff\x01\x03\x00\x07\xf4"
    for returns in (False, True):
        echo = Echo()
        for request, answer in ((read, reply), (ping, ping)):
            echo.sent(request)
            arriving = (request if returns else b"") + answer
            assert b"".join(echo.without(bytes([byte])) for byte in arriving) == answer
