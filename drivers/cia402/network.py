"""Use the library canopen on a `CanLink`: without threads, with the servo's clock and a limit on every wait.

canopen's Network reads the bus in a thread, and its SDO client waits on a queue with the wall clock. Both are replaced:
`send_message` sends frames, `notify` receives frames, and the bus is read during the wait for an SDO reply. The PDOs of
a tick are exchanged by `drivers.canbus.requests`.
"""

from __future__ import annotations

import logging
import queue
import struct
from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING, Any

from canopen import Network, ObjectDictionary, RemoteNode, SdoAbortedError, SdoCommunicationError
from canopen.nmt import NMT_STATES
from canopen.sdo.client import ReadableStream, SdoClient

from drivers.canbus.link import frame
from drivers.canbus.requests import Requests
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.cia402.profiles import ObjectIndex
    from drivers.clock import Clock

logging.getLogger("canopen").addHandler(logging.NullHandler())  # its errors are raised; it would also print them

SYNC = 0x080
_HEARTBEAT = 0x700  # and the node's id
_TRIES = 3
_SDO_TIMEOUT = 0.1
"""s to wait for an SDO reply: drives process SDOs with low priority."""
_SEGMENTS = 40
"""The most segments of an SDO reply, 7 bytes each; the longest that is read is a drive's name."""
_OUT_OF_MEMORY = 0x05040005  # abort code of CiA 301
_SDO_WAITS = 20
"""How many times `LinkedNetwork.while_waiting` is called during `_SDO_TIMEOUT`."""


class Refused(DriverError):
    """Error: the drive aborted an SDO transfer. code: the abort code of CiA 301."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code

    @property
    def missing(self) -> bool:
        """Return whether the abort code says that the object does not exist."""
        return self.code in {0x06020000, 0x06090011}


class _Sdo(SdoClient):
    """An SDO client that reads the CAN bus while it waits for a reply."""

    def __init__(self, network: LinkedNetwork, ident: int) -> None:
        dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen is typed in parts
        super().__init__(0x600 + ident, 0x580 + ident, dictionary)  # type: ignore[no-untyped-call]  # as above
        self.network = self._linked = network

    def read_response(self) -> bytes:
        """Return the next reply, 8 bytes. Raises canopen's errors."""
        for _ in range(_SDO_WAITS):
            if self._linked.requests.wait_until(_SDO_TIMEOUT / _SDO_WAITS, lambda: not self.responses.empty()):
                break
            self._linked.while_waiting()
        else:
            raise SdoCommunicationError("no reply")
        reply: bytes = self.responses.get_nowait()
        if len(reply) != 8:
            raise SdoCommunicationError("a reply was cut short")
        if reply[0] == 0x80:
            raise SdoAbortedError(struct.unpack_from("<L", reply, 4)[0])
        return reply


class LinkedNetwork(Network):
    """canopen's network on `link`, with the node `ident`. The drive's two replies to a SYNC have the kinds "tpdo1" and
    "tpdo2".

    timeout: s to wait for the replies to a SYNC. while_waiting: a function that is called again and again during the
    wait for an SDO reply.
    """

    def __init__(self, link: CanLink, clock: Clock, ident: int, timeout: float) -> None:
        super().__init__()
        self._link = link
        self._clock = clock
        self.while_waiting: Callable[[], None] = lambda: None
        self._kinds: dict[int, Hashable] = {0x180 + ident: "tpdo1", 0x280 + ident: "tpdo2"}
        self.requests = Requests(
            link,
            clock,
            name=f"CANopen node {ident}",
            timeout=timeout,
            classify=self._classify,
            on_cyclic=self._on_cyclic,
            only_on_request=frozenset(),  # every SYNC on the bus causes PDOs, another program's too
        )
        self.node = RemoteNode(ident, ObjectDictionary())  # type: ignore[no-untyped-call]  # as above
        self.node.sdo = _Sdo(self, ident)
        self.node.sdo_channels = [self.node.sdo]
        self[ident] = self.node

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame. Raises LinkLost; NoReply if no node on the bus acknowledges."""
        self._link.send(frame(can_id, bytes(data or b""), remote=remote))

    def read(self, place: ObjectIndex) -> bytes:
        """Read the object `place` by SDO and return its data. Raises NoReply, Refused, LinkLost, BadReply."""
        return self._transfer(place, None)

    def write(self, place: ObjectIndex, data: bytes) -> None:
        """Write `data` to the object `place` by SDO. Raises NoReply, Refused, LinkLost, BadReply."""
        self._transfer(place, data)

    def read_request(self, place: ObjectIndex) -> can.Message:
        """Return the frame that requests the object `place`. `late_replies` returns the reply later."""
        return frame(self.node.sdo.rx_cobid, struct.pack("<BHB4x", 0x40, place.object, place.sub))

    def write_request(self, place: ObjectIndex, data: bytes) -> can.Message:
        """Return the frame that writes up to 4 bytes to the object `place`; its reply is ignored."""
        command = 0x23 | (4 - len(data)) << 2
        head = struct.pack("<BHB", command, place.object, place.sub)
        return frame(self.node.sdo.rx_cobid, head + data.ljust(4, b"\0"))

    def late_replies(self) -> Iterable[tuple[tuple[int, int], bytes]]:
        """Return the replies that have arrived to requests of `read_request`, each as ((index, sub-index), data)."""
        while True:
            try:
                reply = self.node.sdo.responses.get_nowait()
            except queue.Empty:
                return
            if len(reply) == 8 and reply[0] & 0xE3 == 0x43:
                _, index, sub = struct.unpack_from("<BHB", reply)
                yield (index, sub), reply[4 : 8 - (reply[0] >> 2 & 3)]

    def _transfer(self, place: ObjectIndex, data: bytes | None) -> bytes:
        for attempt in range(_TRIES):
            try:
                if data is None:
                    return self._upload(place)
                self.node.sdo.download(place.object, place.sub, data)
                return data
            except SdoAbortedError as error:
                word = "read" if data is None else f"written to {int.from_bytes(data, 'little')}"
                raise Refused(error.code, f"object {place} cannot be {word}: {error}") from None
            except (SdoCommunicationError, struct.error) as error:
                if attempt == _TRIES - 1:
                    kind = NoReply if str(error) == "no reply" else BadReply
                    raise kind(f"CANopen node {self.node.id} does not reply for object {place}: {error}") from None
                self.requests.wait_until(0.02, lambda: False)  # a late reply is discarded with the next request
        raise AssertionError

    def _upload(self, place: ObjectIndex) -> bytes:
        """Return the data of the object `place`. Raises canopen's errors, and BadReply for data without an end."""
        stream = ReadableStream(self.node.sdo, place.object, place.sub)  # type: ignore[no-untyped-call]  # as above
        data = b""
        for _ in range(_SEGMENTS):
            part: bytes = stream.read(7)  # type: ignore[no-untyped-call]  # as above
            if not part:
                return data
            data += part
        self.node.sdo.abort(_OUT_OF_MEMORY)
        raise BadReply(
            f"CANopen node {self.node.id} sends object {place} without an end, {len(data)} bytes so far: update the "
            "drive's firmware, or look for a second program that uses its SDO"
        )

    def _classify(self, message: can.Message) -> Hashable | None:
        if message.is_extended_id or message.is_remote_frame:
            return None
        ident: int = message.arbitration_id
        return self._kinds.get(ident, ident) if ident in self._kinds or ident in self.subscribers else None

    def _on_cyclic(self, kind: Hashable, data: bytes) -> None:
        """Pass a frame of the node to canopen. A frame that is too short, or a heartbeat with an unknown state, is
        ignored.
        """
        if isinstance(kind, int) and data and (kind < _HEARTBEAT or data[0] & 0x7F in NMT_STATES):
            try:
                self.notify(kind, bytearray(data), self._clock.now())
            except struct.error:
                return
