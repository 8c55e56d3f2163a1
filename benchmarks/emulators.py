"""Frames that nobody meant, sent to every emulated drive, for benchmarks/fuzz.py and tests/project/test_fuzz.py.

Real frames with NaN, infinities and huge numbers in the place of their values, changed bits, other lengths, other ids;
and bytes drawn at random. The time is simulated: nothing sleeps. A drive is replaced after `LIFE` frames, because some
frames make it deaf (another id, another protocol).
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from sim_backend.parameters import SimParameters
from sim_backend.wire import can_families
from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.frames import FD_LENGTHS, CanFrame
from sim_backend.wire.commander.emulator import FIRMWARES, new_board
from sim_backend.wire.dynamixel import tables as dynamixel_tables
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.feetech import tables as feetech_tables
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.loadcell.emulator import BOARDS, EmulatedLoadCell
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.packets.frames import packet
from sim_backend.wire.packets.frames_1 import HEADER, checksum_1

LIFE = 400
ODD = (math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e30, 1e-38, 1e9, -1e6, 0.0)


class Fed(NamedTuple):
    """A drive that is fed. take: receives a frame or bytes at a time, s. motors: its motors. make: makes a frame."""

    take: Callable[[Any, float], object]
    motors: list[Any]
    make: Callable[[random.Random], Any]


def floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


def odrive(ident: int) -> list[CanFrame]:
    loop = CanFrame(ident << 5 | 0x07, struct.pack("<I", 8))
    mode = [CanFrame(ident << 5 | 0x0B, struct.pack("<II", mode, 1)) for mode in (1, 2, 3)]
    rest = [CanFrame(ident << 5 | kind, floats(0.1, 0.2)) for kind in range(1, 0x1F) if kind != 0x07]
    writes = [CanFrame(ident << 5 | 0x04, struct.pack("<BHBf", 1, 100 + k, 0, 1.0)) for k in range(40)]
    clear = CanFrame(ident << 5 | 0x18, bytes(8))
    return [clear, loop, loop, *mode, *rest, *rest, *writes]


def mit(ident: int) -> list[CanFrame]:
    special = [CanFrame(ident, b"\xff" * 7 + bytes([code])) for code in (0xFB, 0xFC, 0xFC, 0xFD, 0xFE)]
    modes = [CanFrame(0x7FF, struct.pack("<HBBI", ident, 0x55, 10, mode)) for mode in (1, 2, 3, 4)]
    registers = [CanFrame(0x7FF, struct.pack("<HBBf", ident, 0x55, number, 1.0)) for number in range(40)]
    sets = [CanFrame(ident + 0x100 * mode, floats(0.5, 1.0)) for mode in range(4)]
    servo = [CanFrame(ident | kind << 8, struct.pack(">ihh", 100, 5, 5), extended=True) for kind in range(8)]
    return [*special * 4, *modes, *registers, *sets * 4, CanFrame(ident, bytes.fromhex("7fff7ff0000007ff")), *servo]


def robstride(ident: int) -> list[CanFrame]:
    def of(kind: int, data: bytes) -> CanFrame:
        return CanFrame(kind << 24 | 0xFD << 8 | ident, data, extended=True)

    writes = [of(18, struct.pack("<HHf", 0x7005 + k, 0, 1.0)) for k in range(0x28)]
    modes = [of(18, struct.pack("<HHI", 0x7005, 0, mode)) for mode in range(6)]
    plain = [of(kind, bytes(8)) for kind in range(26)]
    shares = [of(1, bytes.fromhex("8000800010002000"))] * 6
    return [*[of(3, bytes(8))] * 8, *modes * 2, *writes, *plain, *shares]


def moteus(ident: int) -> list[CanFrame]:
    def of(data: bytes) -> CanFrame:
        return CanFrame(0x8000 | ident, data, extended=True, fd=True)

    def said(text: bytes) -> CanFrame:
        return of(bytes([0x40, 1, len(text)]) + text)

    modes = [of(bytes([0x01, 0x00, mode, 0x0C, 6, 0x20]) + floats(0.1, 0.2, 0.3, 1.0, 1.0, 0.5)) for mode in range(16)]
    names = ("servo.max_current_A", "servo.pid_position.kp", "servo.max_velocity_derate", "servo.default_timeout_s")
    values = ("nan", "inf", "-inf", "1e38", "0", "1")
    sets = [said(f"conf set {name} {value}\n".encode()) for name in names for value in values]
    asked = [said(f"d {word} {value}\n".encode()) for word in ("exact", "nearest", "rezero") for value in values]
    kinds = [of(bytes([0x14 | kind, 0x10, 0])) for kind in (0, 4, 8)]
    tel = [said(f"tel get {name}\n".encode()) for name in ("servo_stats", "firmware", "git")]
    return [*[modes[10]] * 12, *modes * 2, *sets, *asked, *kinds, *tel, of(bytes([0x0C, 1, 0x30, 1]) + floats(0.5))]


def cia402(ident: int) -> list[CanFrame]:
    words = [CanFrame(0x200 + ident, struct.pack("<H", word)) for word in (0x80, 6, 7, 15, 15)]
    start = [CanFrame(0, bytes([code, ident])) for code in (1, 1, 2, 0x80)]
    places = [(0x6060, 0), (0x6071, 0), (0x2030, 0), (0x6410, 2), (0x3001, 2), (0x6072, 0), (0x60A9, 0), (0x3001, 5)]
    places += [(0x3000, 5), (0x608F, 1), (0x2210, 1), (0x6076, 0), (0x3001, 1), (0x1016, 1), (0x1400, 2), (0x6040, 0)]
    sdo = [CanFrame(0x600 + ident, struct.pack("<BHBi", 0x22, *place, value)) for place in places for value in (15, 10)]
    reads = [CanFrame(0x600 + ident, struct.pack("<BHBi", 0x40, 0x6000 + k, 0, 0)) for k in range(0x90)]
    return [*start, *words * 4, *sdo, *reads, CanFrame(0x80)]


CAN: Mapping[str, Callable[[int], list[CanFrame]]] = {
    "odrive": odrive, "mit": mit, "robstride": robstride, "moteus": moteus, "cia402": cia402,
}  # fmt: skip


def changed(draw: random.Random, data: bytes, longest: int) -> bytes:
    """Return the data of a frame with one thing done to it, or as it is."""
    out = bytearray(data)
    match draw.randrange(8):
        case 0 | 1 | 2 if len(out) >= 4:
            at = draw.choice([0, len(out) - 4, draw.randrange(len(out) - 3)])
            out[at : at + 4] = struct.pack("<f", draw.choice(ODD))
        case 3 if out:
            out[draw.randrange(len(out))] ^= 1 << draw.randrange(8)
        case 4:
            out = out[: draw.randrange(len(out) + 1)]
        case 5:
            out = bytearray(draw.randbytes(draw.choice([size for size in FD_LENGTHS if size <= longest])))
    return bytes(out)


def can_frame(draw: random.Random, seeds: list[CanFrame], longest: int) -> CanFrame:
    seed = draw.choice(seeds)
    frame = replace(seed, data=changed(draw, seed.data, longest))
    if draw.random() < 0.1:
        ident = draw.choice([seed.ident ^ 1 << draw.randrange(11), draw.getrandbits(11), draw.getrandbits(29)])
        frame = replace(frame, ident=ident, extended=ident > 0x7FF)
    return replace(frame, remote=True, data=b"") if draw.random() < 0.02 else frame


def on_can(name: str, number: int) -> Fed:
    family = getattr(can_families, name)
    device = family.make(family.known[number % len(family.known)], 1, None, 0.0)
    bus = CanBus([device])
    seeds, longest = CAN[name](1), 64 if name == "moteus" else 8
    return Fed(bus.receive, [device.motor], lambda draw: can_frame(draw, seeds, longest))


def servo_packet(draw: random.Random, items: list[Any], pack: Callable[[int, bytes], bytes], wide: bool) -> bytes:
    """Return an instruction for a servo, or bytes like one. wide: whether addresses have two bytes."""
    item, order = draw.choice(items), ("<H" if wide else "<B")
    value = draw.choice([draw.getrandbits(8 * item.size), max(0, item.low), max(0, item.high), 1, 0])
    named = struct.pack(order, item.address) + (value % (1 << 8 * item.size)).to_bytes(item.size, "little")
    read = struct.pack(order, item.address) + struct.pack(order, draw.choice([item.size, draw.randrange(256)]))
    kind = draw.choice([1, 2, 3, 3, 3, 3, 3, 4, 5, draw.randrange(256)])
    parameters = {2: read, 3: named, 4: named}.get(kind, draw.randbytes(draw.randrange(12)))
    out = pack(draw.choice([1, 1, 1, 1, 2, 254]), bytes([kind]) + parameters)
    return changed(draw, out, 32) if draw.random() < 0.2 else out


def pack_1(ident: int, payload: bytes) -> bytes:
    body = bytes([ident, len(payload) + 1]) + payload
    return HEADER + body + bytes([checksum_1(body)])


def on_packets(name: str, number: int) -> Fed:
    makers: dict[str, Any] = dict.fromkeys(feetech_tables.MODELS, FeetechDevice)
    if name == "dynamixel":
        makers = dict.fromkeys(dynamixel_tables.MODELS, DynamixelDevice)
        makers |= dict.fromkeys(dynamixel_tables.MX_MODELS, MxDevice)
    model = list(makers)[number % len(makers)]
    device, wide = makers[model](model), makers[model] is DynamixelDevice
    items = [item for item in device.registers.items.values() if item.writable]
    bus, pack = PacketBus([device], protocol=2 if wide else 1), packet if wide else pack_1
    return Fed(bus.receive, [device.motor], lambda draw: servo_packet(draw, items, pack, wide))


def typed(draw: random.Random) -> bytes:
    """Return a command to a SimpleFOC board, or characters like one."""
    value = draw.choice(["nan", "inf", "-inf", "1e39", "-1e39", "1e30", "0", "2", "0.5", "-3", ".", "", "1e-45"])
    head = draw.choice(
        ["M", "M", "M", "ME", "MC", "MT", "MLU", "MLC", "MLV", "MMD", "MMS", "MM#", "MMG", "@", "#", "?"]
    )
    line = f"{head}{value}{draw.choice(['', ' 1', f' {value}'])}\n".encode()
    return changed(draw, line, 20) if draw.random() < 0.3 else line


def on_board(_name: str, number: int) -> Fed:
    board = new_board(SimParameters(), firmware=list(FIRMWARES)[number % len(FIRMWARES)])
    return Fed(board.receive, [board.motor], typed)


def on_cell(_name: str, number: int) -> Fed:
    cell = EmulatedLoadCell(list(BOARDS.values())[number % len(BOARDS)])
    return Fed(
        lambda data, now: cell.receive(data, now, data[0] * 1000 if data else None), [], lambda d: d.randbytes(9)
    )


FAMILIES: Mapping[str, Callable[[str, int], Fed]] = {
    "dynamixel": on_packets, "feetech": on_packets, **dict.fromkeys(CAN, on_can), "commander": on_board,
    "loadcell": on_cell,
}  # fmt: skip


def feed(name: str, frames: int, seed: int = 0) -> int:
    """Send `frames` frames to drives of one family. Return how many were sent.

    Raises what the emulator raises, and AssertionError when the plant of a motor is no longer finite; both name the
    frame.
    """
    draw = random.Random(seed)  # noqa: S311 - frames, no keys
    for number in range(0, frames, LIFE):
        fed, now = FAMILIES[name](name, seed + number // LIFE), 1.0
        for _ in range(min(LIFE, frames - number)):
            frame = fed.make(draw)
            now += draw.choice([1e-4, 5e-4, 1e-3, 2e-3]) if draw.random() < 0.99 else 0.15
            try:
                fed.take(frame, now)
                for motor in fed.motors:
                    state = (motor.position, motor.rate, motor.torque, motor.temperature, motor.coupling_torque)
                    assert all(map(math.isfinite, state)), f"the plant's state is {state}"
            except Exception as error:
                error.add_note(f"{name}, frame {frame!r}")
                raise
    return frames
