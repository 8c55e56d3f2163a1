"""Search for servos on a serial port: for a new hand file, and if the servo of a stand file does not reply."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from drivers.clock import MonotonicClock
from drivers.packets.bus import Bus
from drivers.packets.port import SerialPort
from drivers.packets.wire import BROADCAST, Wire1
from drivers.retry import retry
from drivers.servo import BadReply, DriverError, LinkLost, NoReply

if TYPE_CHECKING:
    from drivers.clock import Clock
    from drivers.packets.wire import Wire

_PATIENCE = 0.1  # s


class Kind(NamedTuple):
    """What a servo is. words: for a sentence. model: as a stand file names it, "" if hil does not drive it. firmware:
    "" if it is not known.
    """

    words: str
    model: str = ""
    firmware: str = ""


UNKNOWN = Kind("servo on protocol 1.0")
"""A servo that is of another family or of no known kind."""


@dataclass(frozen=True, slots=True)
class FoundServo:
    """A servo that replies to a ping with the id `ident` at `baudrate` bit/s."""

    ident: int
    baudrate: int
    kind: Kind

    def __str__(self) -> str:
        return f"a {self.kind.words} answers with id {self.ident} at {self.baudrate} baud"


def scan_every_rate(
    path: str,
    rates: Sequence[int],
    wires: Sequence[Wire],
    *,
    recognise: Callable[[Bus, int, int], Kind],
    clock: Clock | None,
    port: SerialPort | None,
) -> list[FoundServo]:
    """Return every servo that replies to a ping at any baud rate on the port `path`. Only pings and reads are sent.

    rates: the baud rates to try, bit/s; those that the port does not have are left out. wires: the protocols to try.
    recognise: a function that returns what a servo is, from the requests to it, its id and its model number (0: not
    reported). clock, port: given by tests; None uses the real clock and opens the port. Raises DriverError if the port
    cannot be opened, LinkLost.
    """
    clock = clock or MonotonicClock()
    found: list[FoundServo] = []
    refused: list[DriverError] = []
    for baudrate in rates:
        line = port or SerialPort(path, baudrate, clock)
        line.baudrate = baudrate
        try:
            line.openPort()
        except DriverError as error:
            refused.append(error)
            continue
        try:
            for wire in wires:
                for ident, number in _answering(Bus(line, BROADCAST, clock, 0.0, wire), wire):
                    bus = Bus(line, ident, clock, _PATIENCE, wire)
                    found.append(FoundServo(ident, baudrate, _recognised(recognise, bus, ident, number)))
        finally:
            line.closePort()
    if len(refused) == len(rates):
        raise refused[0]
    return found


def _answering(bus: Bus, wire: Wire) -> list[tuple[int, int]]:
    """Return id and model number of every servo that replies to a ping. If one does, all are asked once more, because a
    line loses replies. Servos on protocol 1.0 would all reply to a broadcast ping at once, so each id gets its own.
    """
    one_by_one = isinstance(wire, Wire1)
    found: set[tuple[int, int]] = set()
    for _ in range(2):
        try:
            found |= set(bus.ping_each(range(BROADCAST)) if one_by_one else bus.ping_all())
        except BadReply:  # the line does not fall silent at this baud rate
            break
        if not found:
            break
    return sorted(found)


def _recognised(recognise: Callable[[Bus, int, int], Kind], bus: Bus, ident: int, number: int) -> Kind:
    try:
        return retry(lambda: recognise(bus, ident, number))
    except LinkLost:
        raise
    except NoReply:
        return Kind("servo that replies to a ping and to no read")
    except DriverError as error:
        return Kind(f"servo whose replies cannot be understood ({error}), as if two had this id,")
