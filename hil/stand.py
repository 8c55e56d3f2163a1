"""The stand: what `stand.toml` says of the motor, the gear, the limits, and the servo that is opened from it.

People speak of the joint and a servo speaks of the motor shaft. `Stand` holds the joint's side; the recorder and
`motor_limits` do the conversion with the gear ratio.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.servo import Limits, MonotonicClock, Servo
from hil.errors import WrongUse
from sim_backend.parameters import SimParameters

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]

BACKENDS: Mapping[str, str] = {"sim": "the simulated servo: no hardware, virtual time"}


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class StandTable(_Table):
    """[stand]: what is known of the motor and its gear.

    gear_ratio: motor turns a joint turn. motor_inertia: kg m^2. motor_damping: N m s/rad, both at the motor shaft.
    torque_source: "joint" for a torque cell at the locked joint, "motor" to infer it through equation (1).
    torque_uncertainty: of the torque's scale (torque constant or cell), relative, one standard deviation.
    """

    name: str = "unnamed stand"
    backend: str | None = None
    gear_ratio: Positive = 1.0
    motor_inertia: NotNegative = 0.0
    motor_damping: NotNegative = 0.0
    torque_source: Literal["motor", "joint"] = "motor"
    torque_uncertainty: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0


class LimitsTable(_Table):
    """[limits], all at the joint: torque N m, deflection rad, velocity rad/s; temperature of the winding degC."""

    torque: Positive
    deflection: Positive
    velocity: Positive
    temperature: Positive = 70.0


class _File(_Table):
    stand: StandTable
    limits: LimitsTable | None = None
    sim: SimParameters = Field(default_factory=SimParameters)


@dataclass(frozen=True, slots=True)
class Stand:
    """A checked stand file. `text` is the file as written; `limits` is None where the file sets none."""

    stand: StandTable
    limits: LimitsTable | None
    sim: SimParameters
    text: str

    def checked_limits(self) -> LimitsTable:
        """The limits, without which nothing is driven. Raises WrongUse where the file has none."""
        if self.limits is None:
            raise WrongUse("the stand file sets no limits: add [limits] with torque, deflection and velocity")
        return self.limits

    def motor_limits(self, zero: float) -> Limits:
        """The limits at the motor shaft, for a joint at rest at motor position `zero` rad."""
        limits, ratio = self.checked_limits(), self.stand.gear_ratio
        reach = limits.deflection * ratio
        return Limits(
            torque=limits.torque / ratio,
            velocity=limits.velocity * ratio,
            temperature=limits.temperature,
            position=(zero - reach, zero + reach),
        )


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
"""The stand that `--backend sim` means. What is not here is the simulator's own default."""


def load(path: Path) -> Stand:
    """The stand in a TOML file. Raises WrongUse with every problem of the file at once, each with its key."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise WrongUse(f"{path}: the stand file cannot be read ({error})") from None
    return parse(text, str(path))


def parse(text: str, name: str = "stand.toml") -> Stand:
    """The stand in `text`. Raises WrongUse with every problem at once, each with its key."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise WrongUse(f"{name} is not TOML: {error}") from None
    try:
        file = _File.model_validate(table)
    except ValidationError as error:
        problems = "\n".join(f"  {_problem(item)}" for item in error.errors())
        raise WrongUse(f"{name} has {error.error_count()} problem(s):\n{problems}") from None
    return Stand(file.stand, file.limits, file.sim, text)


def _problem(item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"])
    if item["type"] in {"extra_forbidden", "unexpected_keyword_argument"}:
        return f"{key}: no such key"
    if item["type"] == "missing":
        return f"{key}: must be given"
    return f"{key} = {item['input']!r}: {item['msg']}"


def check_backend(name: str | None) -> str:
    """The backend's name, known to exist. Raises WrongUse."""
    if name in BACKENDS:
        return str(name)
    known = ", ".join(BACKENDS)
    if name is None:
        raise WrongUse(f"the stand file names no backend: add backend = ... to [stand]; known are {known}")
    near = get_close_matches(name, BACKENDS, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise WrongUse(f"unknown backend {name!r}: {hint}known are {known}")


def open_servo(stand: Stand, *, seed: int, realtime: bool) -> tuple[Servo, Mapping[str, float]]:
    """The stand's servo, closed by whoever asked for it, and the truth where it is simulated ({} otherwise).

    seed: of everything random in a simulated servo. realtime: simulate in wall time. Raises WrongUse, DriverError.
    """
    check_backend(stand.stand.backend)
    from sim_backend.servo import SimServo, VirtualClock

    stated = stand.stand.model_dump(include=stand.stand.model_fields_set)
    parameters = stand.sim.resolved(
        gear_ratio=stated.get("gear_ratio"),
        motor_inertia=stated.get("motor_inertia") or None,
        motor_damping=stated.get("motor_damping"),
    )
    servo = SimServo(parameters, seed=seed, clock=MonotonicClock() if realtime else VirtualClock())
    return servo, servo.truth()
