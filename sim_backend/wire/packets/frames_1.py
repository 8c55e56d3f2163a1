"""The packets of protocol 1.0 as a servo handles them: decode instructions and encode replies. No I/O and no time.

Source: ROBOTIS e-manual, "Protocol 1.0" (emanual.robotis.com/docs/en/dxl/protocol1/).
"""

from __future__ import annotations

from sim_backend.wire.packets.frames import Frame, Instruction, Taken

HEADER = b"\xff\xff"


def checksum_1(body: bytes) -> int:
    """Return the checksum of `body`, the bytes between header and checksum: the complement of the low byte of their
    sum.
    """
    return 0xFF - sum(body) % 0x100


def status_1(ident: int, error: int, parameters: bytes = b"") -> bytes:
    """Return a status packet from the servo `ident`, with at most 253 parameters: its length is one byte."""
    parameters = parameters[:253]
    body = bytes([ident, 2 + len(parameters), error]) + parameters
    return HEADER + body + bytes([checksum_1(body)])


def take_packet_1(rest: bytes) -> Taken | None:
    """Return the instruction packet or the junk with which `rest` begins; None if more bytes are needed.

    In protocol 1.0 an instruction looks like another servo's reply, so replies must not be passed to this function.
    After a wrong checksum the search continues behind the packet's header.
    """
    at = rest.find(HEADER)
    if at < 0:
        at = len(rest) - int(rest.endswith(HEADER[:1]))
    if at > 0:
        return Taken(None, at)
    if len(rest) < 4:
        return None
    ident, length = rest[2], rest[3]
    if ident == 0xFF or length < 2:  # three FF: the header is the last two
        return Taken(None, 1)
    total = 4 + length
    if len(rest) < total:
        return None
    sound = checksum_1(rest[2 : total - 1]) == rest[total - 1]
    return Taken(Frame(ident, rest[4], rest[5 : total - 1], sound, total), total if sound else len(HEADER))


def writes_1(frame: Frame) -> list[tuple[int, int, bytes]]:
    """Return the writes of a Sync Write, each as (id, address, data); an empty list for any other instruction."""
    p = frame.parameters
    if frame.instruction != Instruction.SYNC_WRITE or len(p) < 2:
        return []
    address, size = p[0], p[1]
    return [(p[i], address, p[i + 1 : i + 1 + size]) for i in range(2, len(p) - size, size + 1)]


def reads_1(frame: Frame) -> list[tuple[int, int, int]]:
    """Return the reads of a Bulk Read or Sync Read, each as (id, address, size); an empty list for any other
    instruction.

    ROBOTIS's servos have no Sync Read in protocol 1.0. Feetech's STS have one; its parameters are address, size, and
    the ids.
    """
    p = frame.parameters
    if frame.instruction == Instruction.SYNC_READ and len(p) > 1:
        return [(ident, p[0], p[1]) for ident in p[2:]]
    if frame.instruction != Instruction.BULK_READ:
        return []
    return [(p[i + 1], p[i + 2], p[i]) for i in range(1, len(p) - 2, 3)]
