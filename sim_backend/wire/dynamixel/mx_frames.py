"""The frames of DYNAMIXEL protocol 1.0 as the servo sees them.

Source: ROBOTIS e-manual, "Protocol 1.0" (emanual.robotis.com/docs/en/dxl/protocol1/). No I/O and no time in here.
"""

from __future__ import annotations

from sim_backend.wire.dynamixel.frames import Frame, Instruction

HEADER = b"\xff\xff"


def mx_checksum(body: bytes) -> int:
    """Return the complement of the low byte of the sum of everything between header and checksum."""
    return 0xFF - sum(body) % 0x100


def mx_status(ident: int, error: int, parameters: bytes = b"") -> bytes:
    """The bytes of a status packet."""
    body = bytes([ident, 2 + len(parameters), error]) + parameters
    return HEADER + body + bytes([mx_checksum(body)])


class MxFramer:
    """A search for instruction packets in a stream of bytes.

    Nothing in a packet distinguishes an instruction from another servo's reply, so replies must not be fed in.
    After a wrong checksum the search goes on behind the header.
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[tuple[Frame, int]]:
        """The packets completed by `data`, each with the number of bytes of `data` used up when it was complete."""
        before = len(self._rest)
        self._rest += data
        used = 0
        found = []
        while (next_one := self._next()) is not None:
            frame, length = next_one
            used += length
            found.append((frame, max(0, used - before)))
        return found

    def _next(self) -> tuple[Frame, int] | None:
        """The next packet and what was used up with it, junk before it included; None where none is complete."""
        skipped = 0
        while True:
            at = self._rest.find(HEADER)
            if at < 0:
                self._rest = self._rest[-1:] if self._rest.endswith(HEADER[:1]) else b""
                return None
            skipped += at
            self._rest = self._rest[at:]
            if len(self._rest) < 4:
                return None
            ident, length = self._rest[2], self._rest[3]
            if ident == 0xFF or length < 2:  # three FF: the header is the last two
                skipped += 1
                self._rest = self._rest[1:]
                continue
            total = 4 + length
            if len(self._rest) < total:
                return None
            raw = self._rest[:total]
            sound = mx_checksum(raw[2:-1]) == raw[-1]
            used = total if sound else len(HEADER)
            self._rest = self._rest[used:]
            return Frame(ident, raw[4], raw[5:-1], sound, total), skipped + used


def mx_sync_writes(p: bytes) -> list[tuple[int, int, bytes]]:
    """Id, address and data of each write in the parameters of a Sync Write."""
    if len(p) < 2:
        return []
    address, size = p[0], p[1]
    return [(p[i], address, p[i + 1 : i + 1 + size]) for i in range(2, len(p) - size, size + 1)]


def mx_bulk_reads(frame: Frame) -> list[tuple[int, int, int]]:
    """Id, address and size of each read of a Bulk Read; of any other instruction none."""
    if frame.instruction != Instruction.BULK_READ:
        return []
    p = frame.parameters[1:]
    return [(p[i + 1], p[i + 2], p[i]) for i in range(0, len(p) - 2, 3)]
