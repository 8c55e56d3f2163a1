"""The link to a CAN bus: opened by configuration alone, bounded in time, and honest about what it cannot do."""

from __future__ import annotations

import errno
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest
import serial

from drivers.canbus.link import BusConfig, CanLink, frame, open_interface
from drivers.clock import VirtualClock
from drivers.odrive.config import OdriveConfig
from drivers.odrive.servo import OdriveServo
from drivers.servo import BadReply, Command, DriverError, LinkLost, NoReply
from sim_backend.wire.can_families import odrive as serve
from sim_backend.wire.canbus.frames import CanFrame, duration


class Scripted(can.BusABC):
    """Returns the frames it was given; a wait takes virtual time."""

    def __init__(self, clock: VirtualClock, script: list[Any]) -> None:
        super().__init__(channel="scripted")
        self._clock = clock
        self.script = script

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.script:
            self._clock.sleep_until(self._clock.now() + (timeout or 0.0))
            return None, False
        item = self.script.pop(0)
        if isinstance(item, Exception):
            raise item
        return item, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        if self.script:
            raise self.script.pop(0)


def scripted(*script: Any) -> tuple[CanLink, VirtualClock]:
    clock = VirtualClock()
    return CanLink(BusConfig("virtual", "x", 1_000_000), clock, Scripted(clock, list(script))), clock


def test_nothing_is_read_from_configuration_files(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, Any] = {}

    def note(**options: Any) -> None:
        seen.update(options)
        raise can.CanInitializationError("enough")

    monkeypatch.setattr(can, "Bus", note)
    for interface in ("socketcan", "slcan", "pcan", "virtual", "kvaser"):
        for data_bitrate in (0, 5_000_000):
            seen.clear()
            with pytest.raises(DriverError, match="enough"):
                open_interface(BusConfig(interface, "c", 1_000_000, data_bitrate))
            assert seen["ignore_config"] is True
            assert (seen["interface"], seen["channel"]) == (interface, "c")
            if interface in {"slcan", "pcan", "kvaser"}:
                assert "timing" in seen if data_bitrate else seen["bitrate"] == 1_000_000


def test_an_interface_nobody_knows_and_a_port_that_is_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="'slacn'"):
        open_interface(BusConfig("slacn", "x", 1_000_000))
    with pytest.raises(DriverError, match="there is no such port"):
        open_interface(BusConfig("slcan", str(tmp_path / "nothing"), 1_000_000))


def test_the_port_of_a_serial_adapter_passes_bytes_on_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    modes: list[bool] = []
    bus = SimpleNamespace(serialPortOrig=SimpleNamespace(set_low_latency_mode=modes.append))
    monkeypatch.setattr(can, "Bus", lambda **_: bus)
    open_interface(BusConfig("slcan", "/dev/ttyUSB0", 1_000_000))
    assert modes == [True]


def test_a_missing_interface_or_permission_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    for number, words in ((errno.ENODEV, "no such interface"), (errno.EACCES, "dialout"), (errno.ENETDOWN, "ip link")):

        def refuse(*_: Any, code: int = number, **__: Any) -> None:
            raise can.CanInitializationError("refused") from OSError(code, "refused")

        monkeypatch.setattr(can, "Bus", refuse)
        with pytest.raises(DriverError, match=words):
            open_interface(BusConfig("socketcan", "can0", 1_000_000))


def test_a_wait_ends_at_its_deadline() -> None:
    link, clock = scripted()
    assert link.receive(0.25) is None
    assert clock.now() == pytest.approx(0.25)


def test_an_error_frame_is_counted_and_bus_off_is_a_lost_link_that_says_torque_off_cannot_be_sent() -> None:
    good = can.Message(arbitration_id=5, data=b"\x01", is_extended_id=False)
    link, _ = scripted(can.Message(arbitration_id=0x8, is_error_frame=True), good)
    assert link.receive(1.0) is good
    assert link.error_frames == 1
    link, _ = scripted(can.Message(arbitration_id=0x40, is_error_frame=True))
    with pytest.raises(LinkLost, match=r"bus-off.*cut the drive's power"):
        link.receive(1.0)


def test_bytes_that_are_no_frame_are_a_bad_reply_and_so_is_a_frame_shorter_than_it_says() -> None:
    short = can.Message(arbitration_id=5, data=b"\x01", dlc=8, is_extended_id=False)
    for item in (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "x"), ValueError("x"), IndexError("x"), short):
        link, _ = scripted(item)
        with pytest.raises(BadReply):
            link.receive(1.0)


def test_a_bus_that_never_falls_silent_does_not_hold_us() -> None:
    chatter = [can.Message(arbitration_id=5, data=b"\x01", is_extended_id=False)] * 5000
    link, _ = scripted(*chatter)
    with pytest.raises(BadReply, match="never falls silent"):
        link.waiting()
    link, _ = scripted(*[can.Message(arbitration_id=0x8, is_error_frame=True)] * 5000)
    with pytest.raises(BadReply, match="error frames without a pause"):
        link.receive(1.0)


def test_a_bus_that_takes_no_frame_is_no_reply_and_one_that_is_gone_is_a_lost_link() -> None:
    late = can.CanOperationError("Could not write to serial device")
    late.__cause__ = serial.SerialTimeoutException("Write timeout")
    full = can.CanOperationError("no")
    full.__cause__ = OSError(errno.ENOBUFS, "no")
    for error in (full, can.CanOperationError("Transmit buffer full"), late):
        link, _ = scripted(error)
        with pytest.raises(NoReply, match="no node on the bus acknowledges"):
            link.send(frame(1))
    down = can.CanOperationError("down")
    down.__cause__ = OSError(errno.ENETDOWN, "down")
    link, _ = scripted(down)
    with pytest.raises(LinkLost, match="ip link"):
        link.send(frame(1))
    link.close()
    link.close()
    with pytest.raises(LinkLost):
        link.send(frame(1))
    with pytest.raises(LinkLost):
        link.receive(0.0)


def test_lengths_on_the_wire_are_those_of_the_standard() -> None:
    # 47 bits and 8 a byte without stuffing; at most one stuff bit for each four after the first five
    assert duration(CanFrame(1, bytes(8)), 1e6, 5e6) == pytest.approx((47 + 64 + 24) * 1e-6)
    assert duration(CanFrame(1, remote=True), 1e6, 5e6) == pytest.approx((47 + 8) * 1e-6)
    assert duration(CanFrame(1, bytes(8), extended=True), 1e6, 5e6) == pytest.approx((67 + 64 + 29) * 1e-6)
    long = CanFrame(1, bytes(64), fd=True, fast=True)
    assert duration(long, 1e6, 5e6) < duration(long, 1e6, 1e6)


def test_an_emulator_answers_on_a_real_bus_of_python_cans() -> None:
    with serve("test_can_bus", interface="virtual"):
        servo = OdriveServo(OdriveConfig("virtual", "test_can_bus", 0.04, reply_timeout=0.3, watchdog=0.0))
        assert servo.info.firmware == "0.6.10"
        servo.exchange(Command.rest())
        servo.close()
