"""The emulator's codec against the packets the e-manual prints (Protocol 2.0, the examples of each instruction)."""

from __future__ import annotations

import numpy as np
import pytest

from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.packets.frames import Frame, Framer, Instruction, packet, status, take_packet

PING_1 = "FF FF FD 00 01 03 00 01 19 4E"
READ_POSITION = "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"


def octets(text: str) -> bytes:
    return bytes.fromhex(text)


@pytest.mark.parametrize(
    ("ident", "payload", "printed"),
    [
        (1, "01", PING_1),
        (0xFE, "01", "FF FF FD 00 FE 03 00 01 31 42"),
        (1, "02 84 00 04 00", READ_POSITION),
        (1, "03 74 00 00 02 00 00", "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
        (1, "04 68 00 C8 00 00 00", "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E"),
        (1, "05", "FF FF FD 00 01 03 00 05 02 CE"),
        (1, "06 01", "FF FF FD 00 01 04 00 06 01 A1 E6"),
        (1, "08", "FF FF FD 00 01 03 00 08 2F 4E"),
        (1, "10 01 44 58 4C 22", "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC"),
        (0xFE, "82 84 00 04 00 01 02", "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
        (
            0xFE,
            "83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00",
            "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
        ),
        (0xFE, "92 01 90 00 02 00 02 92 00 01 00", "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05"),
        (
            0xFE,
            "93 01 20 00 02 00 A0 00 02 1F 00 01 00 50",
            "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68",
        ),
        (0xFE, "8A 84 00 04 00 03 07 04", "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"),
    ],
)
def test_every_instruction_packet_of_the_manual_is_understood_and_written_alike(
    ident: int, payload: str, printed: str
) -> None:
    assert packet(ident, octets(payload)) == octets(printed)
    ((frame, used),) = Framer(take_packet).feed(octets(printed))
    assert frame == Frame(ident, octets(payload)[0], octets(payload)[1:], sound=True, size=len(octets(printed)))
    assert used == len(octets(printed))


@pytest.mark.parametrize(
    ("ident", "parameters", "printed"),
    [
        (1, "06 04 26", "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
        (2, "06 04 26", "FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D"),
        (1, "A6 00 00 00", "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
        (2, "1F 08 00 00", "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"),
        (1, "", "FF FF FD 00 01 04 00 55 00 A1 0C"),
        (1, "77 00", "FF FF FD 00 01 06 00 55 00 77 00 C3 69"),
        (2, "24", "FF FF FD 00 02 05 00 55 00 24 8B A9"),
    ],
)
def test_every_status_packet_of_the_manual_is_written_alike(ident: int, parameters: str, printed: str) -> None:
    assert status(ident, 0, octets(parameters)) == octets(printed)


def three_servos() -> PacketBus:
    """The servos of the manual's Fast Sync Read example, turned to where its positions are."""
    bus = PacketBus([DynamixelDevice("xc330-t288", ident) for ident in (3, 7, 4)])
    for device, position in zip(bus.devices, (166, 2079, 1023), strict=True):
        device.registers.put("operating_mode", 4)  # in which every offset counts
        device.registers.put("homing_offset", position)
    return bus


def test_a_fast_sync_read_is_answered_as_the_manual_prints_it() -> None:
    (reply,) = three_servos().receive(octets("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"), 0.0)
    printed = "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
    assert reply.data == octets(printed)


def test_a_fast_bulk_read_is_laid_out_as_the_manual_prints_it() -> None:
    request = packet(0xFE, octets("9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00"))
    (reply,) = three_servos().receive(request, 0.0)
    # the manual's servo 7 runs at a PWM of 421 and its servo 4 is at 31 degC; ours rest at 0 and at 23
    assert reply.data[:16] == octets("FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4")
    assert reply.data[16:20] == octets("00 07 00 00")
    assert reply.data[22:25] == octets("00 04 17")
    assert len(reply.data) == 27


def test_packets_are_found_a_byte_at_a_time() -> None:
    framer = Framer(take_packet)
    stream = octets(PING_1) + octets(READ_POSITION)
    found = [frame for byte in stream for frame, _ in framer.feed(bytes([byte]))]
    assert [frame.instruction for frame in found] == [Instruction.PING, Instruction.READ]


def test_packets_are_found_between_junk_of_every_kind() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        junk = [bytes(rng.choice([0xFF, 0xFD, 0x00, 0x55, 0x01], size=int(rng.integers(0, 12)))) for _ in range(3)]
        stream = junk[0] + octets(PING_1) + junk[1] + octets(READ_POSITION) + junk[2] + 1100 * b"\0"
        sound = [frame.instruction for frame, _ in Framer(take_packet).feed(stream) if frame.sound]
        assert sound == [Instruction.PING, Instruction.READ]


def test_a_payload_survives_stuffing_both_ways_whatever_is_in_it() -> None:
    rng = np.random.default_rng(3)
    for _ in range(500):
        payload = b"\x03" + bytes(rng.choice([0xFF, 0xFD, 0x00], size=int(rng.integers(1, 14))))
        sent = packet(1, payload)
        assert b"\xff\xff\xfd" not in sent[4:-2].replace(b"\xff\xff\xfd\xfd", b"")
        ((frame, _),) = Framer(take_packet).feed(sent)
        assert frame.parameters == payload[1:]


def test_a_damaged_packet_is_reported_and_the_next_one_still_found() -> None:
    damaged = bytearray(octets(READ_POSITION))
    damaged[9] ^= 0x40
    frames = [frame for frame, _ in Framer(take_packet).feed(bytes(damaged) + octets(PING_1))]
    assert [frame.sound for frame in frames] == [False, True]


@pytest.mark.parametrize("protocol", [1, 2])
def test_after_a_silence_a_servo_waits_for_a_new_header(protocol: int) -> None:
    """A cut packet whose length promises more would otherwise take the packets behind it for its own parameters."""
    device = DynamixelDevice("xl330-m288") if protocol == 2 else MxDevice("mx-64")
    bus = PacketBus([device], protocol=protocol)
    cut = packet(1, b"\x03\x40\x00" + bytes(200))[:20] if protocol == 2 else b"\xff\xff\x01\xc8\x03"
    ping = packet(1, b"\x01") if protocol == 2 else b"\xff\xff\x01\x02\x01\xfb"
    assert bus.receive(cut, 1.0) == []
    assert bus.receive(ping, 1.09) == []  # still taken for a part of the packet
    assert len(bus.receive(ping, 1.2)) == 1
    assert len(bus.receive(ping, 1.21)) == 1


def test_a_packet_that_comes_in_pieces_is_understood_however_long_the_whole_takes() -> None:
    bus = PacketBus([DynamixelDevice("xl330-m288")])
    *begin, last = packet(1, b"\x01")
    for place, byte in enumerate(begin):
        assert bus.receive(bytes([byte]), 1.0 + 0.09 * place) == []
    assert len(bus.receive(bytes([last]), 1.0 + 0.09 * len(begin))) == 1
