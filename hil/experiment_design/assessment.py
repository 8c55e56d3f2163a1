"""Before the motor moves: what a profile would do on a stand, and what it would tell of Kc and Bc.

The stand gives the sensors and the limits, the user a rough Kc and Bc; `hil.experiment_design.response` gives the
motion and `hil.experiment_design.fisher` the errors. Nothing here drives anything.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

from drivers.servo import Quantity
from hil.acquisition.excitation import Profile
from hil.errors import WrongUse
from hil.experiment_design.fisher import TERMS, Parameter, Readings, mistaken_friction, predict
from hil.experiment_design.response import Joint, Peaks, peaks, respond
from hil.stand.file import Stand
from sim_backend.parameters import SimParameters

SLACK = ((0.8, 1.0, 1.25), (2.0 / 3.0, 1.0, 1.5))
"""Factors on the rough Kc and Bc for which the best profile keeps every limit."""

LIMITED = ("drive torque", "torque", "deflection", "velocity")
"""What the limits are on, in the order of `Peaks`: the motor's torque and the coupling's are both at the joint."""

UNITS = ("N m", "N m", "rad", "rad/s")
"""Of the limits."""

_DIGITS = 3


@dataclass(frozen=True, slots=True)
class Task:
    """What is asked: the joint as it is roughly known, its sensors, its limits, and what is to be told.

    limits: N m, N m, rad, rad/s, as `LIMITED` names them. terms: of the model. rate: Hz.
    """

    joint: Joint
    readings: Readings
    limits: tuple[float, float, float, float]
    terms: tuple[str, ...]
    quantity: Quantity
    rate: float

    @property
    def own_limit(self) -> float:
        """The limit on what is commanded: N m for torque, rad for position."""
        return min(self.limits[:2]) if self.quantity is Quantity.TORQUE else self.limits[2]

    def shares(self, found: Peaks) -> tuple[float, float, float, float]:
        """Every peak as a part of its limit."""
        drive, torque, deflection, velocity = (
            peak / limit for peak, limit in zip(found.in_order, self.limits, strict=True)
        )
        return drive, torque, deflection, velocity


@dataclass(frozen=True, slots=True)
class Assessment:
    """A profile judged.

    peaks: at the rough Kc and Bc; shares: each as a part of its limit; strained: the largest within `SLACK`.
    friction: what one N m of dry friction that the model leaves out adds to Bc, N m s/rad; 0 where it does not.
    """

    profile: Profile
    parameters: tuple[Parameter, ...]
    peaks: Peaks
    shares: tuple[float, float, float, float]
    strained: tuple[float, float, float, float]
    friction: float

    def __getitem__(self, name: str) -> Parameter:
        return next(parameter for parameter in self.parameters if parameter.name == name)

    @property
    def relative(self) -> float:
        """The larger relative standard error of Kc and Bc, which the search makes least."""
        return max(self[name].error / self[name].rough for name in ("Kc", "Bc"))

    @property
    def limited_by(self) -> str:
        """What a larger amplitude would run into first."""
        return LIMITED[self.strained.index(max(self.strained))]


def terms_of(model: str) -> tuple[str, ...]:
    """The terms of a model such as "linear+offset". Raises WrongUse for one whose errors are not predicted."""
    named = [term.strip() for term in model.split("+")]
    for term in named:
        if term not in TERMS:
            raise WrongUse(f"--model {model!r}: no error can be predicted for {term!r}; there are {', '.join(TERMS)}")
    if "linear" not in named or len(set(named)) != len(named):
        raise WrongUse(f"--model {model!r}: name linear and each further term once, as in linear+offset")
    return tuple(term for term in TERMS if term in named)


def task_of(
    stand: Stand,
    *,
    kc: float | None,
    bc: float | None,
    torque_noise: float | None,
    model: str,
    quantity: Quantity,
    rate: float,
) -> Task:
    """The task for a stand: kc N m/rad and bc N m s/rad are rough, torque_noise is in N m at the joint, rate in Hz.

    None: what `[sim]` says of the simulated coupling, and of the sensors. Raises WrongUse.
    """
    limits, simulated = stand.checked_limits(), stand.stand.backend == "sim"
    plant = _simulated(stand)
    joint = _joint(stand, plant if simulated else None, kc, bc)
    ratio = stand.stand.gear_ratio
    ceiling = min(limits.torque, plant.drive.torque_limit * ratio) if simulated else limits.torque
    task = Task(
        joint=joint,
        readings=_readings(stand, plant, torque_noise),
        limits=(ceiling, limits.torque, limits.deflection, limits.velocity),
        terms=terms_of(model),
        quantity=quantity,
        rate=rate,
    )
    reach = min(limits.deflection, limits.torque / joint.stiffness, ceiling / joint.stiffness)
    if reach < task.readings.angle_lsb:
        raise WrongUse(
            f"the limits permit no motion that can be read: at most {reach:.2g} rad, and one count is "
            f"{task.readings.angle_lsb:.2g} rad; raise limits.torque or limits.deflection in the stand file"
        )
    return task


def _simulated(stand: Stand) -> SimParameters:
    stated = stand.stand.model_dump(include=stand.stand.model_fields_set)
    return stand.sim.resolved(
        gear_ratio=stated.get("gear_ratio"),
        motor_inertia=stated.get("motor_inertia") or None,
        motor_damping=stated.get("motor_damping"),
    )


def _joint(stand: Stand, plant: SimParameters | None, kc: float | None, bc: float | None) -> Joint:
    if plant is not None:
        kc = plant.coupling.stiffness if kc is None else kc
        bc = plant.coupling.damping if bc is None else bc
    if kc is None or bc is None:
        raise WrongUse("give --kc (N m/rad) and --bc (N m s/rad), as roughly as they are known; a first run tells them")
    for name, value, unit in (("kc", kc, "N m/rad"), ("bc", bc, "N m s/rad")):
        if not (math.isfinite(value) and value > 0.0):
            raise WrongUse(f"--{name} {value:g}: a coupling has more than zero {unit}; give a rough value")
    ratio = stand.stand.gear_ratio
    inertia, friction = stand.stand.motor_inertia, stand.stand.motor_damping
    if plant is not None:
        inertia, friction = plant.motor.inertia or 0.0, plant.motor.viscous_friction or 0.0
    return Joint(kc, bc, ratio**2 * inertia, ratio**2 * friction)


def _readings(stand: Stand, plant: SimParameters, torque_noise: float | None) -> Readings:
    """[sim.sensors] describes the stand's sensors, whatever the backend."""
    sensors, ratio = plant.sensors, stand.stand.gear_ratio
    motor_side = stand.stand.torque_source == "motor"
    if motor_side:
        noise, lsb = ratio * sensors.motor_torque_noise, ratio * sensors.current_lsb * plant.motor.torque_constant
        age = sensors.motor_torque_delay
    else:
        noise, lsb = sensors.torque_cell_noise, sensors.torque_cell_lsb
        age = sensors.joint_torque_delay + 1.0 / (2.0 * math.pi * sensors.torque_cell_bandwidth)
    if torque_noise is not None:
        if not (math.isfinite(torque_noise) and torque_noise > 0.0):
            raise WrongUse(f"--torque-noise {torque_noise:g}: give its standard deviation in N m at the joint")
        noise, lsb = torque_noise, 0.0
    joint_count = 1.0 / sensors.joint_counts if sensors.joint_encoder else 0.0
    count = 2.0 * math.pi * math.hypot(1.0 / (ratio * sensors.motor_counts), joint_count)
    return Readings(noise, lsb, count, age - sensors.motor_position_delay, motor_side)


def assess(task: Task, profile: Profile) -> Assessment:
    """What `profile` would do and tell. Raises WrongUse where it moves less than the encoder can show."""
    motion, found = respond(task.joint, profile, task.rate)
    if found.deflection < task.readings.angle_lsb:
        raise WrongUse(
            f"a {profile.kind} of {profile.amplitude:g} {_unit(task.quantity)} moves the joint by "
            f"{found.deflection:.2g} rad, less than one count of {task.readings.angle_lsb:.2g} rad: raise --amplitude"
        )
    parameters = predict(task.terms, task.joint, motion, task.readings)
    friction = mistaken_friction(task.terms, task.joint, motion)
    return Assessment(profile, parameters, found, task.shares(found), strained(task, profile), friction)


def check_limits(task: Task, judged: Assessment) -> None:
    """Raise WrongUse where the profile would pass a limit, with the amplitude that would not."""
    worst = max(judged.shares)
    if worst <= 1.0 + 1e-9:
        return
    index = judged.shares.index(worst)
    peak, unit = judged.peaks.in_order[index], UNITS[index]
    profile = judged.profile
    raise WrongUse(
        f"a {profile.kind} of {profile.amplitude:g} {_unit(task.quantity)} takes the {LIMITED[index]} to {peak:.3g} "
        f"{unit}, and its limit is {task.limits[index]:g} {unit}: lower --amplitude to "
        f"{rounded(profile.amplitude / worst, down=True):g}, or change --band"
    )


def _unit(quantity: Quantity) -> str:
    return "N m" if quantity is Quantity.TORQUE else "rad"


def strained(task: Task, profile: Profile) -> tuple[float, float, float, float]:
    """The largest share of every limit that the profile takes while Kc and Bc are off by `SLACK`."""
    joints = [
        replace(task.joint, stiffness=task.joint.stiffness * stiffer, damping=task.joint.damping * thicker)
        for stiffer, thicker in itertools.product(*SLACK)
    ]
    drive, torque, deflection, velocity = (
        max(values) for values in zip(*(task.shares(found) for found in peaks(joints, profile, task.rate)), strict=True)
    )
    return drive, torque, deflection, velocity


def rounded(value: float, *, down: bool = False) -> float:
    """To three significant digits, so that what was judged is what is typed; never up where `down`."""
    unit = 10.0 ** (math.floor(math.log10(value)) + 1 - _DIGITS)
    steps = math.floor(value / unit * (1.0 + 1e-12)) if down else round(value / unit)
    return float(f"{steps * unit:.{_DIGITS}g}")
