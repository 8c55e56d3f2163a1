"""What can turn a motor, and what can be read at the joint: one line each, from which all else follows.

A line names the class of the device's own table in the stand file and what opens a device from it, as "module:name", so
that a device's SDK is loaded only where that device is used. The contract behind a line:

* The table is a pydantic model, or a dataclass with `__pydantic_config__`, that forbids unknown keys.
* The opener of a servo takes the table alone and returns a `drivers.servo.Servo` with its torque off.
* The opener of a joint sensor takes the table and `clock=`, whose time its readings carry.
* A device whose mode decides what it can be commanded has a table with `for_quantity` (`HasMode`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from types import MappingProxyType
from typing import Any, Protocol, Self, runtime_checkable

from drivers.clock import Clock
from drivers.servo import JointSensor, Quantity, Servo
from hil.errors import WrongUse


@runtime_checkable
class HasMode(Protocol):
    """A table of a device that takes either torques or positions."""

    def for_quantity(self, quantity: Quantity) -> Self:
        """The same table with the mode that commands `quantity`. Raises ValueError where there is none."""
        ...


@dataclass(frozen=True, slots=True)
class Device:
    """A line: what a person is told of it, where its table's class is, and where what opens it is ("": see below).

    search: where what looks for devices on a silent link is, "" where nothing does; it takes the table and returns a
    sentence for each device it finds.
    """

    explanation: str
    table: str
    opener: str
    search: str = ""

    def table_class(self) -> Any:
        """The class that its table in the stand file is checked with."""
        return _named(self.table)


BACKENDS: Mapping[str, Device] = MappingProxyType(
    {
        # the simulator also needs the stand's motor, so `hil.stand.file` opens it itself
        "sim": Device("the simulated servo: no hardware, virtual time", "sim_backend.parameters:SimParameters", ""),
        "dynamixel": Device(
            "DYNAMIXEL on a serial port",
            "drivers.dynamixel.config:DynamixelConfig",
            "drivers.dynamixel.servo:DynamixelServo",
            "drivers.dynamixel.scan:search",
        ),
        "odrive": Device(
            "ODrive (CANSimple)", "drivers.odrive.config:OdriveConfig", "drivers.odrive.servo:OdriveServo"
        ),
        "mit": Device(
            "CubeMars AK, Damiao: MIT frames on CAN", "drivers.mit.config:MitConfig", "drivers.mit.servo:MitServo"
        ),
        "moteus": Device("moteus on CAN FD", "drivers.moteus.config:MoteusConfig", "drivers.moteus.servo:MoteusServo"),
        "cia402": Device(
            "CiA 402 drives on CANopen: EPOS4, EPOS2, others",
            "drivers.cia402.config:Cia402Config",
            "drivers.cia402.servo:Cia402Servo",
            "drivers.cia402.scan:search",
        ),
        "commander": Device(
            "a SimpleFOC board that speaks Commander on a serial port",
            "drivers.commander.config:CommanderConfig",
            "drivers.commander.servo:CommanderServo",
        ),
        "replay": Device(
            "a recording played back: nothing turns", "hil.stand.replay:ReplayConfig", "hil.stand.replay:ReplayServo"
        ),
    }
)
"""The servos, by the name that `stand.backend` and their table have."""

SENSORS: Mapping[str, Device] = MappingProxyType(
    {
        "loadcell": Device(
            "a torque cell on a board that prints what it reads on a serial port",
            "drivers.loadcell.config:LoadCellConfig",
            "drivers.loadcell.sensor:LoadCell",
        ),
    }
)
"""The joint sensors, by the name that `joint_sensor.kind` has."""


def check_backend(name: str | None) -> str:
    """The backend's name, known to exist. Raises WrongUse."""
    known = ", ".join(BACKENDS)
    if name is None:
        raise WrongUse(f"the stand file names no backend: add backend = ... to [stand]; known are {known}")
    if name not in BACKENDS:
        raise WrongUse(f"unknown backend {name!r}: {_hint(name, BACKENDS)}known are {known}")
    return name


def check_sensor(name: object) -> str:
    """The joint sensor's kind, known to exist. Raises WrongUse."""
    known = ", ".join(SENSORS) or "none in this release"
    if name is None:
        raise WrongUse(f"must be given; known are {known}")
    if not isinstance(name, str) or name not in SENSORS:
        raise WrongUse(f"unknown joint sensor {name!r}: {_hint(str(name), SENSORS)}known are {known}")
    return name


def open_backend(name: str, table: Any, quantity: Quantity) -> Servo:
    """The servo of backend `name`, opened from its checked table, with its torque off.

    Raises WrongUse where it cannot be commanded `quantity`, DriverError where it cannot be opened.
    """
    if isinstance(table, HasMode):
        try:
            table = table.for_quantity(quantity)
        except ValueError as error:
            raise WrongUse(str(error)) from None
    servo: Servo = _named(BACKENDS[name].opener)(table)
    if quantity not in servo.info.quantities:
        takes = ", ".join(sorted(servo.info.quantities))
        servo.close()
        raise WrongUse(f"backend {name!r} as the stand file sets it takes no {quantity}: use --mode {takes}")
    return servo


def found_by_search(name: str, table: Any) -> list[str]:
    """A sentence for each device of backend `name` that answers in some other way than the table says.

    Raises DriverError where the link cannot be opened.
    """
    place = BACKENDS[name].search
    found: list[str] = _named(place)(table) if place else []
    return found


def open_sensor(name: str, table: Any, clock: Clock) -> JointSensor:
    """The joint sensor of kind `name`, opened from its checked table. Raises DriverError where it cannot be."""
    sensor: JointSensor = _named(SENSORS[name].opener)(table, clock=clock)
    return sensor


def _hint(name: str, known: Mapping[str, Device]) -> str:
    near = get_close_matches(name, known, n=1)
    return f"did you mean {near[0]!r}? " if near else ""


def _named(place: str) -> Any:
    module, name = place.split(":")
    return getattr(import_module(module), name)
