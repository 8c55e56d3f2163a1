"""The cases of the truth study, and the closed form of what a coupling does under a prescribed deflection.

Nothing here knows the simulator's plant or the models of the search: a case is written down twice, once as a `[sim]`
table for the simulator and once as the closed form below.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Tables = Mapping[str, Mapping[str, float | bool]]

KC, BC = 17.75e-3, 0.19e-3  # N m/rad, N m s/rad: the paper's joint
AMPLITUDE, DURATION, RATE = 0.35, 20.0, 500.0  # rad, s, Hz
SAMPLES = int(DURATION * RATE)
NOISE = 0.2e-3  # N m at the joint, standard deviation
GEAR, MOTOR_INERTIA, MOTOR_DAMPING = 4.0, 2e-7, 1e-7  # -, kg m^2, N m s/rad


@dataclass(frozen=True, slots=True)
class Motion:
    """A deflection and its derivatives at the same instants, (n,): rad, rad/s, rad/s^2."""

    deflection: Array
    rate: Array
    acceleration: Array


def chirp(time: Array, band: tuple[float, float]) -> Motion:
    """A sine of 0.35 rad whose frequency rises from one end of `band`, Hz, to the other with equal time per octave.

    The frequency f(t) = f0 e^(gt) integrates to the phase 2 pi f0 (e^(gt) - 1)/g; time (n,) s.
    """
    low, high = band
    growth = math.log(high / low) / DURATION
    phase = 2.0 * np.pi * low * np.expm1(growth * time) / growth
    speed = 2.0 * np.pi * low * np.exp(growth * time)
    sine, cosine = AMPLITUDE * np.sin(phase), AMPLITUDE * np.cos(phase)
    return Motion(sine, cosine * speed, cosine * growth * speed - sine * speed**2)


def still(time: Array) -> Motion:
    """A joint held at 0.2 rad."""
    return Motion(np.full_like(time, 0.2), np.zeros_like(time), np.zeros_like(time))


@dataclass(frozen=True, slots=True)
class Truth:
    """The parameters of the closed form, SI, named as in `ga.model.terms`. skew: s the torque reading is late."""

    Kc: float = KC
    Bc: float = BC
    Fc: float = 0.0
    K3: float = 0.0
    gap: float = 0.0
    skew: float = 0.0
    tau0: float = 0.0
    drift: float = 0.0


@dataclass(frozen=True, slots=True)
class Case:
    """One imperfection, or several. `sim` says it to the simulator, the rest to the second generator.

    free: the parameters of the true model, for the Cramer-Rao bound. position_lsb: rad at the joint, 0 for none.
    lost: probability of a lost reply. jitter: s, of the instant and, again, of its stamp. outliers: share of torques
    moved by 20 mN m. sim_amplitude: N m where torque is commanded, else rad. sim_soft: s of fade in and out, 0.1 at
    least; the shortest lets 15 Hz be reached at full amplitude. bars: which row of the promise holds.
    """

    name: str
    what: str
    in_sim: str
    in_closed_form: str
    truth: Truth = field(default_factory=Truth)
    free: tuple[str, ...] = ("Kc", "Bc")
    sim: Tables = field(default_factory=dict)
    band: tuple[float, float] = (0.1, 15.0)
    position_lsb: float = 0.0
    lost: float = 0.0
    jitter: float = 0.0
    outliers: float = 0.0
    motor_side: bool = False
    stands_still: bool = False
    sim_amplitude: float = 0.376
    sim_soft: float = 0.1
    bars: str = "tight"

    def motion(self, time: Array) -> Motion:
        """The prescribed deflection at `time` (n,) s."""
        return still(time) if self.stands_still else chirp(time, self.band)

    def torque(self, time: Array, truth: Truth | None = None) -> Array:
        """The torque a perfect cell would show at `time` (n,) s, N m, late by the skew."""
        true = self.truth if truth is None else truth
        motion = self.motion(time - true.skew)
        return coupling_torque(motion, true) + true.tau0 + true.drift * time


def coupling_torque(motion: Motion, true: Truth) -> Array:
    """sigma_c (n,) N m in closed form: equation 2, a cubic spring, a sign for dry friction, flanks that only push."""
    deflection, rate = motion.deflection, motion.rate
    beyond = np.sign(deflection) * np.clip(np.abs(deflection) - true.gap / 2.0, 0.0, None)
    torque = true.Kc * beyond + true.K3 * beyond**3 + true.Bc * rate
    if true.gap > 0.0:
        pushes = (beyond != 0.0) & (torque * beyond > 0.0)
        torque = np.where(pushes, torque, 0.0)
    return np.asarray(torque + true.Fc * np.sign(rate))


def bound(case: Case) -> dict[str, float]:
    """The Cramer-Rao bound: least standard deviation, SI, of each free parameter of the case's own model.

    For an angle known exactly at exactly known instants and Gaussian noise of 0.2 mN m on the torque; the derivatives
    are central differences of the closed form. A parameter that nothing tells has an infinite bound.
    """
    time = np.arange(SAMPLES) / RATE
    columns = np.stack([_slope(case, name, time) for name in case.free], axis=1)
    size = np.linalg.norm(columns, axis=0)
    sensitive = size > 0.0
    scaled = columns[:, sensitive] / size[sensitive]
    information = scaled.T @ scaled / NOISE**2 * (1.0 - case.lost)
    errors = np.full(len(case.free), np.inf)
    if np.linalg.cond(information) < 1e12:
        errors[sensitive] = np.sqrt(np.diag(np.linalg.inv(information))) / size[sensitive]
    return dict(zip(case.free, errors.tolist(), strict=True))


_STEPS = {"Kc": 1e-6, "Bc": 1e-8, "Fc": 1e-7, "K3": 1e-4, "gap": 1e-5, "skew": 1e-6, "tau0": 1e-6, "drift": 1e-7}


def _slope(case: Case, name: str, time: Array) -> Array:
    step, true = _STEPS[name], case.truth
    above = replace(true, **{name: getattr(true, name) + step})
    below = replace(true, **{name: getattr(true, name) - step})
    return (case.torque(time, above) - case.torque(time, below)) / (2.0 * step)


_FRICTION = {"coulomb_friction": 1e-3, "static_friction_ratio": 1.0, "bristle_stiffness": 20.0, "bristle_damping": 0.0}
_FILTER = 1.0 / (2.0 * np.pi * 20e3)  # s, what the torque cell's own filter is late by
_COUNT = 2.0 * np.pi / 4096

CASES: tuple[Case, ...] = (
    Case(
        "clean",
        "torque noise of 0.2 mN m and nothing else",
        "no friction, rigid fixture, 2^24 counts, no delay, no jitter, no loss",
        "deflection and rate exact",
    ),
    Case(
        "encoder",
        "12 bits a turn of the joint, no rate",
        "1,024 counts a turn of the motor, which its position loop sees too; gear of 4",
        "deflection rounded to 2 pi/4096, no rate channel",
        sim={"sensors": {"motor_counts": 1024, "reports_velocity": False}},
        position_lsb=_COUNT,
    ),
    Case(
        "skew",
        "torque read 2 ms late",
        "joint_torque_delay 2 ms",
        "torque of 2 ms ago",
        truth=Truth(skew=2e-3),
        free=("Kc", "Bc", "skew"),
        sim={"sensors": {"joint_torque_delay": 2e-3}},
    ),
    Case(
        "coulomb",
        "1 mN m of dry friction",
        "LuGre, static as Coulomb, bristles of 20 N m/rad (slides after 0.05 mrad); the joint sticks at reversals",
        "1 mN m times the sign of the rate",
        truth=Truth(Fc=1e-3),
        free=("Kc", "Bc", "Fc"),
        sim={"coupling": _FRICTION},
    ),
    Case(
        "backlash",
        "a gap of 0.02 rad between flanks that push and cannot pull",
        "coupling.gap 0.02 rad",
        "zero torque in the gap and wherever a flank would have to pull",
        truth=Truth(gap=0.02),
        free=("Kc", "Bc", "gap"),
        sim={"coupling": {"gap": 0.02}},
        bars="wide",
    ),
    Case(
        "cubic",
        "K3 such that the spring is 30 % stiffer at 0.35 rad",
        "coupling.cubic 0.0435 N m/rad^3",
        "K3 dtheta^3, the same K3",
        truth=Truth(K3=0.3 * KC / AMPLITUDE**2),
        free=("Kc", "Bc", "K3"),
        sim={"coupling": {"cubic": 0.3 * KC / AMPLITUDE**2}},
        bars="wide",
    ),
    Case(
        "drops",
        "5 % of the samples lost, stamps wrong by 0.1 ms, offset 0.5 mN m, drift 20 uN m/s",
        "lost_reply 0.05; jitter of 0.141 ms each way, which puts half the difference of the ways into the stamp",
        "instants off the grid by 0.1 ms and stamps off the instants by 0.1 ms (standard deviations), 5 % missing",
        truth=Truth(tau0=0.5e-3, drift=2e-5),
        free=("Kc", "Bc", "tau0", "drift"),
        sim={
            "sensors": {"torque_cell_offset": 0.5e-3, "torque_cell_drift": 2e-5},
            "link": {"lost_reply": 0.05, "jitter": 1.41e-4, "round_trip": 8e-4, "reply_timeout": 1.8e-3},
        },
        lost=0.05,
        jitter=1e-4,
    ),
    Case(
        "outliers",
        "2 % of the torques moved by 20 mN m, up or down",
        "the same, put upon the replies of the simulated servo, which has no such fault",
        "the same",
        outliers=0.02,
    ),
    Case(
        "motor side",
        "torque inferred from the motor's by equation 1 with known Dm, Bm; 4,096 counts a turn of the motor",
        "chirp of 6.2 mN m in torque (0.35 rad at 0.1 Hz, 0.47 at resonance), current loop of 1 kHz, "
        "noise of the motor torque 0.05 mN m (0.2 at the joint)",
        "motor torque in closed form at the instant of the sample, noise of 0.05 mN m",
        sim={"sensors": {"motor_counts": 4096}},
        position_lsb=_COUNT / GEAR,
        motor_side=True,
        sim_amplitude=6.2e-3,
        bars="wide",
    ),
    Case(
        "all at once",
        "encoder, skew, coulomb, offset 0.5 mN m and jitter as above",
        "the tables of these cases together",
        "these cases together",
        truth=Truth(skew=2e-3, Fc=1e-3, tau0=0.5e-3),
        free=("Kc", "Bc", "skew", "Fc", "tau0"),
        sim={
            "coupling": _FRICTION,
            "sensors": {
                "motor_counts": 1024,
                "reports_velocity": False,
                "joint_torque_delay": 2e-3,
                "torque_cell_offset": 0.5e-3,
            },
            "link": {"jitter": 1.41e-4, "round_trip": 8e-4, "reply_timeout": 1.8e-3},
        },
        position_lsb=_COUNT,
        jitter=1e-4,
        bars="wide",
    ),
    Case(
        "too slow",
        "clean, but a chirp of 0.01 to 0.02 Hz: no estimator can identify Bc, whose bound is two thirds of it",
        "as clean, but 0.13 rad and 5 s of fade in and out: a run ends at rest, and a fast end would identify Bc",
        "as clean; ends where it is",
        band=(0.01, 0.02),
        sim_amplitude=0.13,
        sim_soft=5.0,
        bars="unidentifiable",
    ),
    Case(
        "standing still",
        "a constant deflection",
        "a chirp of 1 urad, below every count: only the torque's noise is left",
        "0.2 rad, rounded to 2 pi/4096 and at random one count up or down; no rate channel",
        sim={"sensors": {"motor_counts": 4096}},
        position_lsb=_COUNT,
        stands_still=True,
        sim_amplitude=1e-6,
        bars="unidentifiable",
    ),
)


def case_named(name: str) -> Case:
    """The case of that name. Raises ValueError."""
    for case in CASES:
        if case.name == name:
            return case
    raise ValueError(f"no case {name!r}; there are {', '.join(case.name for case in CASES)}")


def simulated_tables(case: Case) -> dict[str, dict[str, float | bool]]:
    """The `[sim]` tables of a case: a stand with nothing wrong but 0.2 mN m of noise, and the case's own on top.

    The torque cell's filter cannot be left out, so the angle is made late by as much. Set-points come as a staircase
    that the joint follows with a ripple of the same period as the samples, so the rate where a sample is taken is not
    the rate through the samples. The position loop is slow enough, and acts late enough after the sample (0.3 ms),
    that Bc is true to 0.1 % all the same. It has no integral part, which would overshoot at 15 Hz; 0.376 rad of
    set-point deflect by 0.350 at 0.1 Hz and by 0.349 at 14 Hz.
    """
    base: dict[str, dict[str, float | bool]] = {
        "coupling": {"coulomb_friction": 0.0},
        "fixture": {"stiffness": 2000.0, "damping": 0.1},
        "drive": {
            "torque_limit": 0.02,
            "command_delay": 2e-4,
            "position_gain": 0.015,
            "position_integral_gain": 0.0,
            "position_damping_gain": 7e-5,
        },
        "sensors": {
            "motor_counts": 2**24,
            "joint_encoder": False,
            "velocity_bandwidth": 2000.0,
            "velocity_lsb": 1e-6,
            "current_lsb": 1e-6,
            "motor_torque_noise": NOISE / GEAR,
            "torque_cell_noise": NOISE,
            "torque_cell_offset": 0.0,
            "torque_cell_drift": 0.0,
            "torque_cell_lsb": 1e-7,
            "torque_cell_bandwidth": 20e3,
            "motor_position_delay": 0.0 if case.motor_side else _FILTER,
            "motor_torque_delay": 0.0,
            "joint_torque_delay": 0.0,
        },
        "link": {"jitter": 0.0, "lost_reply": 0.0},
    }
    for table, keys in case.sim.items():
        base[table].update(keys)
    return base
