"""Requests and replies of DYNAMIXEL protocol 2.0, to one servo, over dynamixel-sdk.

The SDK does the port, the search for the header and the checksum. Three things it gets wrong are done here. A request
with FF FF FD in it leaves the SDK unstuffed, and some replies are unstuffed wrongly, so stuffing is ours both ways. The
SDK takes any status packet for the answer, so id, instruction and length are checked. And it takes a late reply for the
answer to the next request, so after a reply went missing the line must fall silent before anything else is sent. Since
requests do not pass through the SDK's own sending, its flag for a port in use, which an exception leaves set, is never
asked.

Source: e-manual, emanual.robotis.com/docs/en/dxl/protocol2/.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, Protocol2PacketHandler

from drivers.dynamixel_port import GONE
from drivers.servo import BadReply, DriverError, LinkLost, NoReply

if TYPE_CHECKING:
    from collections.abc import Iterator

    from drivers.dynamixel_port import SerialPort
    from drivers.servo import Clock

PING, READ, WRITE, STATUS, SYNC_WRITE = 0x01, 0x02, 0x03, 0x55, 0x83
BROADCAST = 0xFE
ALERT = 0x80
_HEAD = 7  # header, id and length
_STATUS = 11  # bytes of a status packet without parameters
_DAMAGED = 3
_HEADER = b"\xff\xff\xfd\x00"
_PING_ANSWER = 14  # bytes
_ROLL_CALL = 0.8  # s; servos answer a broadcast ping one after the other, 3 ms for each id there can be

ERRORS = {
    1: "it could not do that",
    2: "it does not know that instruction",
    4: "the value is out of range, or a tripped bus watchdog keeps it from being set",
    5: "the length does not fit the register",
    6: "the value is beyond the limit set in the servo",
    7: "there is no such register, or it cannot be written while the torque is on",
}


class Bus:
    """One servo's requests. timeout: s that a reply may take beyond its time on the wire.

    alert: whether the last reply said that a hardware error is latched. return_delay: s that the servo waits before it
    answers. Each request raises NoReply, BadReply, LinkLost, and DriverError where the servo refuses it.
    """

    def __init__(self, port: SerialPort, ident: int, clock: Clock, timeout: float) -> None:
        self._port = port
        self._id = ident
        self._clock = clock
        self._timeout = timeout
        self._packets = Protocol2PacketHandler()
        self._quarantined = True
        self._reads: dict[tuple[int, int], bytes] = {}
        self.alert = False
        self.return_delay = 508e-6

    def ping(self) -> tuple[int, int]:
        """The model number and the firmware version."""
        data = self._ask(self._frame(self._id, PING, b""), 3, "ping")
        return int.from_bytes(data[:2], "little"), data[2]

    def everyone(self) -> list[tuple[int, int]]:
        """Id and model number of every servo that answers a broadcast ping within its window, `_ROLL_CALL`."""
        self._settle()
        self._quarantined = True
        self._put(self._frame(BROADCAST, PING, b""))
        deadline = self._clock.now() + _ROLL_CALL
        heard = b""
        while self._clock.now() < deadline:
            self._port.expect(deadline, 0)
            heard += self._port.readPort(256)
        return [(part[0], int.from_bytes(part[5:7], "little")) for part in self._answers(heard)]

    def _answers(self, heard: bytes) -> Iterator[bytes]:
        """What follows the header in every sound answer to a ping."""
        for part in heard.split(_HEADER)[1:]:
            answer = _HEADER + part[: _PING_ANSWER - len(_HEADER)]
            if len(answer) == _PING_ANSWER and self._packets.updateCRC(0, answer, _PING_ANSWER - 2) == int.from_bytes(
                answer[-2:], "little"
            ):
                yield part

    def read(self, address: int, size: int) -> bytes:
        """`size` bytes from `address` on."""
        return self._ask(self._read_frame(address, size), size, f"reading {size} byte(s) at {address}")

    def write(self, address: int, data: bytes) -> None:
        """Write, and wait for the servo to say that it has."""
        frame = self._frame(self._id, WRITE, address.to_bytes(2, "little") + data)
        self._ask(frame, 0, f"writing {int.from_bytes(data, 'little')} to {address}")

    def send(self, address: int, data: bytes) -> None:
        """Write without an answer, whatever the servo's status return level is and whoever else is talking."""
        self._put(self._unanswered(address, data))

    def write_and_read(self, address: int, data: bytes, start: int, size: int) -> bytes:
        """Write `data` to `address` and read `size` bytes from `start` on, in one round trip.

        The two packets leave in one piece. The first is a Sync Write, which no servo answers.
        """
        return self._ask(self._unanswered(address, data) + self._read_frame(start, size), size, "reading the state")

    def quarantine(self) -> None:
        """Let the line fall silent before the next request."""
        self._quarantined = True

    def _unanswered(self, address: int, data: bytes) -> bytes:
        head = address.to_bytes(2, "little") + len(data).to_bytes(2, "little")
        return self._frame(BROADCAST, SYNC_WRITE, head + bytes([self._id]) + data)

    def _read_frame(self, address: int, size: int) -> bytes:
        key = (address, size)
        if key not in self._reads:
            self._reads[key] = self._frame(self._id, READ, address.to_bytes(2, "little") + size.to_bytes(2, "little"))
        return self._reads[key]

    def _frame(self, ident: int, instruction: int, parameters: bytes) -> bytes:
        body = (bytes([instruction]) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        frame = _HEADER + bytes([ident]) + (len(body) + 2).to_bytes(2, "little") + body
        checksum: int = self._packets.updateCRC(0, frame, len(frame))
        return frame + checksum.to_bytes(2, "little")

    def _settle(self) -> None:
        if not self._quarantined:
            return
        try:
            silent = self._port.drain()
        except GONE as error:
            raise self._lost(error) from None
        if not silent:
            raise BadReply("the line never falls silent: another program or a broken servo keeps talking on it")
        self._quarantined = False

    def _put(self, frame: bytes) -> None:
        try:
            self._port.clearPort()
            written = self._port.writePort(frame)
        except GONE as error:
            raise self._lost(error) from None
        if written != len(frame):
            raise self._lost("it took only a part of a request")

    def _ask(self, frame: bytes, size: int, what: str) -> bytes:
        """Send `frame` and return the `size` bytes of parameters in its answer."""
        self._settle()
        self._quarantined = True  # until a sound reply has come, whatever interrupts the wait
        self._put(frame)
        wire = 10.0 * (len(frame) + _STATUS + size) / self._port.baudrate
        self._port.expect(self._clock.now() + wire + self.return_delay + self._timeout, _STATUS + size)
        try:
            # `fast` keeps the SDK from unstuffing; nothing else differs but that the broadcast id may answer
            raw, result = self._packets.rxPacket(self._port, True)
        except IndexError:
            raise _bad("the reply has an impossible length") from None
        except GONE as error:
            raise self._lost(error) from None
        if result == COMM_RX_TIMEOUT:
            raise NoReply(f"servo {self._id} did not answer within {self._timeout * 1e3:.3g} ms beyond the wire's time")
        if result != COMM_SUCCESS:
            raise _bad("the reply is damaged or cut short")
        return self._checked(bytes(raw), size, what)

    def _checked(self, raw: bytes, size: int, what: str) -> bytes:
        end = _HEAD + int.from_bytes(raw[5:7], "little")
        body = raw[_HEAD : end - 2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        if raw[4] != self._id or body[:1] != bytes([STATUS]) or len(body) < 2:
            raise _bad(f"a reply from servo {raw[4]} came where servo {self._id} was asked")
        if len(body) != 2 + size and not body[1] & ~ALERT:
            raise _bad(f"the reply holds {len(body) - 2} bytes where {size} were asked for")
        self._quarantined = False
        number = body[1] & ~ALERT
        self.alert = bool(body[1] & ALERT)
        if number == _DAMAGED:
            raise _bad("the request reached the servo damaged")
        if number:
            raise DriverError(f"servo {self._id} refused {what}: {ERRORS.get(number, f'error {number}')}")
        return body[2:]

    def _lost(self, reason: object) -> LinkLost:
        return LinkLost(
            f"{self._port.port_name} is gone ({reason}): whether the motor is live is not known; "
            "cut the power before touching it"
        )


def _bad(reason: str) -> BadReply:
    return BadReply(f"{reason}: the sample is dropped")
