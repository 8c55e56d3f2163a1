"""The USB-CAN adapter that RobStride sells: its bytes, and a motor behind its emulation on a pty."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.canbus.at_frames import AtFrames
from drivers.canbus.link import frame
from drivers.canbus.serial_bus import SerialBus
from drivers.robstride.config import RobstrideConfig
from drivers.robstride.servo import RobstrideServo
from drivers.servo import BadReply, Command, DriverError, Limits, LinkLost, Quantity
from sim_backend.wire.canbus.at_frames import AtAdapter, at_line
from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.robstride.device import RobstrideDevice

LIMITS = Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0))
encoded = AtFrames(1_000_000).encoded
READ = frame(0x1100FD01, bytes.fromhex("0570000000000000"), extended=True)


def test_a_frame_has_the_bytes_of_the_makers_tool_and_survives_junk_before_it() -> None:
    stop = encoded(frame(0x0400FD0A, bytes(8), extended=True))
    assert stop == b"AT" + bytes.fromhex("2007e854 08") + bytes(8) + b"\r\n"  # a capture of MotorStudio
    adapter = AtAdapter(CanBus([RobstrideDevice()]))
    assert adapter.receive(b"AT+AT\r\n", 0.0) == [(0.0, b"OK\r\n")]
    broken = encoded(READ)[:9]  # its sender was killed
    assert [len(answer) for _, answer in adapter.receive(b"ATjunk" + broken + encoded(READ), 0.0)] == [17]
    assert adapter.receive(encoded(READ), 0.0, 115_200) == []


@pytest.fixture
def behind(tmp_path: Path) -> Iterator[tuple[CanBus, str]]:
    bus = CanBus([RobstrideDevice(now=time.monotonic())])
    with at_line(tmp_path / "tty", bus) as line:
        yield bus, str(line.link)


def test_a_motor_behind_it_runs_and_is_switched_off_by_another_process(behind: tuple[CanBus, str]) -> None:
    bus, link = behind
    servo = RobstrideServo(RobstrideConfig("robstride", link, "rs00", reply_timeout=0.3, watchdog=1.0))
    servo.arm(LIMITS)
    servo.exchange(Command(Quantity.TORQUE, 0.5))
    assert bus.nodes[0].motor.enabled  # type: ignore[attr-defined]  # of a drive
    path = servo.off_path()
    for packet in path.off:
        os.write(path.descriptor, packet)
    servo.disarm()
    assert not bus.nodes[0].motor.enabled  # type: ignore[attr-defined]  # of a drive
    bus.unplugged = True
    for _ in range(3):  # the replies to the other process may arrive first
        with suppress(BadReply, LinkLost):
            servo.exchange(Command.rest())
    with pytest.raises(LinkLost):
        servo.exchange(Command.rest())
    servo.close()


def test_frames_that_arrive_together_are_all_read_and_lost_bytes_cost_one(behind: tuple[CanBus, str]) -> None:
    _, link = behind
    with pytest.raises(DriverError, match="1000000 bit/s on the bus, not 500000"):
        AtFrames(500_000)
    frames = AtFrames(1_000_000)
    bus = SerialBus(link, frames)
    for lost in (b"", b"AT\x88\x07"):
        frames.part = lost
        bus.serialPortOrig.write(3 * encoded(READ))
        received = [bus.recv(0.2) for _ in range(4)]
        assert sum(message is not None for message in received) >= 2
    bus.shutdown()
