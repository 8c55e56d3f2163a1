"""Send requests to one servo and return its replies, over dynamixel-sdk, in either DYNAMIXEL protocol.

The SDK handles the port, the search for the header and the checksum. This module corrects the following. The SDK
accepts any status packet as the reply; here id, kind and length are checked. The SDK accepts a late reply as the reply
to the next request; here the line must fall silent after a lost reply, before the next request. After an exception, the
SDK's flag for a port in use stays set; here this has no effect, because this module sends the requests itself.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS

from drivers.packets.port import SILENT_FOR
from drivers.packets.wire import BROADCAST, PING, READ, SYNC_WRITE, WRITE
from drivers.retry import Repeats
from drivers.servo import BadReply, DriverError, NoReply, link_lost
from drivers.uart.adapter import Lateness
from drivers.uart.port import GONE

if TYPE_CHECKING:
    from collections.abc import Iterable

    from drivers.clock import Clock
    from drivers.packets.port import SerialPort
    from drivers.packets.wire import Answer, Wire

_LONGEST_DELAY, _SLACK = 508e-6, 1e-3  # s of Return Delay Time at most; s by which an adapter may bunch two requests
_OVERTAKEN = 0.05  # s of silence after which no lost reply is on its way, before the motor is driven
_ROLL_CALL = 0.8  # s; servos reply to a broadcast ping one after the other, 3 ms for each possible id


class Bus:
    """Requests to one servo. timeout: s to wait for a reply, in addition to its time on the wire.

    clock: of the servo. repeats: whether a request whose reply was lost is sent again. alert: the hardware errors in
    the last reply, 0 if there are none. return_delay: s that the servo waits before it replies. Each request raises
    NoReply, BadReply, LinkLost, and DriverError if the servo refuses it.
    """

    def __init__(self, port: SerialPort, ident: int, clock: Clock, timeout: float, wire: Wire) -> None:
        self._port = port
        self._id = ident
        self.clock = clock
        self._late = Lateness(port.port_name, timeout, SILENT_FOR)
        self._wire = wire
        self._quarantined, self._owed = True, False
        self._reads: dict[tuple[int, int], bytes] = {}
        self.repeats = Repeats()
        self.alert = 0
        self.return_delay = _LONGEST_DELAY

    def duration(self, size: int) -> float:
        """Return the time, s, that `size` bytes take on the line."""
        return 10.0 * size / self._port.baudrate

    def ping(self, size: int) -> bytes:
        """Send a ping and return the parameters of its reply, `size` bytes."""
        return self._ask(self._wire.frame(self._id, PING, b""), size, "ping")

    def beside(self, ident: int) -> Bus:
        """Return the requests to another servo on the same line, whose return delay is not known."""
        other = Bus(self._port, ident, self.clock, 0.0, self._wire)
        other._late, self._quarantined = self._late, True
        return other

    def ping_each(self, idents: Iterable[int]) -> list[tuple[int, int]]:
        """Send a ping to each id in turn. Return id and model number (0: not reported) of every servo that replies.

        The replies are read together at the end, so that an adapter that holds them back costs no time. Each id takes
        the time of both packets on the line, the longest return delay and `_SLACK`.
        """
        self._settle()
        self._quarantined = True
        received, echo = b"", False
        for ident in idents:
            frame = self._wire.frame(ident, PING, b"")
            self._put(frame)
            echo = self._port.keep_echo()
            line = self.duration(len(frame) + self._wire.status_size)
            self.clock.sleep_until(self.clock.now() + line + _LONGEST_DELAY + _SLACK)
            received += self._received(0.0)
        received += self._received(self._late.silence)
        packets = Counter(self._wire.pings(received))
        return sorted(servo for servo, count in packets.items() if count > int(echo))

    def ping_all(self) -> list[tuple[int, int]]:
        """Send a broadcast ping. Return id and model number (0 if not reported) of every servo that replies."""
        self._settle()
        self._quarantined = True
        self._put(self._wire.frame(BROADCAST, PING, b""))
        return list(self._wire.pings(self._received(_ROLL_CALL)))

    def read(self, address: int, size: int) -> bytes:
        """Return `size` bytes of the servo's memory from `address` on."""
        return self._ask(self._read_frame(address, size), size, f"reading {size} byte(s) at {address}")

    def write(self, address: int, data: bytes) -> None:
        """Write `data` to `address`, and wait for the servo's confirmation."""
        frame = self._wire.frame(self._id, WRITE, self._wire.place(address) + data)
        self._ask(frame, 0, f"writing {int.from_bytes(data, 'little')} to {address}")

    def send(self, address: int, data: bytes, neighbours: Iterable[int] = ()) -> None:
        """Write `data` to `address` at once, also in the servos `neighbours`: wait neither for a reply nor for a silent
        line.
        """
        self._put(self.unanswered(address, data, neighbours))

    def write_and_read(self, address: int, data: bytes, start: int, size: int) -> bytes:
        """Write `data` to `address` and read `size` bytes from `start` on, in one round trip.

        The two packets are sent together. The first is a Sync Write, which has no reply.
        """
        return self._ask(self.unanswered(address, data) + self._read_frame(start, size), size, "reading the state")

    def silent(self, factory_rate: int) -> NoReply:
        """Return the error for a servo that replies to no request. factory_rate: the baud rate of a new servo,
        bit/s.
        """
        return NoReply(
            f"no servo {self._id} answers on {self._port.port_name} at {self._port.baudrate} baud: check its power, "
            f"the cable, the id and the baud rate (a new servo has id 1 and {factory_rate} baud)"
        )

    def garbled(self, error: BadReply) -> BadReply:
        """Return the error for replies that cannot be decoded. error: the reason."""
        return BadReply(
            f"the replies of servo {self._id} cannot be understood ({error}): two servos with that id, a wrong baud "
            "rate, or a bad cable; connect one servo alone and give each its own id"
        )

    def quarantine(self) -> None:
        """Make the next request wait until the line is silent."""
        self._quarantined = True

    def unanswered(self, address: int, data: bytes, neighbours: Iterable[int] = ()) -> bytes:
        """Return the packet that writes `data` to `address`, also in the servos `neighbours`, and has no reply."""
        each = b"".join(bytes([ident]) + data for ident in (self._id, *neighbours))
        return self._wire.frame(BROADCAST, SYNC_WRITE, self._wire.place(address, len(data)) + each)

    def _received(self, seconds: float) -> bytes:
        """Return the bytes that arrive within `seconds`. Raises LinkLost."""
        deadline, received = self.clock.now() + seconds, b""
        try:
            while True:
                self._port.expect(deadline, 0)
                received += self._port.readPort(256)
                if self.clock.now() >= deadline:
                    return received
        except GONE as error:
            raise link_lost(self._port.port_name, error) from None

    def _read_frame(self, address: int, size: int) -> bytes:
        key = (address, size)
        if key not in self._reads:
            self._reads[key] = self._wire.frame(self._id, READ, self._wire.place(address, size))
        return self._reads[key]

    def _settle(self) -> None:
        # a late reply to an earlier read would become a setting, to which the servo's memory is restored at the end
        late = self._owed and self.repeats.are_active
        if not self._quarantined and not late:
            return
        try:
            silent = self._port.drain(max(self._late.silence, _OVERTAKEN if late else 0.0))
        except GONE as error:
            raise link_lost(self._port.port_name, error) from None
        if not silent:
            raise BadReply("the line never falls silent: another program or a broken servo keeps sending on it")
        self._quarantined, self._owed = False, self._owed and not late

    def _put(self, frame: bytes) -> None:
        try:
            self._port.clearPort()
            written = self._port.writePort(frame)
        except GONE as error:
            raise link_lost(self._port.port_name, error) from None
        if written != len(frame):
            raise link_lost(self._port.port_name, "it accepted only a part of a request")

    def _ask(self, frame: bytes, size: int, what: str) -> bytes:
        """Send `frame` and return the parameters of the reply, `size` bytes. what: name of the request in messages."""
        return self.repeats(lambda: self._ask_once(frame, size, what))

    def _ask_once(self, frame: bytes, size: int, what: str) -> bytes:
        self._settle()
        self._quarantined = True  # until a valid reply arrives, whatever interrupts the wait
        self._put(frame)
        whole = self._wire.status_size + size
        line = self.duration(len(frame) + whole)
        due = self.clock.now() + line + self.return_delay
        self._port.expect(due + self._late.wait, whole)
        try:
            raw, result = self._wire.receive(self._port)
        except IndexError:
            raise _bad("the reply has an impossible length") from None
        except GONE as error:
            raise link_lost(self._port.port_name, error) from None
        if result == COMM_RX_TIMEOUT:
            self._owed, waited = True, self._late.wait * 1e3
            raise NoReply(f"servo {self._id} did not answer within {waited:.3g} ms beyond the wire's time")
        if result != COMM_SUCCESS:
            raise _bad("the reply is damaged or cut short")
        answer = self._checked(self._wire.opened(raw), size, what)
        self._late.note(self.clock.now() - due)
        return answer

    def _checked(self, answer: Answer | None, size: int, what: str) -> bytes:
        if answer is None or answer.ident != self._id:
            sender = "another device" if answer is None else f"servo {answer.ident}"
            raise _bad(f"a reply from {sender} arrived where servo {self._id} was asked")
        if len(answer.data) != size and not answer.refused and not answer.damaged:
            raise _bad(f"the reply has {len(answer.data)} bytes where {size} were requested")
        self._quarantined = False
        self.alert = answer.alert
        if answer.damaged:
            raise _bad("the request reached the servo damaged")
        if answer.refused:
            raise DriverError(f"servo {self._id} refused {what}: {answer.refused}")
        return answer.data


def _bad(reason: str) -> BadReply:
    return BadReply(f"{reason}: the sample is dropped")
