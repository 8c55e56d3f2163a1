"""Identify a servo: check that it is the model of the stand file, that its firmware has a watchdog, and that no second
servo replies.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, get_args

from drivers.dynamixel.config import Baudrate
from drivers.dynamixel.models import is_known, models, name_of, torque_enable
from drivers.dynamixel.wire import Wire2, wire_1
from drivers.packets.neighbours import holding, others
from drivers.packets.scan import UNKNOWN, FoundServo, Kind, scan_every_rate
from drivers.retry import ATTEMPTS, retry
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    from drivers.clock import Clock
    from drivers.dynamixel.config import DynamixelConfig
    from drivers.dynamixel.series import Series
    from drivers.neighbours import Neighbour
    from drivers.packets.bus import Bus
    from drivers.packets.control_table import ControlTable
    from drivers.packets.port import SerialPort

RETURN_DELAY_LSB = 2e-6
"""s in one count of Return Delay Time."""
RATES = get_args(Baudrate)
"""The baud rates that a scan tries, bit/s."""


def identify(bus: Bus, table: ControlTable, config: DynamixelConfig, series: Series) -> str:
    """Check the model, make the servo reply to every request, and read its return delay. Return its firmware version.

    Raises NoReply, BadReply if several servos reply at once, DriverError for another model or for firmware without a
    watchdog.
    """
    number, firmware = _model_and_firmware(bus, table, series)
    model = models()[config.model]
    if number != model.number:
        raise DriverError(
            f"servo {config.id} on {config.port} is a {name_of(number)} (model number {number}), not the "
            f"{config.model} (model number {model.number}) of the stand file: correct dynamixel.model or dynamixel.id"
        )
    if config.watchdog and firmware < model.watchdog_firmware:
        raise DriverError(
            f"servo {config.id} has firmware {firmware}, and the bus watchdog came with {model.watchdog_firmware}: "
            "install a newer one with DYNAMIXEL Wizard, or set dynamixel.watchdog = 0; the motor then stays live when "
            "this computer stops"
        )
    try:
        _confirm_writes(bus, table, series)
        bus.return_delay = table.get("return_delay_time") * RETURN_DELAY_LSB
        for _ in range(ATTEMPTS):
            bus.read(*series.block)
    except BadReply as error:
        raise bus.garbled(error) from None
    return str(firmware)


def _confirm_writes(bus: Bus, table: ControlTable, series: Series, level: int | None = None) -> None:
    """Set Status Return Level to 2, so that the servo confirms writes. An X servo loses this setting without power.

    An MX servo stores the setting, so the earlier value is restored at the end; the register is locked while the torque
    is on. level: the earlier value, for a servo that does not reply to reads; None: read it.
    """
    if not _keeps_level(series):
        bus.send(series.registers["status_return_level"].address, b"\x02")
    elif level is not None or table.get("status_return_level") != 2:
        bus.send(series.registers["torque_enable"].address, b"\x00")
        table.settings.require("status_return_level", 2, before=level)


def _keeps_level(series: Series) -> bool:
    return series.registers["status_return_level"].address < series.eeprom_end


def _model_and_firmware(bus: Bus, table: ControlTable, series: Series) -> tuple[int, int]:
    """Return model number and firmware version. A request whose reply is lost is repeated."""
    try:
        with contextlib.suppress(NoReply):
            return retry(lambda: series.identity(bus))
        if not (_keeps_level(series) and _answers_pings_only(bus)):
            raise bus.silent(57600)
        return _unmuted(bus, table, series)
    except BadReply as error:
        raise bus.garbled(error) from None


def _answers_pings_only(bus: Bus) -> bool:
    """Return whether the servo replies to every ping and to no read: its Status Return Level is 0."""
    for _ in range(ATTEMPTS):
        try:
            bus.ping(0)
        except NoReply:
            return False
        try:
            bus.read(0, 3)
        except NoReply:
            continue
        return False
    return True


def _unmuted(bus: Bus, table: ControlTable, series: Series) -> tuple[int, int]:
    """Make a servo that replies only to pings reply to all requests, and return model and firmware. Raises NoReply if
    it still does not reply.
    """
    try:
        _confirm_writes(bus, table, series, level=0)
        return retry(lambda: series.identity(bus))
    except NoReply:
        raise NoReply(
            "the servo answers a ping and nothing else: its Status Return Level(16) is 0 and could not be changed; "
            "switch it off and on, and set that register to 2 with DYNAMIXEL Wizard"
        ) from None


def neighbours(bus: Bus, ident: int, series: Series) -> list[Neighbour]:
    """Return the other servos on the line that speak the protocol of `series` and whose torque is on or cannot be read.

    ident: of the stand's servo. Raises DriverError.
    """
    found: list[Neighbour] = []
    if isinstance(series.wire, Wire2):
        for other, number in others(ident, bus.ping_all):
            found += holding(bus.beside(other), other, name_of(number), torque_enable(number))
        return found
    address = torque_enable(0)
    for other, _ in others(ident, lambda: bus.ping_each(range(253))):
        beside = bus.beside(other)
        kind = "of a kind that it does not report"
        with contextlib.suppress(NoReply, BadReply):
            kind = name_of(int.from_bytes(beside.read(0, 2), "little"))
        found += holding(beside, other, kind, address)
    return found


def scan(path: str, clock: Clock | None = None, port: SerialPort | None = None) -> list[FoundServo]:
    """Return every servo that replies at any baud rate on the port `path`. See `scan_every_rate`."""
    return scan_every_rate(path, RATES, (Wire2(), wire_1()), recognise=_recognise, clock=clock, port=port)


def search(config: DynamixelConfig, clock: Clock | None = None, port: SerialPort | None = None) -> list[str]:
    """Return a sentence for every servo that `scan` finds."""
    return [str(servo) for servo in scan(config.port, clock, port)]


def _recognise(bus: Bus, ident: int, number: int) -> Kind:
    """Return what a servo is. On protocol 1.0 it must be a known model whose ID(3) is `ident`: another family has other
    registers there.
    """
    if number:
        firmware = bus.ping(3)[2]
    else:
        low, high, firmware, own = bus.read(0, 4)
        number = low + 256 * high
        if own != ident or not is_known(number):
            return UNKNOWN
    name = name_of(number)
    words = name if is_known(number) else f"servo {name} (model number {number})"
    return Kind(words, name if name in models() else "", str(firmware))
