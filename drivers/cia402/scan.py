"""Search for CANopen nodes, in case the node of the stand file does not reply.

Only the bit rate of the stand file is used: frames at a wrong bit rate would disturb the other nodes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.canbus.link import BusConfig, CanLink, frame
from drivers.canbus.neighbours import ask_each, listen
from drivers.cia402.network import LinkedNetwork, Refused
from drivers.cia402.profiles import ObjectIndex
from drivers.cia402.states import DriveState, state_of
from drivers.clock import Clock, MonotonicClock
from drivers.neighbours import Neighbour
from drivers.servo import DriverError, LinkLost

if TYPE_CHECKING:
    import can

    from drivers.cia402.config import Cia402Config

_DEVICE_TYPE, _NAME, _STATUSWORD = ObjectIndex(0x1000, 0), ObjectIndex(0x1008, 0), ObjectIndex(0x6041, 0)
_PACE, _AFTER = 5e-4, 0.2
"""s between two requests, because adapters queue few frames; s to wait for the last replies."""
_LIVE = frozenset({DriveState.ENABLED, DriveState.QUICK_STOP, DriveState.REACTING})
"""The states in which a drive may supply its motor with current."""


def search(config: Cia402Config, clock: Clock | None = None, bus: can.BusABC | None = None) -> list[str]:
    """Return a sentence for every CANopen node that replies. Only read requests are sent.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. Raises DriverError if the bus
    cannot be opened.
    """
    clock = clock or MonotonicClock()
    link = CanLink(BusConfig.of(config), clock, bus)
    try:
        return [_described(link, clock, ident) for ident in _answering(link, clock)]
    finally:
        link.close()


def _answering(link: CanLink, clock: Clock) -> list[int]:
    network = LinkedNetwork(link, clock, 1, _PACE)

    def take(message: can.Message) -> None:
        if not message.is_extended_id:
            network.scanner.on_message_received(message.arbitration_id)

    for ident in range(1, 128):
        network.send_message(0x600 + ident, network.read_request(_DEVICE_TYPE).data)
        listen(link, clock, _PACE, take)
    listen(link, clock, _AFTER, take)
    return sorted(network.scanner.nodes)


def neighbours(link: CanLink, clock: Clock, config: Cia402Config) -> list[Neighbour]:
    """Return the other nodes whose statusword says that their motor may carry current. Only read requests are sent.

    Raises LinkLost, and NoReply if the bus accepts no frame.
    """
    network = LinkedNetwork(link, clock, 1, _PACE)
    asked = bytes(network.read_request(_STATUSWORD).data)
    states: dict[int, DriveState] = {}

    def take(message: can.Message) -> None:
        ident, data = message.arbitration_id - 0x580, bytes(message.data)
        expedited = len(data) == 8 and data[0] & 0xE3 == 0x43 and data[1:4] == asked[1:4]
        if expedited and 1 <= ident <= 127 and not message.is_extended_id:
            states[ident] = state_of(int.from_bytes(data[4:6], "little"))

    others = (ident for ident in range(1, 128) if ident != config.id)
    ask_each(link, clock, config.bitrate, (frame(0x600 + ident, asked) for ident in others), take, after=_AFTER)
    return [
        Neighbour(
            ident,
            _name(link, clock, ident),
            f"it is in the state {state.value}",
            f"write 0 to its controlword 0x6040, with the frame {0x600 + ident:03X}#2B40600000000000",
        )
        for ident, state in sorted(states.items())
        if state in _LIVE
    ]


def _name(link: CanLink, clock: Clock, ident: int) -> str:
    """Return the name of the node `ident`, a general one if it reports none. Raises LinkLost."""
    try:
        data = LinkedNetwork(link, clock, ident, _PACE).read(_NAME)
    except LinkLost:
        raise
    except DriverError:
        return "a CiA 402 drive"
    return data.decode("ascii", errors="replace").strip("\0 ")


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
