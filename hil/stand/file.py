"""The stand file, stand.toml: its tables and how it is read and checked. No device is opened here.

Angles and torques of `Stand` are at the joint; `hil.stand.transmission` converts them to the motor shaft.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Unit
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, create_model

from hil.diagnostics import Diagnostic
from hil.errors import WrongUse, meant
from hil.quantities import Place, Usual, in_si, keys_of
from hil.recording.channels import TorqueScale
from hil.recording.input import read_text
from hil.stand.calibration import CalibrationTable
from hil.stand.devices import BACKENDS, SENSORS, HasLargestTorque, check_sensor
from hil.stand.sentences import NO_SUCH_KEY, names_the_value, sentence
from hil.stand.toml_table import LISTED, errors_in, line_of, parsed
from hil.stand.winding import WindingTable
from sim_backend.parameters import SimParameters

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
LARGEST = 1 << 20
"""The largest allowed size of a stand file, bytes."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
Ident = Annotated[int, Field(ge=0, le=0x7FF)]


_LARGEST_VALUE, _SMALLEST_VALUE = 1e15, 1e-15
"""The range of the magnitude of a number in a stand file, in SI: no stand has such a value, and no product of a few of
them overflows.
"""

_BEYOND = 20.0  # times what the drive can apply: no limit can be meant to lie there
_SLOWEST = 30.0  # rad/s^2: the drive's largest torque divided by the motor's inertia is 600 to 25,000 in known motors

Error = tuple[Place, str]
"""The keys of a wrong value, and a sentence about it."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class StandTable(_Table):
    """[stand]: the motor and its gear.

    gear_ratio: motor turns for one joint turn. motor_inertia: kg m^2, at the motor shaft. motor_damping: N m s/rad, at
    the motor shaft. torque_source: "joint" for a torque cell at the locked joint, "motor" to compute the torque from
    the motor's torque through equation (1). torque_uncertainty: relative standard uncertainty of the torque's scale
    (torque constant or cell); not set: what the drive states for its motor's torque. zero: the angle, rad, that the
    drive shows where the stand's motor angle is zero. torque_stays_on_if_host_dies: true accepts a drive that keeps its
    last torque when this computer stops; without it such a drive is not driven. holding_ids: the ids of other drives on
    the drive's bus that may hold torque, such as the motor that locks the joint. hand_ids: the ids of all drives of a
    hand by the names of their joints: their torque is switched off together.
    """

    name: str = "unnamed stand"
    backend: str | None = None
    gear_ratio: Annotated[float, Field(ge=1e-3, le=1e5)] = 1.0
    motor_inertia: Annotated[NotNegative, Unit("kg*m^2"), Usual(0.01, ("g*cm^2",))] = 0.0
    motor_damping: Annotated[NotNegative, Unit("N*m*s/rad")] = 0.0
    torque_source: Literal["motor", "joint"] = "motor"
    torque_uncertainty: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    zero: Annotated[Finite, Unit("rad")] = 0.0
    torque_stays_on_if_host_dies: bool = False
    holding_ids: list[Ident] = []
    hand_ids: dict[str, Ident] = {}


class LimitsTable(_Table):
    """[limits]: the largest torque, N m, deflection, rad, and velocity, rad/s, at the joint; the highest temperature of
    the winding, degC.

    A value may be a text with its unit: deflection = "60 deg".
    """

    torque: Annotated[Positive, Unit("N*m"), Usual(200.0, ("mN*m",))]
    deflection: Annotated[Positive, Unit("rad"), Usual(math.pi, ("deg", "mrad"))]
    velocity: Annotated[Positive, Unit("rad/s"), Usual(1000.0, ("deg/s",))]
    temperature: Annotated[Positive, Unit("degC"), Usual(200.0, ("K",))] = 70.0


class File(_Table):
    """The tables of a stand file that do not depend on the device. keeps_torque: written by `hil doctor --commission`:
    whether a drive kept its torque when no command arrived, by the drive's name in `hil.acquisition.commissioning`.
    """

    stand: StandTable
    limits: LimitsTable | None = None
    calibration: CalibrationTable = CalibrationTable()
    winding: WindingTable | None = None
    keeps_torque: dict[str, bool] = {}


@dataclass(frozen=True, slots=True)
class Stand:
    """A checked stand file.

    stand, limits: the tables; limits is None if the file sets none. devices: the tables of the servos in the file, by
    backend. sensor: kind and table of the joint sensor, None without a joint sensor. text: the file as written.
    calibration: the table that `hil calibrate` wrote. winding: None if the file has no [winding]. keeps_torque: whether
    each drive, by name, kept its torque in a test. path: of the file, None if the stand was not read from a file.
    joint: the name of the joint if that file describes a hand, "" if it describes this stand only. yields: in a
    simulated hand, for 1 N m in this coupling: rad by which this locked joint yields and each other motor turns.
    """

    stand: StandTable
    limits: LimitsTable | None
    devices: Mapping[str, Any]
    sensor: tuple[str, Any] | None
    text: str
    calibration: CalibrationTable = field(default_factory=CalibrationTable)
    winding: WindingTable | None = None
    keeps_torque: Mapping[str, bool] = field(default_factory=dict)
    path: Path | None = None
    joint: str = ""
    yields: Mapping[str, float] = field(default_factory=dict)

    @property
    def sim(self) -> SimParameters:
        """The table [sim]; its default if the file has no such table."""
        parameters: SimParameters = self.devices.get("sim") or SimParameters()
        return parameters

    def torque_scale(self, recorded: TorqueScale) -> TorqueScale:
        """Return how well the torque's scale is known. recorded: what the drive stated, which holds if [stand] has no
        `torque_uncertainty`.
        """
        if "torque_uncertainty" not in self.stand.model_fields_set:
            return recorded
        return TorqueScale(self.stand.torque_uncertainty, "torque_uncertainty of the stand file")

    def simulated(self) -> SimParameters:
        """Return the parameters of [sim]. What [sim.motor] does not set is taken from [stand].

        Inertia and damping are taken if the file states them; the gear ratio always, because the recorder uses it. In a
        hand, the lock is as stiff as those of all joints that the tendon passes, with the palm.
        """
        stated = self.stand.model_dump(include=self.stand.model_fields_set)
        lock = self.sim.fixture
        stiffness = 1.0 / self.yields.get(self.joint, 1.0 / lock.stiffness)
        lock = replace(lock, stiffness=stiffness, damping=lock.damping * stiffness / lock.stiffness)
        return replace(self.sim, fixture=lock).resolved(
            gear_ratio=self.stand.gear_ratio,
            motor_inertia=stated.get("motor_inertia") or None,
            motor_damping=stated.get("motor_damping"),
        )

    def simulated_neighbours(self) -> dict[str, float]:
        """Return by the name of each other motor of a simulated hand its turns for one turn of this locked joint."""
        return {name: turn / self.yields[self.joint] for name, turn in self.yields.items() if name != self.joint}

    def named_files(self) -> list[Path]:
        """Return the files that the devices' tables name, such as a recording to replay: no output may replace these
        files.
        """
        tables = [*self.devices.values(), *([] if self.sensor is None else [self.sensor[1]])]
        values = [value for table in tables for value in TypeAdapter(type(table)).dump_python(table).values()]
        return [Path(value) for value in values if isinstance(value, str) and _is_file(value)]

    def calibration_diagnostics(self, at: datetime) -> list[Diagnostic]:
        """Return a warning for each calibration that was old at the time `at`, or whose result is not used in the stand
        file any more.
        """
        found, torque = self.calibration.old(at), self.calibration.torque
        used = None if self.sensor is None else getattr(self.sensor[1], "scale", None)
        if torque is not None and used != torque.scale:
            found.append(
                Diagnostic(
                    "calibration-changed",
                    f"joint_sensor.scale = {used} is not the calibrated {torque.scale:g} of {torque.date:%Y-%m-%d}: Kc "
                    "and Bc are computed with joint_sensor.scale; repeat hil calibrate torque, or correct the scale",
                )
            )
        return found

    def checked_limits(self) -> LimitsTable:
        """Return the limits. Raises WrongUse if the file has none: without limits nothing is driven."""
        if self.limits is None:
            raise WrongUse("the stand file sets no limits: add [limits] with torque, deflection and velocity")
        return self.limits


SIMULATED = """\
[stand]
name = "simulated index finger, the paper's joint"
backend = "sim"
gear_ratio = 4.0
motor_inertia = 2.0e-7
motor_damping = 1.0e-7
torque_source = "joint"

[limits]
torque = 0.03
deflection = 1.0
velocity = 100.0
temperature = 80.0
"""
"""The stand file for `--backend sim`. All other keys have the simulator's defaults."""


def _is_file(name: str) -> bool:
    try:
        return Path(name).is_file()
    except (OSError, ValueError):  # too long, or with a null character: no name of a file
        return False


def load(path: Path) -> Stand:
    """Return the stand in a TOML file. Raises WrongUse with all errors of the file, each with its key."""
    text = read_text(path, largest=LARGEST)
    return replace(checked(parse(text, str(path)), str(path)), path=path)


def checked(stand: Stand, name: str) -> Stand:
    """Return `stand`. Raises WrongUse for a torque limit or inertia without a unit that no one means with this drive.

    name: of the file. The stand file in a recording is not checked, because its run is over.
    """
    wrong = implausible(stand)
    if wrong:
        raise errors_in(name, [numbered(stand.text, *one) for one in wrong], len(wrong))
    return stand


def implausible(stand: Stand) -> list[Error]:
    """Return an error for a torque limit or inertia without a unit that no one means with the stand's drive."""
    drive = stand.devices.get(str(stand.stand.backend), stand.sim if stand.stand.backend == "sim" else None)
    largest = drive.largest_torque if isinstance(drive, HasLargestTorque) else math.inf
    table, wrong = parsed(stand.text, "the stand file"), list[Error]()
    limit, inertia = table.get("limits", {}).get("torque"), table["stand"].get("motor_inertia", "")
    at_joint = largest * stand.stand.gear_ratio
    if isinstance(limit, int | float) and limit > _BEYOND * at_joint:
        said = (
            f"{limit:g} would be {limit:g} N m, {limit / at_joint:.0f} times the {at_joint:.3g} N m that the drive can "
            f'apply at the joint: write "{limit:g} mN*m", or "{limit:g} N*m" if it is that'
        )
        wrong.append((("limits", "torque"), f"limits.torque: {said}"))
    if isinstance(inertia, int | float) and largest < _SLOWEST * inertia:
        said = (
            f"{inertia:g} would be {inertia:g} kg m^2, which the drive's {largest:.3g} N m accelerate by "
            f'{largest / inertia:.2g} rad/s^2 only: write it with its unit, such as "20 g*cm^2"'
        )
        wrong.append((("stand", "motor_inertia"), f"stand.motor_inertia: {said}"))
    return wrong


def numbered(text: str, place: Place, said: str) -> str:
    """Return a sentence about the key at `place` of a TOML text, with the line of the key."""
    return f"line {line_of(text, list(place))}: {said}"


def parse(text: str, name: str = "stand.toml") -> Stand:
    """Return the stand in `text`. Raises WrongUse with all errors, each with its key. name: of the file, for
    messages.
    """
    try:
        return _parsed(text, name)
    except RecursionError:
        raise WrongUse(f"{name} is nested too deeply: a stand file has tables of plain values") from None


def _parsed(text: str, name: str) -> Stand:
    table = parsed(text, name)
    if joints := joints_in(table):
        raise WrongUse(f"{name} is the file of a hand: choose a joint with --joint NAME: {', '.join(joints)}")
    stand, errors = examined(table, text)
    if stand is None:
        lines = sorted((line_of(text, list(place)), said) for place, said in errors[:LISTED])
        raise errors_in(name, [f"line {at}: {said}" for at, said in lines], len(errors))
    return stand


def joints_in(table: Mapping[str, Any]) -> list[str]:
    """Return the names of the joints in the table of a TOML file that describes a hand, [] for any other file."""
    listed = table.get("joint")
    joints = listed if isinstance(listed, list) else []
    is_plan = "campaign" in table or "profile" in table
    if not ("hand" in table or joints) or is_plan:
        return []
    return [str(one.get("name", "?")) if isinstance(one, dict) else "?" for one in joints] or ["no joint at all"]


def examined(table: dict[str, Any], text: str) -> tuple[Stand | None, list[Error]]:
    """Return the stand in the table of a TOML text, None if it has errors, and the errors.

    The key `kind` is removed from the [joint_sensor] of `table`.
    """
    kind, errors = _sensor_kind(table)
    model = _file_model(frozenset(name for name in table if name in BACKENDS), kind)
    file, wrong = validated(table, model)
    if errors := [*errors, *wrong]:
        return None, errors
    devices = {backend: getattr(file, backend) for backend in table if backend in BACKENDS}
    sensor = None if kind is None else (kind, file.joint_sensor)
    return Stand(file.stand, file.limits, devices, sensor, text, file.calibration, file.winding, file.keeps_torque), []


def validated(table: Mapping[str, Any], model: type[BaseModel]) -> tuple[Any, list[Error]]:
    """Return a table of a TOML file as `model`, with its values in SI, and the errors in it; None if there are any."""
    values, units = in_si(table, model)
    wrong: list[Error] = [(place, f"{_key(place)}: {said}") for place, said in units.items()]
    if beyond := list(_beyond(values)):  # no model's own check has to expect such a number
        return None, wrong + beyond
    try:
        return model.model_validate(values), wrong
    except ValidationError as error:
        items = [item for item in error.errors() if item["loc"] not in units]
        return None, wrong + [(item["loc"], _message(item, model)) for item in items]


def _beyond(value: Any, place: Place = ()) -> Iterator[Error]:
    """Yield an error for each finite number in a table that is out of the range of `_LARGEST_VALUE`."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _beyond(inner, (*place, key))
    elif isinstance(value, int | float) and value:
        size = abs(value)
        if _LARGEST_VALUE < size < math.inf or size < _SMALLEST_VALUE:
            yield (
                place,
                f"{_key(place)} = {reprlib.repr(value)}: must be 0, or between {_SMALLEST_VALUE:g} and "
                f"{_LARGEST_VALUE:g} in SI units",
            )


def _sensor_kind(table: dict[str, Any]) -> tuple[str | None, list[Error]]:
    """Remove the key `kind` from [joint_sensor] and return it, and the errors in it. The remaining keys are defined by
    the sensor.
    """
    sensor = table.get("joint_sensor")
    if not isinstance(sensor, dict):
        return None, []
    try:
        return check_sensor(sensor.pop("kind", None)), []
    except WrongUse as error:
        del table["joint_sensor"]
        return None, [(("joint_sensor", "kind"), f"joint_sensor.kind: {error}")]


@lru_cache(maxsize=64)
def _file_model(backends: frozenset[str], sensor: str | None) -> type[File]:
    """Return the model of a stand file with the tables of these devices; the code of other devices is not loaded."""
    tables: dict[str, Any] = {name: (BACKENDS[name].table_class(), ...) for name in sorted(backends)}
    if sensor is not None:
        tables["joint_sensor"] = (SENSORS[sensor].table_class(), ...)
    return create_model("_FileOfStand", __base__=File, **tables)


def _message(item: Any, model: type[BaseModel]) -> str:
    value = f" = {reprlib.repr(item['input'])}" if names_the_value(item) else ""
    hint = ""
    if item["type"] in NO_SUCH_KEY:
        *above, name = (str(part) for part in item["loc"])
        near = meant(name, keys_of(model, above)).strip()
        hint = f"; {near}" if near else ""
    return f"{_key(item['loc'])}{value}: {sentence(item)}{hint}"


def _key(place: Place) -> str:
    return ".".join(str(part) for part in place)
