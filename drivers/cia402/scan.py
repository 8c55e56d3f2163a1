"""Search for CANopen nodes, in case the node of the stand file does not reply.

Only the bit rate of the stand file is used: frames at a wrong bit rate would disturb the other nodes.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from drivers.canbus.link import CanLink
from drivers.cia402.network import LinkedNetwork, Refused
from drivers.cia402.profiles import ObjectIndex
from drivers.clock import Clock, MonotonicClock
from drivers.servo import BadReply, DriverError

if TYPE_CHECKING:
    import can

    from drivers.cia402.config import Cia402Config

_DEVICE_TYPE, _NAME = ObjectIndex(0x1000, 0), ObjectIndex(0x1008, 0)
_PACE, _AFTER = 5e-4, 0.2
"""s between two requests, because adapters queue few frames; s to wait for the last replies."""


def search(config: Cia402Config, clock: Clock | None = None, bus: can.BusABC | None = None) -> list[str]:
    """Return a sentence for every CANopen node that replies. Only read requests are sent.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. Raises DriverError if the bus
    cannot be opened.
    """
    clock = clock or MonotonicClock()
    link = CanLink(config.bus, clock, bus)
    try:
        return [_described(link, clock, ident) for ident in _answering(link, clock)]
    finally:
        link.close()


def _answering(link: CanLink, clock: Clock) -> list[int]:
    network = LinkedNetwork(link, clock, 1, _PACE)
    for ident in range(1, 128):
        network.send_message(0x600 + ident, network.read_request(_DEVICE_TYPE).data)
        _listen(network, link, clock, _PACE)
    _listen(network, link, clock, _AFTER)
    return sorted(network.scanner.nodes)


def _listen(network: LinkedNetwork, link: CanLink, clock: Clock, seconds: float) -> None:
    end = clock.now() + seconds
    while clock.now() < end:
        with contextlib.suppress(BadReply):
            message = link.receive(end)
            if message is not None and not message.is_extended_id and not message.is_remote_frame:
                network.scanner.on_message_received(message.arbitration_id)


def _described(link: CanLink, clock: Clock, ident: int) -> str:
    network = LinkedNetwork(link, clock, ident, _PACE)
    try:
        kind = int.from_bytes(network.read(_DEVICE_TYPE), "little") & 0xFFFF
        name = network.read(_NAME).decode("ascii", errors="replace").strip("\0 ")
    except Refused:
        return f"a device without a name answers with node id {ident}"
    except DriverError:
        return f"a device that cannot be read sends with node id {ident}"
    return f"{name} (profile CiA {kind}) answers with node id {ident}"
