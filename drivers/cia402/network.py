"""The library canopen on a link of ours: no threads, no clock but ours, every wait bounded.

canopen's Network reads its bus in a thread of python-can's and its SDO client waits on a queue by the wall clock. Both
are replaced where the library says they may be: frames are sent by `send_message`, handed in by `notify`, and while a
reply is awaited the bus is read. A tick's PDOs go through `drivers.canbus.requests`.
"""

from __future__ import annotations

import logging
import queue
import struct
from collections.abc import Hashable, Iterable
from typing import TYPE_CHECKING, Any

from canopen import Network, ObjectDictionary, RemoteNode, SdoAbortedError, SdoCommunicationError
from canopen.sdo.client import SdoClient

from drivers.canbus.link import frame
from drivers.canbus.requests import Requests
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.cia402.profiles import Place
    from drivers.clock import Clock

logging.getLogger("canopen").addHandler(logging.NullHandler())  # it would write on stderr what is raised anyway

SYNC = 0x080
_TRIES = 3
_SDO_TIMEOUT = 0.1
"""s that an SDO may take: drives answer them beside their control loop."""


class Refused(DriverError):
    """The drive aborted a transfer. code: of CiA 301."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code

    @property
    def missing(self) -> bool:
        """Whether there is no such object."""
        return self.code in {0x06020000, 0x06090011}


class _Sdo(SdoClient):
    """An SDO client that reads the bus while it waits."""

    def __init__(self, network: LinkedNetwork, ident: int) -> None:
        dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen is typed in parts
        super().__init__(0x600 + ident, 0x580 + ident, dictionary)  # type: ignore[no-untyped-call]  # as above
        self.network = self._linked = network

    def read_response(self) -> bytes:
        """The next reply, 8 bytes. Raises canopen's errors."""
        if not self._linked.requests.await_change(_SDO_TIMEOUT, lambda: not self.responses.empty()):
            raise SdoCommunicationError("no reply")
        reply: bytes = self.responses.get_nowait()
        if len(reply) != 8:
            raise SdoCommunicationError("a reply was cut short")
        if reply[0] == 0x80:
            raise SdoAbortedError(struct.unpack_from("<L", reply, 4)[0])
        return reply


class LinkedNetwork(Network):
    """canopen's network on `link`, with node `ident` in it. replies to a SYNC: the kinds "tpdo1" and "tpdo2"."""

    def __init__(self, link: CanLink, clock: Clock, ident: int, timeout: float) -> None:
        super().__init__()
        self._link = link
        self._clock = clock
        self._kinds: dict[int, Hashable] = {0x180 + ident: "tpdo1", 0x280 + ident: "tpdo2"}
        self.requests = Requests(
            link,
            clock,
            name=f"CANopen node {ident}",
            timeout=timeout,
            classify=self._classify,
            overhear=self._overhear,
            only_asked=frozenset(),  # any SYNC on the bus, another program's too, brings the PDOs
        )
        self.node = RemoteNode(ident, ObjectDictionary())  # type: ignore[no-untyped-call]  # as above
        self.node.sdo = _Sdo(self, ident)
        self.node.sdo_channels = [self.node.sdo]
        self[ident] = self.node

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame. Raises LinkLost, NoReply where nobody on the bus takes frames."""
        self._link.send(frame(can_id, bytes(data or b""), remote=remote))

    def read(self, place: Place) -> bytes:
        """What an object holds. Raises NoReply, Refused, LinkLost, BadReply."""
        return self._transfer(place, None)

    def write(self, place: Place, data: bytes) -> None:
        """Set an object. Raises NoReply, Refused, LinkLost, BadReply."""
        self._transfer(place, data)

    def ask_for(self, place: Place) -> can.Message:
        """The frame that asks for an object whose answer is not waited for: see `late_answer`."""
        return frame(self.node.sdo.rx_cobid, struct.pack("<BHB4x", 0x40, place.object, place.sub))

    def late_answers(self) -> Iterable[tuple[tuple[int, int], bytes]]:
        """What has been answered to `ask_for`: index and sub-index, and data."""
        while True:
            try:
                reply = self.node.sdo.responses.get_nowait()
            except queue.Empty:
                return
            if len(reply) == 8 and reply[0] & 0xE3 == 0x43:
                _, index, sub = struct.unpack_from("<BHB", reply)
                yield (index, sub), reply[4 : 8 - (reply[0] >> 2 & 3)]

    def _transfer(self, place: Place, data: bytes | None) -> bytes:
        for attempt in range(_TRIES):
            try:
                if data is None:
                    found: bytes = self.node.sdo.upload(place.object, place.sub)
                    return found
                self.node.sdo.download(place.object, place.sub, data)
                return data
            except SdoAbortedError as error:
                word = "read" if data is None else f"written to {int.from_bytes(data, 'little')}"
                raise Refused(error.code, f"object {place} cannot be {word}: {error}") from None
            except (SdoCommunicationError, struct.error) as error:
                if attempt == _TRIES - 1:
                    kind = NoReply if str(error) == "no reply" else BadReply
                    raise kind(f"CANopen node {self.node.id} does not answer for object {place}: {error}") from None
                self.requests.await_change(0.02, lambda: False)  # what comes late is thrown away with the next request
        raise AssertionError

    def _classify(self, message: can.Message) -> Hashable | None:
        if message.is_extended_id or message.is_remote_frame:
            return None
        ident: int = message.arbitration_id
        return self._kinds.get(ident, ident) if ident in self._kinds or ident in self.subscribers else None

    def _overhear(self, kind: Hashable, data: bytes) -> None:
        """Hand canopen what the node said; what is too short for it is noise."""
        if isinstance(kind, int) and data:
            try:
                self.notify(kind, bytearray(data), self._clock.now())
            except struct.error:
                return
