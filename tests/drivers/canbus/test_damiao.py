"""The USB-CAN adapter that Damiao sells: its bytes, and drives behind its emulation on a pty."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.canbus.damiao import DamiaoFrames
from drivers.canbus.link import frame
from drivers.canbus.serial_bus import SerialBus
from drivers.mit.config import MitConfig
from drivers.mit.servo import MitServo
from drivers.robstride.config import RobstrideConfig
from drivers.robstride.servo import RobstrideServo
from drivers.servo import Command, DriverError, Limits, LinkLost, NoReply, Quantity
from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.damiao import DamiaoAdapter, damiao_line
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.robstride.device import RobstrideDevice

LIMITS = Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.5)
encoded = DamiaoFrames(1_000_000).encoded
STOP_REPEATING, HEARTBEAT, SLOW = b"\x55\x03\xaa\x55", b"\x55\x04\xaa\x55", b"\x55\x05\x03\xaa\x55"
STATE = bytes.fromhex("0100cc0000000000")  # the request for a Damiao's state, to 7FF


def test_a_frame_is_encoded_as_in_the_makers_example_apart_from_the_report_and_the_unread_checksum() -> None:
    example = "55 aa 1e 01 01 00 00 00 0a 00 00 00 00 00 00 00 00 00 08 00 00 12 23 34 45 56 67 78 89 88"
    expected = bytearray(bytes.fromhex(example))
    expected[3], expected[29] = 3, 0
    assert encoded(frame(0, bytes.fromhex("1223344556677889"))) == expected
    assert encoded(frame(0x1100FD7F, b"\1", extended=True))[12:19] == bytes.fromhex("017ffd00110001")


def test_the_emulated_adapter_answers_each_command_of_the_sheet() -> None:
    bus = CanBus([MitDevice("dm-j4310", reply_id=0x11)])
    adapter = DamiaoAdapter(bus)
    assert adapter.receive(HEARTBEAT + SLOW + b"\x55\x05\x63\xaa\x55", 0.0) == [
        (0.0, bytes([0xAA, kind]) + bytes(13) + b"\x55") for kind in (0x00, 0x13, 0x03)
    ]
    asked = bytearray(encoded(frame(0x7FF, STATE)))
    (_, answer) = adapter.receive(b"junk" + asked, 0.0)[0]
    assert (answer[:7], len(answer), answer[15]) == (bytes.fromhex("aa 11 08 11 00 00 00"), 16, 0x55)
    asked[3], asked[4] = 1, 3  # with a report, three times, every 1 ms
    assert [one[1] for _, one in adapter.receive(bytes(asked), 0.01)] == [0x12, 0x11]
    assert adapter.due() == pytest.approx(0.011)
    assert len(adapter.receive(b"", 0.0111)) == 1
    assert adapter.receive(STOP_REPEATING, 0.0111) == []
    assert adapter.receive(b"", 0.02) == []
    bus.off = True
    assert [one[1:3] for _, one in adapter.receive(bytes(asked), 0.03)] == [b"\x02\x08", b"\xee\x01"]


@pytest.fixture
def behind(tmp_path: Path) -> Iterator[tuple[CanBus, str]]:
    now = time.monotonic()
    bus = CanBus([MitDevice("dm-j4310", reply_id=0x11, now=now), RobstrideDevice("rs00", 2, now=now)])
    with damiao_line(tmp_path / "tty", bus, bitrate=1_000_000) as line:
        yield bus, str(line.link)


def test_drives_behind_it_run_and_are_switched_off_by_another_process_of_ours(behind: tuple[CanBus, str]) -> None:
    bus, link = behind
    damiao = MitServo(MitConfig("damiao", link, "dm-j4310", reply_id=0x11, reply_timeout=0.3, watchdog=0.0))
    damiao.arm(LIMITS)
    damiao.exchange(PUSH)
    assert bus.nodes[0].motor.enabled  # type: ignore[attr-defined]  # of a drive
    path = damiao.off_path()
    for packet in path.off:
        os.write(path.descriptor, packet)
    damiao.disarm()  # its answer comes after those to the packets
    assert not bus.nodes[0].motor.enabled  # type: ignore[attr-defined]  # of a drive
    damiao.close()
    servo = RobstrideServo(RobstrideConfig("damiao", link, "rs00", id=2, reply_timeout=0.3, watchdog=1.0))
    servo.arm(LIMITS)
    assert servo.exchange(PUSH).motor_torque == pytest.approx(0.0, abs=0.6)
    bus.unplugged = True
    with pytest.raises(LinkLost):
        servo.exchange(PUSH)
    servo.close()


def test_frames_that_arrive_together_are_all_read_and_lost_bytes_cost_one(behind: tuple[CanBus, str]) -> None:
    _, link = behind
    frames = DamiaoFrames(1_000_000)
    bus = SerialBus(link, frames)
    asked = encoded(frame(0x7FF, STATE))
    bus.serialPortOrig.write(3 * asked)
    received = [bus.recv(0.5) for _ in range(3)]
    assert [message.arbitration_id for message in received if message is not None] == 3 * [0x11]
    frames.part = b"\xaa\x11\x08"  # of a frame whose end was lost
    bus.serialPortOrig.write(3 * asked)
    assert [bus.recv(0.1) is not None for _ in range(4)] == [True, True, True, False]
    bus.shutdown()


def test_another_bit_rate_is_another_bus_and_a_second_owner_is_kept_out(behind: tuple[CanBus, str]) -> None:
    _, link = behind
    with pytest.raises(NoReply, match="at 500000 bit/s"):
        MitServo(MitConfig("damiao", link, "dm-j4310", reply_id=0x11, bitrate=500_000))
    first = SerialBus(link, DamiaoFrames(1_000_000))
    with pytest.raises(DriverError, match="is open in this program already"):
        MitServo(MitConfig("damiao", link, "dm-j4310"))
    first.shutdown()
    with pytest.raises(ValueError, match="not in tuple"):
        DamiaoFrames(123)


def test_bus_off_ends_the_run(behind: tuple[CanBus, str]) -> None:
    bus, link = behind
    servo = MitServo(MitConfig("damiao", link, "dm-j4310", reply_id=0x11, reply_timeout=0.3, watchdog=1.0))
    bus.off = True
    with pytest.raises(LinkLost, match="bus-off"):
        servo.exchange(Command.rest())
    servo.close()
