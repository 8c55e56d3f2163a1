"""Who answers at an id: the right model, with firmware that can be trusted with torque, and alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.dynamixel.models import models, name_of
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    from drivers.dynamixel.bus import Bus
    from drivers.dynamixel.config import DynamixelConfig
    from drivers.dynamixel.control_table import ControlTable
    from drivers.dynamixel.series import Series

RETURN_DELAY_LSB = 2e-6
"""s a count of Return Delay Time."""
_TRIES = 3


def identify(bus: Bus, table: ControlTable, config: DynamixelConfig, series: Series) -> str:
    """Check who answers, make it answer everything, and learn its return delay. Returns its firmware version.

    Raises NoReply, BadReply where several answer at once, DriverError for another model or firmware without a watchdog.
    """
    number, firmware = _first_answer(bus, config, series)
    model = models()[config.model]
    if number != model.number:
        raise DriverError(
            f"servo {config.id} on {config.port} is a {name_of(number)} (model number {number}), not the "
            f"{config.model} (model number {model.number}) of the stand file: correct dynamixel.model or dynamixel.id"
        )
    if config.watchdog and firmware < model.watchdog_firmware:
        raise DriverError(
            f"servo {config.id} has firmware {firmware}, and the bus watchdog came with {model.watchdog_firmware}: "
            "bring it up to date with DYNAMIXEL Wizard, or set dynamixel.watchdog = 0 and know that the motor stays "
            "live when this computer dies"
        )
    bus.send(series.registers["status_return_level"].address, b"\x02")
    try:
        bus.return_delay = table.get("return_delay_time") * RETURN_DELAY_LSB
        for _ in range(_TRIES):
            bus.read(*series.block)
    except BadReply as error:
        raise BadReply(_garbled(config, error)) from None
    return str(firmware)


def _first_answer(bus: Bus, config: DynamixelConfig, series: Series) -> tuple[int, int]:
    """Model number and firmware version; one reply may be lost."""
    trouble: DriverError = DriverError()
    for _ in range(_TRIES):
        try:
            return series.identity(bus)
        except (NoReply, BadReply) as error:
            trouble = error
    if isinstance(trouble, BadReply):
        raise BadReply(_garbled(config, trouble))
    raise NoReply(
        f"no servo {config.id} answers on {config.port} at {config.baudrate} baud: check its power, the cable, the id "
        "and the baud rate (a new servo has id 1 and 57600 baud), and the USB adapter's latency timer (1 ms)"
    )


def _garbled(config: DynamixelConfig, error: BadReply) -> str:
    return (
        f"what answers as servo {config.id} cannot be understood ({error}): two servos with that id, a baud rate that "
        "is off, or a bad cable; connect one servo alone and give each its own id"
    )
