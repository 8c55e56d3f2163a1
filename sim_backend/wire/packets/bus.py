"""A half-duplex serial line with several emulated servos: who replies, in which order, and when. Bytes in, bytes with
times out; no I/O.

Source: e-manual, "Protocol 2.0": Sync Read to Fast Bulk Read, and the notes on the broadcast id. The manual does not
say what happens if a servo is missing. Here a Sync Read skips a missing servo, and a Fast Read ends at a missing servo,
because the servos behind it wait for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from sim_backend.wire.faults import Reboots, SerialFault, Unplug, WireFaults
from sim_backend.wire.life import Life
from sim_backend.wire.packets.frames import (
    BROADCAST,
    HEADER,
    Frame,
    Framer,
    Instruction,
    crc,
    reads,
    status,
    take_packet,
    writes,
)
from sim_backend.wire.packets.frames_1 import reads_1, status_1, take_packet_1, writes_1
from sim_backend.wire.uart.pacing import paced


class Reply(NamedTuple):
    """Bytes that reach the host, and the time of their arrival, s."""

    at: float
    data: bytes


@dataclass(frozen=True, slots=True)
class PacketTiming:
    """Durations on the line, and its adapter. usb_latency: s that the adapter holds received bytes back. echo: whether
    the adapter also receives what it sends, as a half-duplex adapter without a switch does.
    """

    usb_latency: float = 1e-3
    echo: bool = False


class LineSettings(NamedTuple):
    """The settings of a servo for the serial line.

    baudrate: bit/s. return_delay: s from a request to its reply. level: what the servo replies to: 0: pings, 1: pings
    and reads, 2: everything. shadow: a second id whose instructions the servo obeys without a reply, None if there is
    none. together: the instructions for several servos that this servo has.
    """

    id: int
    baudrate: int
    return_delay: float
    level: int
    shadow: int | None = None
    together: frozenset[int] = frozenset()


class PacketServo(Protocol):
    """The interface between a line and an emulated servo. Every request on the line feeds the servo's watchdog."""

    life: Life

    @property
    def line(self) -> LineSettings:
        """The servo's settings for the line, from its present registers."""

    def advance(self, now: float) -> None:
        """Simulate the servo up to `now`, s."""

    def reboot(self, now: float) -> None:
        """Cut the servo's power for a moment at `now`, s."""

    def alerted(self, error: int) -> int:
        """Return the error byte: `error` together with the present hardware errors."""

    def answer(self, frame: Frame, now: float) -> tuple[int, bytes] | None:
        """Execute `frame`. Return the error byte and the parameters of the reply, None if the servo does not reply."""

    def read(self, address: int, size: int, now: float) -> tuple[int, bytes]:
        """Return the error and the bytes of a read of `size` bytes."""

    def write(self, address: int, data: bytes) -> int:
        """Write `data` as a write instruction does. Return the error."""


class PacketBus:
    """A line with its servos, which all use one protocol. timing: durations; None: nothing takes time."""

    def __init__(
        self, devices: Iterable[PacketServo], *, timing: PacketTiming | None = None, protocol: int = 2
    ) -> None:
        self.devices: list[Any] = list(devices)  # whoever looks at them knows of what kind they are
        self.unplugged = False
        self._timing = timing
        self._protocol = protocol
        self._framer = Framer(take_packet if protocol == 2 else take_packet_1)
        self._status = status if protocol == 2 else status_1
        self._writes, self._reads = (writes, reads) if protocol == 2 else (writes_1, reads_1)
        self._free = 0.0
        self.faults = WireFaults[SerialFault]()

    def advance(self, now: float) -> None:
        """Simulate every servo up to `now`, s."""
        for device in self.devices:
            device.advance(now)

    def due(self) -> float:
        """Return infinity: a servo sends nothing without a request."""
        return math.inf

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> list[Reply]:
        """Return the servos' replies to `data`, whose first byte is sent at `now`, s.

        baudrate: bit/s of the host; None: the right one for every servo.
        """
        if not data:
            self.advance(now)
        out: list[Reply] = []
        begin = max(now, self._free)
        end = begin + self._duration(len(data), baudrate)
        if self._timing is not None and self._timing.echo and data:
            byte = self._duration(1, baudrate)
            out += (Reply(*piece) for piece in paced([(end, data)], byte, self._timing.usb_latency))
        for frame, used in self._framer.feed(data, begin, end):
            arrival = begin + self._duration(used, baudrate)
            if not self.faults.loses_request(arrival):
                out += self._execute(frame, arrival, baudrate)
        self._free = max(self._free, end)
        return out

    def _duration(self, size: int, baudrate: int | None) -> float:
        if self._timing is None:
            return 0.0
        rate = baudrate or (self.devices[0].line.baudrate if self.devices else 1_000_000)
        return 10.0 * size / rate

    def _execute(self, frame: Frame, now: float, baudrate: int | None) -> list[Reply]:
        self.advance(now)
        awake = [d for d in self.devices if now >= d.life.ready and baudrate in {None, d.line.baudrate}]
        for device in awake:
            device.life.heard = now
        if frame.id != BROADCAST:
            return self._addressed(frame, awake, now)
        if not frame.sound:
            return []
        if frame.instruction >= Instruction.SYNC_READ:
            able = [device for device in awake if frame.instruction in device.line.together]
            return self._together(frame, able, now)
        answers = [(d, d.answer(frame, now)) for d in sorted(awake, key=lambda d: d.line.id)]
        if frame.instruction != Instruction.PING:
            return []
        return self._timed([(d, self._status(d.line.id, *a)) for d, a in answers if a is not None], now)

    def _addressed(self, frame: Frame, awake: list[PacketServo], now: float) -> list[Reply]:
        """Execute an instruction for one id. A servo whose shadow id this is obeys without a reply. awake: servos that
        have booted.
        """
        for device in awake:
            if device.line.id != frame.id and device.line.shadow == frame.id:
                device.answer(frame, now)
        named = [device for device in awake if device.line.id == frame.id]
        answers = [device.answer(frame, now) for device in named]
        packets = [self._status(frame.id, *answer) for answer in answers if answer is not None]
        return self._timed([(named[0], _collided(packets))], now) if packets else []

    def _together(self, frame: Frame, able: list[PacketServo], now: float) -> list[Reply]:
        """Execute an instruction for several servos: Sync or Bulk Read, Sync or Bulk Write. able: the servos that have
        it.

        A servo that does not reply is skipped; but in a Bulk Read of protocol 1.0 the servos behind it wait for it and
        do not reply.
        """
        for ident, address, data in self._writes(frame):
            for device in able:
                if ident in {device.line.id, device.line.shadow}:
                    device.write(address, data)
        present = {device.line.id: device for device in able}
        wanted = self._reads(frame)
        if frame.instruction in {Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ}:
            return self._fast(wanted, present, now)
        packets = []
        for ident, address, size in wanted:
            asked = present.get(ident)
            if asked is not None and asked.line.level > 0:
                error, data = asked.read(address, size, now)
                packets.append((asked, self._status(ident, asked.alerted(error), data)))
            elif self._protocol == 1 and frame.instruction == Instruction.BULK_READ:
                break
        return self._timed(packets, now)

    def _fast(self, wanted: list[tuple[int, int, int]], present: dict[int, PacketServo], now: float) -> list[Reply]:
        """Return the reply to a Fast Read: one status packet, without byte stuffing, to which the servos add their data
        one after the other. wanted: (id, address, size) of each. present: servos by id.
        """
        length = 1 + sum(size + 4 for _, _, size in wanted)
        if length > 0xFFFF:
            return []
        out = HEADER + bytes([BROADCAST]) + length.to_bytes(2, "little") + bytes([Instruction.STATUS])
        first = None
        for ident, address, size in wanted:
            device = present.get(ident)
            if device is None or device.line.level == 0:
                break
            first = first or device
            error, data = device.read(address, size, now)
            out += bytes([device.alerted(error), ident]) + data.ljust(size, b"\0")
            out += crc(out).to_bytes(2, "little")
        return [] if first is None else self._timed([(first, out)], now)

    def _timed(self, packets: list[tuple[PacketServo, bytes]], now: float) -> list[Reply]:
        """Return the packets as they arrive at the host one after the other, with the injected faults."""
        out: list[Reply] = []
        at = now
        for device, data in packets:
            byte = 0.0
            if self._timing is not None:
                byte = 10.0 / device.line.baudrate
                at += device.line.return_delay + byte * len(data)
            out += self._delivered(data, at, byte)
        self._free = max(self._free, at)
        return sorted(out, key=lambda reply: reply.at)

    def _delivered(self, data: bytes, now: float, byte: float) -> list[Reply]:
        """Return a packet as it arrives at the host, with the injected faults.

        now: s, when its last byte has been sent. byte: s that one byte takes.
        """
        match self.faults.interrupts_reply(now):
            case Unplug():
                self.unplugged = True
            case Reboots():
                for device in self.devices:
                    device.reboot(now)
                return []
        if self.unplugged:
            return []
        held = self._timing.usb_latency if self._timing is not None else 0.0
        return [Reply(*piece) for piece in paced(self.faults.arriving(data, now), byte, held)]


def _collided(packets: list[bytes]) -> bytes:
    """Return the bytes that arrive when several servos send at once: a bit is low if any servo sends a low bit."""
    longest = max(packets, key=len)
    merged = bytearray(longest)
    for data in packets:
        for i, byte in enumerate(data):
            merged[i] &= byte
    return bytes(merged)
