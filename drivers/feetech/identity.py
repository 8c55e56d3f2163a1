"""Identify a servo: check that it is the model of the stand file, that its firmware has the needed registers, and that
no second servo replies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from drivers.feetech.block import START
from drivers.feetech.config import Baudrate, FeetechConfig
from drivers.feetech.faults import ALERTS
from drivers.feetech.models import models, name_of, registers
from drivers.packets.neighbours import holding, others
from drivers.packets.scan import UNKNOWN, FoundServo, Kind, scan_every_rate
from drivers.packets.wire import BROADCAST, Wire1
from drivers.retry import ATTEMPTS, retry
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    from drivers.clock import Clock
    from drivers.neighbours import Neighbour
    from drivers.packets.bus import Bus
    from drivers.packets.port import SerialPort

_MEMORY = 71
_LINE = 16
RATES = get_args(Baudrate)
"""The baud rates that a scan tries, bit/s."""
_TORQUE_ENABLE = 40  # in every family: table.toml


def identify(bus: Bus, config: FeetechConfig) -> str:
    """Check the model, lock the servo's EEPROM, and make the servo reply to every request. Return its firmware version.

    Raises NoReply, BadReply if several servos reply at once, DriverError for another model, for an unknown model (the
    message lists its registers), or for firmware without the needed registers.
    """
    try:
        head = retry(lambda: bus.read(0, 5))
        _check(bus, config, head)
        own = registers(models()[config.model].family)
        for name in ("lock", "response_level"):
            bus.send(own[name].address, b"\x01")
        for _ in range(ATTEMPTS):
            bus.read(START, 8)
    except NoReply:
        raise bus.silent(1_000_000) from None
    except BadReply as error:
        raise bus.garbled(error) from None
    return f"{head[0]}.{head[1]}"


def _check(bus: Bus, config: FeetechConfig, head: bytes) -> None:
    """Raise DriverError if `head`, the bytes 0 to 4 of the memory, are not those of the model in the stand file."""
    model = models()[config.model]
    number, firmware = (head[3], head[4]), (head[0], head[1])
    name = name_of(number)
    if not name:
        raise DriverError(
            f"servo {config.id} on {config.port} is of a kind not known here (version {head[3]}.{head[4]}, firmware "
            f"{head[0]}.{head[1]}), and nothing was written to it; report its registers: {_dump(bus)}"
        )
    if name != config.model:
        raise DriverError(
            f"servo {config.id} on {config.port} is of the kind {name} (version {head[3]}.{head[4]}), not the "
            f"{config.model} of the stand file: correct feetech.model or feetech.id"
        )
    if firmware < model.firmware:
        raise DriverError(
            f"servo {config.id} has firmware {head[0]}.{head[1]}, and the registers of the {config.model} that are "
            f"needed (torque limit and mode) came with {model.firmware[0]}.{model.firmware[1]}: install a newer one "
            "with the vendor's debugging software (FD)"
        )


def _dump(bus: Bus) -> str:
    """Return the servo's memory as text, as far as the servo permits to read it."""
    lines = []
    for first in range(0, _MEMORY, _LINE):
        size = min(_LINE, _MEMORY - first)
        try:
            lines.append(f"{first}: {bus.read(first, size).hex(' ')}")
        except (NoReply, BadReply):
            lines.append(f"{first}: not readable")
    return "; ".join(lines)


def neighbours(bus: Bus, ident: int) -> list[Neighbour]:
    """Return the other servos on the line whose torque is on or cannot be read. ident: of the stand's servo. Raises
    DriverError.
    """
    found: list[Neighbour] = []
    for other, _ in others(ident, lambda: bus.ping_each(range(BROADCAST))):
        beside = bus.beside(other)
        found += holding(beside, other, _kind(beside, other), _TORQUE_ENABLE)
    return found


def scan(path: str, clock: Clock | None = None, port: SerialPort | None = None) -> list[FoundServo]:
    """Return every servo that replies at any baud rate on the port `path`. See `scan_every_rate`."""
    return scan_every_rate(path, RATES, (Wire1(ALERTS),), recognise=_recognise, clock=clock, port=port)


def search(config: FeetechConfig, clock: Clock | None = None, port: SerialPort | None = None) -> list[str]:
    """Return a sentence for every servo that `scan` finds."""
    return [str(servo) for servo in scan(config.port, clock, port)]


def _recognise(bus: Bus, ident: int, _number: int = 0) -> Kind:
    """Return what a servo is. Its ID(5) must be `ident`: another family has other registers there."""
    first, second, _, main, sub, own = bus.read(0, 6)
    if own != ident:
        return UNKNOWN
    name, firmware = name_of((main, sub)), f"{first}.{second}"
    return Kind(name or f"servo of a kind not known here (version {main}.{sub})", name, firmware)


def _kind(bus: Bus, ident: int) -> str:
    try:
        return _recognise(bus, ident).words
    except DriverError:
        return "servo of a kind that it does not tell"
