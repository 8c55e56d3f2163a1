"""The lists of servos and joint sensors that a stand file can name. To add a device, add one line to a list.

Another package adds a servo with an entry point of group `hil.backends` whose object is a `Device`.

A line names the class of the device's table in the stand file and the function that opens the device, as "module:name".
So the device's libraries are loaded only if the device is used. A device must fulfil this contract:

* The table is a pydantic model, or a dataclass with `__pydantic_config__`, that forbids unknown keys.
* The opener of a servo takes the table alone and returns a `drivers.servo.Servo` with its torque off.
* The opener of a joint sensor takes the table and `clock=`, the clock that gives the times of its readings.
* If the mode of a device determines whether it takes torques or positions, its table has `for_quantity` (`HasMode`).
* If a device cannot do all that a stand may require of it, its table has `restrictions` (`HasRestrictions`).
* If the largest torque of a drive is known without opening it, its table has `largest_torque` (`HasLargestTorque`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Any, Protocol, Self, runtime_checkable

from drivers.clock import Clock
from drivers.servo import JointSensor, Quantity, Servo
from hil import plugins as plugins_of
from hil.errors import WrongUse, unknown
from hil.plugins import plugins


@runtime_checkable
class HasMode(Protocol):
    """The interface of a table of the stand file, such as [moteus], whose device is commanded in torque or in
    position.
    """

    def for_quantity(self, quantity: Quantity) -> Self:
        """Return the table with the mode in which the device takes `quantity`. Raises ValueError if there is no such
        mode.
        """


@runtime_checkable
class HasRestrictions(Protocol):
    """The interface of a table whose device cannot do all that a stand may require of it."""

    def restrictions(self, torque_source: str) -> list[str]:
        """Return sentences about what the device cannot do, each with the remedy. torque_source: of the stand."""


@runtime_checkable
class HasLargestTorque(Protocol):
    """The interface of a table of a drive whose largest torque, N m at the motor shaft, is known without opening it."""

    @property
    def largest_torque(self) -> float:
        """The largest torque, N m at the motor shaft."""


@dataclass(frozen=True, slots=True)
class Device:
    """A servo or joint sensor that a stand file can name.

    explanation: one line for lists. table: class of the device's table. opener: function that opens the device, "" for
    the simulated servo, which `hil.stand.opening` opens. search: function that gets the table and looks for devices on
    a link that does not answer, "" without one; it returns a sentence for each device that it finds.
    """

    explanation: str
    table: str
    opener: str
    search: str = ""

    def table_class(self) -> Any:
        """Return the class that checks the device's table in the stand file."""
        return _named(self.table)


class _Devices(Mapping[str, Device]):
    """The devices of this package and of other packages, by name. Those of other packages are loaded when they are used
    or listed.

    A device that cannot be loaded is left out of the list, and `devices[name]` raises WrongUse for it.
    """

    def __init__(self, own: Mapping[str, Device], group: str) -> None:
        self._own, self._group = own, group

    def __getitem__(self, name: str) -> Device:
        if name in self._own:
            return self._own[name]
        found: Device = plugins(self._group)[name].load(Device)
        return found

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in plugins(self._group)

    def __iter__(self) -> Iterator[str]:
        yield from self._own
        for name in plugins(self._group):
            with suppress(WrongUse):
                if name not in self._own and self[name]:
                    yield name

    def __len__(self) -> int:
        return len(list(iter(self)))


BACKENDS: Mapping[str, Device] = _Devices(
    {
        "sim": Device("the simulated servo: no hardware, virtual time", "sim_backend.parameters:SimParameters", ""),
        "dynamixel": Device(
            "DYNAMIXEL on a serial port",
            "drivers.dynamixel.config:DynamixelConfig",
            "drivers.dynamixel.servo:DynamixelServo",
            "drivers.dynamixel.identity:search",
        ),
        "odrive": Device(
            "ODrive (CANSimple)", "drivers.odrive.config:OdriveConfig", "drivers.odrive.servo:OdriveServo"
        ),
        "mit": Device(
            "CubeMars AK, Damiao: MIT frames on CAN", "drivers.mit.config:MitConfig", "drivers.mit.servo:MitServo"
        ),
        "robstride": Device(
            "RobStride RS00 to RS06, EduLite 05 (private protocol)",
            "drivers.robstride.config:RobstrideConfig",
            "drivers.robstride.servo:RobstrideServo",
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
        "feetech": Device(
            "Feetech STS, HLS and SCS on a serial port",
            "drivers.feetech.config:FeetechConfig",
            "drivers.feetech.servo:FeetechServo",
            "drivers.feetech.identity:search",
        ),
        "replay": Device(
            "a recording played back: nothing turns", "hil.stand.replay:ReplayConfig", "hil.stand.replay:ReplayServo"
        ),
    },
    plugins_of.BACKENDS,
)
"""All servos, by the name in `stand.backend`, which is also the name of their table."""

SENSORS: Mapping[str, Device] = MappingProxyType(
    {
        "loadcell": Device(
            "a torque cell on a board that prints what it reads on a serial port",
            "drivers.loadcell.config:LoadCellConfig",
            "drivers.loadcell.sensor:LoadCell",
        ),
    }
)
"""All joint sensors, by the name in `joint_sensor.kind`."""


def check_backend(name: str | None) -> str:
    """Return `name` if a backend of that name exists. Raises WrongUse otherwise."""
    if name is None:
        raise WrongUse(f"the stand file has no backend: add backend = ... to [stand]; known are {', '.join(BACKENDS)}")
    return _known("backend", name, BACKENDS)


def check_sensor(name: object) -> str:
    """Return `name` if a kind of joint sensor of that name exists. Raises WrongUse otherwise."""
    if name is None:
        raise WrongUse(f"must be given; known are {', '.join(SENSORS)}")
    return _known("joint sensor", str(name), SENSORS)


def open_backend(name: str, table: Any, quantity: Quantity) -> Servo:
    """Open the servo of backend `name` from its checked table, with its torque off.

    quantity: what the set-points command, torque or position. Raises WrongUse if the servo does not accept such
    set-points, DriverError if it cannot be opened.
    """
    if isinstance(table, HasMode):
        try:
            table = table.for_quantity(quantity)
        except ValueError as error:
            raise WrongUse(str(error)) from None
    servo: Servo = _named(BACKENDS[name].opener)(table)
    if quantity not in servo.info.quantities:
        accepted = ", ".join(sorted(servo.info.quantities))
        servo.close()
        raise WrongUse(f"backend {name!r} with this stand file accepts no {quantity}: use --mode {accepted}")
    return servo


def restrictions(table: Any, torque_source: str) -> list[str]:
    """Return sentences about what the device of a checked table cannot do, each with the remedy; [] for most devices.

    torque_source: of the stand. No device is opened.
    """
    return table.restrictions(torque_source) if isinstance(table, HasRestrictions) else []


def found_by_search(name: str, table: Any) -> list[str]:
    """Search the link of backend `name`. Return a sentence for each device that answers with other settings than those
    in the table.

    Raises DriverError if the link cannot be opened.
    """
    place = BACKENDS[name].search
    answers: list[str] = _named(place)(table) if place else []
    return answers


def open_sensor(name: str, table: Any, clock: Clock) -> JointSensor:
    """Open the joint sensor of kind `name` from its checked table. Raises DriverError."""
    sensor: JointSensor = _named(SENSORS[name].opener)(table, clock=clock)
    return sensor


def listed() -> list[tuple[str, str]]:
    """Return name and explanation of every servo and joint sensor; for a device of another package, also the package.

    For a device that cannot be loaded, the explanation is the reason.
    """
    found = [(name, device.explanation) for name, device in (*BACKENDS.items(), *SENSORS.items())]
    foreign = plugins(plugins_of.BACKENDS)
    lines = [(name, f"{text} ({foreign[name].package})" if name in foreign else text) for name, text in found]
    for name, plugin in foreign.items():
        try:
            plugin.load(Device)
        except WrongUse as error:
            lines.append((name, f"skipped: {error}"))
    return lines


def _known(what: str, name: str, known: Mapping[str, Device]) -> str:
    if name in known:
        return name
    raise unknown(what, name, known)


def _named(place: str) -> Any:
    module, name = place.split(":")
    return getattr(import_module(module), name)
