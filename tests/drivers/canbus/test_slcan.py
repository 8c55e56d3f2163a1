"""The emulated serial CAN adapter: its text, and an adapter of ours through python-can's slcan on a pty."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.odrive.config import OdriveConfig
from drivers.odrive.servo import OdriveServo
from drivers.servo import Command, DriverError, Limits, LinkLost, NoReply, Quantity
from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.slcan import SlcanAdapter, slcan_line
from sim_backend.wire.faults import Unplug
from sim_backend.wire.odrive.device import OdriveDevice
from sim_backend.wire.odrive.states import IDLE
from sim_backend.wire.uart.pty_line import PtyLine

LIMITS = Limits(torque=0.4, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))


def texts(adapter: SlcanAdapter, data: bytes, now: float = 0.0) -> bytes:
    return b"".join(text for _, text in adapter.receive(data, now))


def test_commands_are_answered_as_the_manual_says() -> None:
    adapter = SlcanAdapter(CanBus([OdriveDevice(1)]))
    assert texts(adapter, b"t0210\r") == b"\a"  # closed
    assert texts(adapter, b"S8\rV\rN\r") == b"\rV1013\rNHIL1\r"
    assert texts(adapter, b"O\r") == b"\r"
    assert texts(adapter, b"O\rS8\r") == b"\a\a"  # open already
    assert texts(adapter, b"F\r") == b"F00\r"
    assert texts(adapter, b"r0340\r") == b"z\rt03480000000000000000\r"  # Iq of node 1
    assert texts(adapter, b"t02") == b""
    assert texts(adapter, b"90\r") == b"z\rt02980000000000000000\r"
    assert texts(adapter, b"C\r") == b"\r"


@pytest.mark.parametrize("line", [b"t0219\r", b"t02\r", b"t8001AA\r", b"t0212AA\r", b"tXYZ0\r", b"T0000\r", b"?\r"])
def test_what_is_no_command_is_refused_with_a_bell(line: bytes) -> None:
    adapter = SlcanAdapter(CanBus([]))
    texts(adapter, b"S8\rO\r")
    assert texts(adapter, line) == b"\a"


def test_a_line_without_end_is_given_up() -> None:
    adapter = SlcanAdapter(CanBus([]))
    assert texts(adapter, b"t" * 500) == b"\a"
    assert texts(adapter, b"V\r") == b"V1013\r"


def test_heartbeats_are_cyclic_and_only_sent_while_it_is_open() -> None:
    adapter = SlcanAdapter(CanBus([OdriveDevice(0)]))
    assert adapter.receive(b"", 0.5) == []
    texts(adapter, b"S8\rO\r", 0.5)
    said = adapter.receive(b"", 1.505)
    assert sum(text.startswith(b"t001") for _, text in said) == 10
    assert sum(text.startswith(b"t009") for _, text in said) >= 100


def test_fd_frames_have_the_letters_of_the_canable() -> None:
    adapter = SlcanAdapter(CanBus([]))
    texts(adapter, b"S8\rY5\rO\r")
    assert texts(adapter, b"b0019" + b"AB" * 12 + b"\r") == b"z\r"
    assert texts(adapter, b"B000001239" + b"AB" * 12 + b"\r") == b"Z\r"
    assert texts(adapter, b"b0019AB\r") == b"\a"


@pytest.fixture
def line(tmp_path: Path) -> Iterator[tuple[PtyLine, CanBus]]:
    bus = CanBus([])
    with slcan_line(tmp_path / "ttyCAN", bus, bitrate=1_000_000) as served:
        bus.nodes.append(OdriveDevice(0, now=served.now()))
        yield served, bus


def rest_three_times(servo: OdriveServo) -> None:
    for _ in range(3):
        servo.exchange(Command.rest())


def config(line: PtyLine, **changes: object) -> OdriveConfig:
    values: dict[str, object] = {"bitrate": 1_000_000, "reply_timeout": 0.3, "watchdog": 0.0} | changes
    return OdriveConfig("slcan", str(line.link), 0.04, **values)  # type: ignore[arg-type]  # a table of mixed values


def test_a_drive_behind_a_serial_adapter_runs_and_a_pulled_plug_is_a_lost_link(line: tuple[PtyLine, CanBus]) -> None:
    served, bus = line
    servo = OdriveServo(config(served))
    with pytest.raises(DriverError, match="open in this program already"):
        OdriveServo(config(served))
    servo.arm(LIMITS)
    for _ in range(20):
        sample = servo.exchange(Command(Quantity.TORQUE, 0.2))
    assert sample.motor_torque > 0.0
    servo.disarm()
    with served.lock:
        assert bus.nodes[0].state == IDLE  # type: ignore[attr-defined]  # an OdriveDevice
        bus.faults.inject(Unplug())
    with pytest.raises(LinkLost):
        rest_three_times(servo)
    servo.close()
    servo.close()


def test_a_byte_that_is_no_text_wedges_nothing(line: tuple[PtyLine, CanBus]) -> None:
    served, _ = line
    servo = OdriveServo(config(served))
    os.write(served._master, b"\xff\x80t009\r")
    answers = 0
    for _ in range(4):
        try:
            servo.exchange(Command.rest())
            answers += 1
        except DriverError:
            continue
    assert answers >= 3
    servo.close()


def test_the_wrong_bit_rate_is_no_reply_that_names_it(line: tuple[PtyLine, CanBus]) -> None:
    with pytest.raises(NoReply, match="250000 bit/s"):
        OdriveServo(config(line[0], bitrate=250_000, reply_timeout=0.03))
