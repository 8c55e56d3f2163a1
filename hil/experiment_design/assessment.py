"""Assess an excitation on a stand before the motor moves: predicted motion, peaks, and errors of Kc and Bc.

The stand file gives the sensors and the limits, the user gives rough values of Kc and Bc.
`hil.experiment_design.response` predicts the motion and `hil.experiment_design.fisher` the errors. No motor is driven.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

from drivers.servo import Quantity
from ga.model.terms import CONSIDERED, of_role
from hil.acquisition.excitation import Profile
from hil.errors import WrongUse
from hil.experiment_design.fisher import TERMS, Prediction, Readings, mistaken_friction, predict
from hil.experiment_design.response import Joint, Peaks, peaks, respond
from hil.identification.verdict.criteria import friction_likeness
from hil.stand.file import Stand
from sim_backend.parameters import SimParameters

ROUGH_RANGE = ((0.8, 1.0, 1.25), (2.0 / 3.0, 1.0, 1.5))
"""The range of factors on the rough Kc and Bc within which the best excitation must keep every limit."""

LIMITED = ("drive torque", "torque", "deflection", "velocity")
"""The names of the limited quantities, in the order of `Peaks`. The motor's torque and the coupling's torque are both
at the joint.
"""

UNITS = ("N m", "N m", "rad", "rad/s")
"""The units of the limited quantities, in the same order."""

AUTO = tuple(term for term in TERMS if term in {*of_role("coupling"), *CONSIDERED})
"""The terms of model "auto": the common terms of model selection, whose errors can be predicted.

More terms never lower an error, so the errors of any model selected from these terms are at most those predicted here.
"""

_DIGITS = 3


@dataclass(frozen=True, slots=True)
class Task:
    """The task of an experiment design: a roughly known joint, its sensors, its limits, and the parameters to estimate.

    joint: rough Kc and Bc. readings: errors of the sensors. limits: largest allowed values. terms: of the model. mode:
    what is commanded, torque or position. rate: sampling rate, Hz.
    """

    joint: Joint
    readings: Readings
    limits: Peaks
    terms: tuple[str, ...]
    mode: Quantity
    rate: float

    @property
    def model(self) -> str:
        """The names of the terms joined with +, as --model takes them."""
        return "+".join(self.terms)

    @property
    def own_limit(self) -> float:
        """The limit on the commanded quantity: torque, N m, or position, rad."""
        return min(self.limits[:2]) if self.mode is Quantity.TORQUE else self.limits[2]

    def shares(self, found: Peaks) -> Peaks:
        """Return each of the peaks `found` divided by its limit."""
        return Peaks(*(peak / limit for peak, limit in zip(found, self.limits, strict=True)))


@dataclass(frozen=True, slots=True)
class Assessment:
    """An excitation with its predicted peaks and errors.

    parameters: predicted errors. peaks: largest values at the rough Kc and Bc. shares: peaks divided by their limits.
    worst_shares: the largest shares for Kc and Bc within `ROUGH_RANGE`. friction: bias of Bc, N m s/rad, for each N m
    of dry friction that the model omits; 0 if the model has friction. friction_likeness: the fraction of the damping
    torque that such friction would explain.
    """

    profile: Profile
    parameters: tuple[Prediction, ...]
    peaks: Peaks
    shares: Peaks
    worst_shares: Peaks
    friction: float
    friction_likeness: float

    def __getitem__(self, name: str) -> Prediction:
        return next(parameter for parameter in self.parameters if parameter.name == name)

    @property
    def relative(self) -> float:
        """The relative root mean square error of Kc or Bc, whichever is larger, with the bias. The search minimises
        this number.
        """
        return max(self[name].relative() for name in ("Kc", "Bc"))

    @property
    def limited_by(self) -> str:
        """The name of the limit that would be reached first if the amplitude were raised."""
        return LIMITED[self.worst_shares.index(max(self.worst_shares))]


def terms_of(model: str) -> tuple[str, ...]:
    """Return the names of the terms in a model such as "linear+offset", or in "auto".

    Raises WrongUse for a term whose errors cannot be predicted.
    """
    if model == "auto":
        return AUTO
    named = [term.strip() for term in model.split("+")]
    for term in named:
        if term not in TERMS:
            raise WrongUse(
                f"--model {model!r}: the error of {term!r} cannot be predicted, only that of {', '.join(TERMS)}"
            )
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
    mode: Quantity,
    rate: float,
) -> Task:
    """Return the design task for a stand.

    kc, bc: rough values, N m/rad and N m s/rad; None: the values in [sim], for a simulated stand only. torque_noise:
    standard deviation, N m at the joint; None: the value in [sim]. model: terms, or "auto". rate: Hz. Raises WrongUse.
    """
    limits, simulated = stand.checked_limits(), stand.stand.backend == "sim"
    plant = stand.simulated()
    joint = _joint(stand, plant if simulated else None, kc, bc)
    ratio = stand.stand.gear_ratio
    ceiling = min(limits.torque, plant.drive.torque_limit * ratio) if simulated else limits.torque
    task = Task(
        joint=joint,
        readings=_readings(stand, plant, torque_noise),
        limits=Peaks(ceiling, limits.torque, limits.deflection, limits.velocity),
        terms=terms_of(model),
        mode=mode,
        rate=rate,
    )
    reach = min(limits.deflection, limits.torque / joint.stiffness, ceiling / joint.stiffness)
    if reach < task.readings.angle_lsb:
        raise WrongUse(
            f"the limits permit no motion that the encoder resolves: at most {reach:.2g} rad, and one count is "
            f"{task.readings.angle_lsb:.2g} rad; raise limits.torque or limits.deflection in the stand file"
        )
    return task


def _joint(stand: Stand, plant: SimParameters | None, kc: float | None, bc: float | None) -> Joint:
    if plant is not None:
        kc = plant.coupling.stiffness if kc is None else kc
        bc = plant.coupling.damping if bc is None else bc
    if kc is None or bc is None:
        raise WrongUse("give --kc (N m/rad) and --bc (N m s/rad), however rough; a first recording gives them")
    for name, value, unit in (("kc", kc, "N m/rad"), ("bc", bc, "N m s/rad")):
        if not (math.isfinite(value) and value > 0.0):
            raise WrongUse(f"--{name} {value:g}: it must be above 0 {unit}; give a rough value")
    ratio = stand.stand.gear_ratio
    inertia, friction = stand.stand.motor_inertia, stand.stand.motor_damping
    if plant is not None:
        inertia, friction = plant.motor.inertia or 0.0, plant.motor.viscous_friction or 0.0
    return Joint(kc, bc, ratio**2 * inertia, ratio**2 * friction)


def _readings(stand: Stand, plant: SimParameters, torque_noise: float | None) -> Readings:
    """Return the sensor errors from [sim.sensors], which describes the sensors of every stand, not only of a simulated
    one.
    """
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
            raise WrongUse(
                f"--torque-noise {torque_noise:g}: must be above 0: the standard deviation of the torque, N m"
            )
        noise, lsb = torque_noise, 0.0
    joint_count = 1.0 / sensors.joint_counts if sensors.joint_encoder else 0.0
    count = 2.0 * math.pi * math.hypot(1.0 / (ratio * sensors.motor_counts), joint_count)
    return Readings(noise, lsb, count, age - sensors.motor_position_delay, motor_side)


def assess(task: Task, profile: Profile) -> Assessment:
    """Predict motion, peaks and errors for `profile`. Raises WrongUse if the motion is less than one encoder count."""
    motion, found = respond(task.joint, profile, task.rate)
    if found.deflection < task.readings.angle_lsb:
        raise WrongUse(
            f"a {profile.kind} of {profile.amplitude:g} {_unit(task.mode)} moves the joint by "
            f"{found.deflection:.2g} rad, less than one count of {task.readings.angle_lsb:.2g} rad: raise --amplitude"
        )
    parameters = predict(task.terms, task.joint, motion, task.readings)
    friction = mistaken_friction(task.terms, task.joint, motion)
    likeness = friction_likeness(motion.dtheta_dot) if friction else 0.0
    return Assessment(profile, parameters, found, task.shares(found), worst_shares(task, profile), friction, likeness)


def check_limits(task: Task, judged: Assessment) -> None:
    """Raise WrongUse if the excitation would exceed a limit; the message proposes an amplitude within the limits."""
    worst = max(judged.shares)
    if worst <= 1.0 + 1e-9:
        return
    index = judged.shares.index(worst)
    peak, unit = judged.peaks[index], UNITS[index]
    profile = judged.profile
    raise WrongUse(
        f"a {profile.kind} of {profile.amplitude:g} {_unit(task.mode)} takes the {LIMITED[index]} to {peak:.3g} "
        f"{unit}, and its limit is {task.limits[index]:g} {unit}: lower --amplitude to "
        f"{rounded(profile.amplitude / worst, down=True):g}, or change --band"
    )


def _unit(mode: Quantity) -> str:
    return "N m" if mode is Quantity.TORQUE else "rad"


def worst_shares(task: Task, profile: Profile) -> Peaks:
    """Return each peak divided by its limit: the largest ratio over all Kc and Bc within `ROUGH_RANGE`."""
    joints = [
        replace(task.joint, stiffness=task.joint.stiffness * stiffer, damping=task.joint.damping * thicker)
        for stiffer, thicker in itertools.product(*ROUGH_RANGE)
    ]
    shares = [task.shares(found) for found in peaks(joints, profile, task.rate)]
    return Peaks(*(max(values) for values in zip(*shares, strict=True)))


def rounded(value: float, *, down: bool = False) -> float:
    """Return a number rounded to three significant digits, as in the printed command. down: whether to round
    down only.
    """
    unit = 10.0 ** (math.floor(math.log10(value)) + 1 - _DIGITS)
    steps = math.floor(value / unit * (1.0 + 1e-12)) if down else round(value / unit)
    return float(f"{steps * unit:.{_DIGITS}g}")
