"""Stiffness and damping matrices of fingers, from Kc and Bc of each motor and the routing of the tendons.

With all joints locked, a motor stretches only its own tendon, so Kc and Bc of one motor are single numbers. Both
matrices follow from the routing R, with one row for each motor and one column for each joint: K = R' diag(Kc) R and
B = R' diag(Bc) R.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from hil.errors import WrongUse, meant
from hil.recording.input import read_text

Array = NDArray[np.float64]

UNITS = {"stiffness": "N*m/rad", "damping": "N*m*s/rad"}
"""The units of the two matrices and of the motors' values."""

FILE = "hand.json"
"""The name of the file with the results of a hand, in their folder."""

_LARGEST = 1 << 26  # bytes of that file
_NORMAL = 1.959964  # half a 95 % interval in standard errors
_MOST_MOTORS = 200
_STRICT: dict[str, object] = {"extra": "forbid", "allow_inf_nan": False}


@dataclass(frozen=True, slots=True)
class Value:
    """A value, SI, with the standard error that it has if the torque's scale is exact."""

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    value: float
    error: Annotated[float, Ge(0)] = 0.0

    def ci95(self, scale: float) -> tuple[float, float]:
        """Return the 95 % interval of a value that is not negative. scale: relative standard uncertainty of the
        torque's scale.
        """
        half = _NORMAL * math.hypot(self.error, scale * self.value)
        return max(self.value - half, 0.0), self.value + half


@dataclass(frozen=True, slots=True)
class Motor:
    """One motor with its tendon, identified while all joints were locked.

    joint: the joint that it turns; several motors may turn one joint. stiffness, damping: Kc and Bc, N m/rad and N m
    s/rad at that joint, None if not known; friction: dry friction, N m. turns: turns of each further joint for one turn
    of `joint`, signed; turns_uncertainty: relative standard uncertainty of each of these. torque_uncertainty: relative
    standard uncertainty of the torque's scale; drive: kind of the drive. inertia, motor_damping: of the motor, at
    `joint`, kg m^2 and N m s/rad. further: terms of the identified model beside these.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = _STRICT

    name: str
    joint: str
    stiffness: Value | None
    damping: Value | None
    friction: Value = Value(0.0)
    turns: Mapping[str, float] = field(default_factory=dict)
    turns_uncertainty: float = 0.0
    torque_uncertainty: float = 0.0
    drive: str = ""
    inertia: float = 0.0
    motor_damping: float = 0.0
    further: tuple[str, ...] = ()

    @property
    def known(self) -> bool:
        """Whether both Kc and Bc are known."""
        return self.stiffness is not None and self.damping is not None

    @property
    def row(self) -> dict[str, float]:
        """This motor's row of the routing: turns of each joint for one turn of `joint`."""
        return {self.joint: 1.0, **self.turns}


@dataclass(frozen=True, slots=True)
class JointMatrix:
    """A symmetric matrix with a row and a column for each of `joints`, SI: `matrix["index_mcp", "index_pip"]`.

    values (n, n): NaN where a motor's value is not known. ci95 (n, n, 2): the 95 % intervals.
    """

    joints: tuple[str, ...]
    unit: str
    values: Array
    ci95: Array

    def __getitem__(self, names: tuple[str, str]) -> float:
        row, column = (self._number(name) for name in names)
        return float(self.values[row, column])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.values, dtype=dtype, copy=copy)

    def _number(self, joint: str) -> int:
        if joint not in self.joints:
            raise KeyError(f"no joint {joint!r}: {meant(joint, self.joints)}the joints are {', '.join(self.joints)}")
        return self.joints.index(joint)

    def as_json(self) -> dict[str, Any]:
        """Return values and intervals as lists; an unknown entry is null."""
        return {"unit": self.unit, "values": _lists(self.values), "ci95": _lists(self.ci95)}


@dataclass(frozen=True, slots=True)
class Finger:
    """Motors and joints that a routing connects, with their matrices.

    covariance (2 n^2, 2 n^2): of all entries of stiffness, row by row, then of damping, SI; the part of an unknown
    entry is NaN.
    """

    motors: tuple[Motor, ...]
    stiffness: JointMatrix
    damping: JointMatrix
    covariance: Array

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the joints, in the order of rows and columns."""
        return self.stiffness.joints

    def as_json(self) -> dict[str, Any]:
        """Return the finger as a JSON object: joints, motors, routing and both matrices, SI."""
        return {
            "joints": list(self.joints),
            "motors": [motor.name for motor in self.motors],
            "routing": routing(self.motors, self.joints).tolist(),
            "stiffness": self.stiffness.as_json(),
            "damping": self.damping.as_json(),
        }


def routing(motors: Sequence[Motor], joints: Sequence[str]) -> Array:
    """Return the routing R (m, n): turns of each joint for one turn of the joint that the motor turns."""
    return np.array([[motor.row.get(joint, 0.0) for joint in joints] for motor in motors])


def finger(motors: Sequence[Motor]) -> Finger:
    """Return the matrices of motors and of all joints that they move.

    An interval holds the sampling errors of Kc and Bc, which are independent; the error of the torque's scale, which
    all motors with one kind of drive have in common; and the errors of the turns, which are independent of each other
    and the same in both matrices. All enter to first order.
    """
    joints = tuple(dict.fromkeys([motor.joint for motor in motors] + [name for one in motors for name in one.row]))
    rows = routing(motors, joints)
    values = np.array([[math.nan if part is None else part.value for part in _parts(motor)] for motor in motors]).T
    known = np.nan_to_num(values)
    changes = np.array(list(_changes(motors, joints, known))).reshape(-1, 2 * len(joints) ** 2)
    covariance = changes.T @ changes
    entries = np.array([rows.T @ (each[:, None] * rows) for each in known]).ravel()
    touched = [np.abs(rows).T @ (np.isnan(each)[:, None] * np.abs(rows)) > 0.0 for each in values]
    unknown = np.array(touched).ravel()
    entries[unknown], covariance[unknown], covariance[:, unknown] = math.nan, math.nan, math.nan
    half = _NORMAL * np.sqrt(np.diag(covariance))
    ends = np.stack([entries - half, entries + half], axis=-1)
    size = (len(joints), len(joints))
    pairs = zip(UNITS.values(), entries.reshape(2, *size), ends.reshape(2, *size, 2), strict=True)
    stiffness, damping = (JointMatrix(joints, *parts) for parts in pairs)
    return Finger(tuple(motors), stiffness, damping, covariance)


def fingers(motors: Sequence[Motor]) -> list[Finger]:
    """Return the fingers: groups of motors and joints without a tendon between two groups, in the motors' order."""
    groups: list[tuple[set[str], list[Motor]]] = []
    for motor in motors:
        joined = [group for group in groups if not group[0].isdisjoint(motor.row)]
        apart = [group for group in groups if group not in joined]
        members = [one for _, group in joined for one in group]
        groups = [*apart, (set(motor.row).union(*(names for names, _ in joined)), [*members, motor])]
    place = {motor.name: number for number, motor in enumerate(motors)}
    ordered = [sorted(group, key=lambda motor: place[motor.name]) for _, group in groups]
    return [finger(group) for group in sorted(ordered, key=lambda group: place[group[0].name])]


def _parts(motor: Motor) -> tuple[Value | None, Value | None]:
    return motor.stiffness, motor.damping


def _changes(motors: Sequence[Motor], joints: Sequence[str], known: Array) -> Iterator[Array]:
    """Yield what one standard error of each independent source changes in both matrices, (2, n, n)."""
    rows = routing(motors, joints)
    products = np.einsum("mi,mj->mij", rows, rows)
    for kind in range(2):
        for motor, product in zip(motors, products, strict=True):
            value = _parts(motor)[kind]
            change = np.zeros((2, *product.shape))
            change[kind] = product * (0.0 if value is None else value.error)
            yield change
    for drive in dict.fromkeys(motor.drive for motor in motors):
        scales = np.array([motor.torque_uncertainty * (motor.drive == drive) for motor in motors])
        yield np.einsum("km,m,mij->kij", known, scales, products)
    for number, motor in enumerate(motors):
        for joint, turns in motor.turns.items():
            step = np.zeros(rows.shape[1])
            step[joints.index(joint)] = motor.turns_uncertainty * turns
            pair = np.outer(step, rows[number])
            yield known[:, number, None, None] * (pair + pair.T)


def as_json(motors: Sequence[Motor]) -> list[dict[str, Any]]:
    """Return the motors as a JSON list, from which `read` makes them again."""
    return [asdict(motor) for motor in motors]


def read(folder: Path) -> tuple[Motor, ...]:
    """Return the motors in the folder of results of a hand. Raises WrongUse if it has no such results."""
    path = folder / FILE
    try:
        motors = TypeAdapter(tuple[Motor, ...]).validate_python(json.loads(read_text(path, largest=_LARGEST))["motors"])
    except (ValidationError, ValueError, KeyError, TypeError, RecursionError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else None
        why = f" ({'.'.join(str(part) for part in first['loc'])}: {first['msg']})" if first else ""
        raise WrongUse(f"{path} holds no motors of a hand{why}: write it again with hil hand") from None
    if not 0 < len(motors) <= _MOST_MOTORS:
        raise WrongUse(f"{path} holds {len(motors)} motors; a hand has 1 to {_MOST_MOTORS}")
    return motors


def _lists(numbers: Array) -> Any:
    """Return nested lists with None for what is not finite."""
    plain = numbers.astype(object)
    plain[~np.isfinite(numbers)] = None
    return plain.tolist()
