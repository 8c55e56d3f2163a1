"""Recordings of benches as people have them, written from the physics and not from the models of hil.

A `Bench` says how the joint moves, what couples it and what its sensors do. `record` integrates the coupling on a grid
20 times finer than the samples, or has MuJoCo do it, and reads it as the sensors would. `ROWS` names the benches of the
table that `truth_benches.py` prints; those in `DESCRIBED` are described by a model of `hil identify`, so nothing may be
flagged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco_joint
import numpy as np
from mujoco_joint import Joint
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

KC, BC = 0.3, 3e-3  # N m/rad, N m s/rad
RATE, DURATION, PEAK, NOISE = 500.0, 20.0, 0.25, 1e-3  # Hz, s, rad, N m
PERIOD = 10.0  # s, of the multisine
MUJOCO = ", MuJoCo"  # ends the name of a bench whose joint MuJoCo simulates
FINER = 20  # steps of the integration between two samples


@dataclass(frozen=True, slots=True)
class Motion:
    """A deflection on a fine grid: time (n,) s, deflection rad, rate rad/s, acceleration rad/s^2; step s."""

    time: Array
    deflection: Array
    rate: Array
    acceleration: Array
    step: float


Law = Callable[[Motion, float, float], Array]
"""The torque (n,) N m of a coupling for a motion, Kc N m/rad and Bc N m s/rad."""


def spring_and_damper(m: Motion, k: float, b: float) -> Array:
    """The plain coupling."""
    return k * m.deflection + b * m.rate


@dataclass(frozen=True, slots=True)
class Bench:
    """One bench; SI. kind: "multisine", "chirp", "prbs", "walk" or "ramp". law: the coupling. rate: Hz, of the samples.

    joint: one that MuJoCo simulates, in the place of the law.

    stiffness, damping: what the result is held against, NaN where the coupling has none. torque_noise: N m, of colour
    "white", "ar" (first order, 20 samples long) or "heavy" (Student, 3 degrees of freedom). bits: of the encoder, a
    turn; 0: exact. delay: s, of the torque reading; lag: s,
    of its cell. cell_rate: Hz, of a slower torque cell, 0: as fast as the angle;
    interpolated: whether its readings are joined by lines instead of held. zero: rad, added to the angle. torque_unit
    and angle_unit: what a reading is multiplied by, wrongly. frozen: s, from which on the angle stands still.
    clock: s, to which the stamps are rounded down; 0: exact.
    """

    kind: str = "multisine"
    law: Law = field(default=spring_and_damper)
    stiffness: float = KC
    damping: float = BC
    joint: Joint | None = None
    peak: float = PEAK
    band: tuple[float, float] = (0.2, 12.0)
    duration: float = DURATION
    rate: float = RATE
    torque_noise: float = NOISE
    colour: str = "white"
    angle_noise: float = 0.0
    bits: int = 0
    delay: float = 0.0
    lag: float = 0.0
    cell_rate: float = 0.0
    interpolated: bool = False
    zero: float = 0.0
    torque_unit: float = 1.0
    angle_unit: float = 1.0
    frozen: float = math.inf
    wrapped: bool = False
    clock: float = 0.0


@dataclass(frozen=True, slots=True)
class Reading:
    """What was read, (n,) each: time s, torque N m, deflection rad, and the commanded deflection rad."""

    time: Array
    torque: Array
    deflection: Array
    command: Array


def record(bench: Bench, seed: int) -> Reading:
    """Return the recording of a bench; the same seed gives the same samples."""
    rng = np.random.default_rng([seed, 4711])
    motion = MOTIONS[bench.kind](bench, rng)
    command, time = motion.deflection[::FINER], motion.time[::FINER]
    if bench.joint is None:
        deflection, pure = command, bench.law(motion, bench.stiffness, bench.damping)
    else:
        followed, _, pure = mujoco_joint.simulated(bench.joint, motion.step, motion.deflection, motion.rate)
        deflection = followed[::FINER]
    return Reading(
        bench.clock * np.floor(time / bench.clock + 1e-9) if bench.clock else time,
        _cell(bench, motion, pure, rng) * bench.torque_unit,
        _angle(bench, time, deflection, rng) * bench.angle_unit,
        command,
    )


def write_csv(reading: Reading, path: Path) -> None:
    """Write a recording as a table for `hil import`. Its headings name no unit, as those of most tables."""
    table = np.column_stack([reading.time, reading.torque, reading.deflection])
    np.savetxt(path, table, delimiter=",", header="time,torque,dtheta", comments="", fmt="%.10g")


def write_recording(reading: Reading, path: Path) -> None:
    """Write a recording as HDF5 for `hil identify`."""
    from hil.recording.writer import Header, write

    header = Header(profile={"kind": "prescribed"}, stand_toml="")
    channels = {"time": reading.time, "torque": reading.torque, "dtheta": reading.deflection}
    write(path, header, channels | {"command": reading.command})


def _grid(bench: Bench) -> Array:
    return np.arange(round(bench.duration * bench.rate) * FINER) / (bench.rate * FINER)


def _multisine(bench: Bench, rng: np.random.Generator) -> Motion:
    time, (low, high) = _grid(bench), bench.band
    lines = np.unique(np.round(np.geomspace(low, high, 40) * PERIOD)) / PERIOD
    speeds, phases = 2.0 * np.pi * lines, rng.uniform(0.0, 2.0 * np.pi, len(lines))
    parts = np.zeros((3, len(time)))
    for speed, phase in zip(speeds, phases, strict=True):
        wave = np.exp(1j * (speed * time + phase))
        parts += np.stack([wave.real, -speed * wave.imag, -(speed**2) * wave.real])
    return Motion(time, *(parts * bench.peak / np.abs(parts[0]).max()), 1.0 / (bench.rate * FINER))


def _chirp(bench: Bench, _rng: np.random.Generator) -> Motion:
    time, (low, high) = _grid(bench), bench.band
    growth = math.log(high / low) / bench.duration
    phase, speed = 2.0 * np.pi * low * np.expm1(growth * time) / growth, 2.0 * np.pi * low * np.exp(growth * time)
    sine, cosine = bench.peak * np.sin(phase), bench.peak * np.cos(phase)
    return Motion(time, sine, cosine * speed, cosine * growth * speed - sine * speed**2, 1.0 / (bench.rate * FINER))


def _prbs(bench: Bench, rng: np.random.Generator) -> Motion:
    """A random binary sequence through a second-order filter at the upper end of the band."""
    time, speed = _grid(bench), 2.0 * np.pi * bench.band[1]
    steps = np.repeat(rng.choice([-1.0, 1.0], int(bench.duration * 10.0) + 1), round(bench.rate * FINER / 10.0))
    return _driven(time, steps[: len(time)], bench.peak, speed)


def _walk(bench: Bench, rng: np.random.Generator) -> Motion:
    """White noise through a first-order filter at the lower end of the band, then as the binary sequence."""
    time, keep = _grid(bench), math.exp(-2.0 * math.pi * bench.band[0] / (bench.rate * FINER))
    walk = lfilter([1.0], [1.0, -keep], rng.standard_normal(len(time)))
    return _driven(time, np.asarray(walk), bench.peak, 2.0 * np.pi * bench.band[1])


def _ramp(bench: Bench, _rng: np.random.Generator) -> Motion:
    """A triangle of 2 s with rounded corners."""
    time = _grid(bench)
    triangle = 2.0 * np.abs(np.mod(time / 2.0 + 0.25, 1.0) - 0.5) - 0.5
    return _driven(time, 2.0 * triangle, bench.peak, 2.0 * np.pi * bench.band[1])


def _driven(time: Array, command: Array, peak: float, speed: float) -> Motion:
    step = float(time[1] - time[0])
    deflection, rate, acceleration = (np.zeros(len(time)) for _ in range(3))
    x = v = 0.0
    for at, wanted in enumerate(command.tolist()):
        a = speed * speed * (wanted - x) - 1.6 * speed * v
        # the slope of the deflection is that in the middle of the two steps beside it
        deflection[at], rate[at], acceleration[at] = x, v + 0.5 * a * step, a
        v += a * step
        x += v * step
    scale = peak / np.abs(deflection).max()
    return Motion(time, scale * deflection, scale * rate, scale * acceleration, step)


MOTIONS: Mapping[str, Callable[[Bench, np.random.Generator], Motion]] = {
    "multisine": _multisine,
    "chirp": _chirp,
    "prbs": _prbs,
    "walk": _walk,
    "ramp": _ramp,
}


def _low_pass(values: Array, constant: float, step: float) -> Array:
    """A first-order lag, exact for readings joined by lines."""
    keep = math.exp(-step / constant)
    share = constant / step * (1.0 - keep)
    return np.asarray(lfilter([1.0 - share, share - keep], [1.0, -keep], values, zi=[share * values[0]])[0])


def _cell(bench: Bench, motion: Motion, torque: Array, rng: np.random.Generator) -> Array:
    """The readings of the torque cell at the samples, with its lag, noise and rate."""
    if bench.delay:
        torque = np.interp(motion.time - bench.delay, motion.time, torque)
    if bench.lag:
        torque = _low_pass(torque, bench.lag, motion.step)
    time = motion.time[::FINER]
    if not bench.cell_rate:
        return torque[::FINER] + bench.torque_noise * _noise(bench.colour, len(time), rng)
    read = np.arange(0.0, motion.time[-1], 1.0 / bench.cell_rate)
    readings = np.interp(read, motion.time, torque) + bench.torque_noise * _noise(bench.colour, len(read), rng)
    if bench.interpolated:
        return np.interp(time, read, readings)
    return readings[np.searchsorted(read, time + 1e-9, side="right") - 1]


def _angle(bench: Bench, time: Array, deflection: Array, rng: np.random.Generator) -> Array:
    angle = deflection + bench.zero + bench.angle_noise * rng.standard_normal(len(time))
    if bench.bits:
        count = 2.0 * np.pi / 2.0**bench.bits
        angle = count * np.round(angle / count)
    if np.isfinite(bench.frozen):
        angle = np.where(time >= bench.frozen, angle[np.searchsorted(time, bench.frozen)], angle)
    return np.mod(angle, 2.0 * np.pi) if bench.wrapped else angle


def _noise(colour: str, count: int, rng: np.random.Generator) -> Array:
    if colour == "heavy":
        return rng.standard_t(3.0, count) / math.sqrt(3.0)
    white = rng.standard_normal(count)
    if colour == "ar":
        keep = math.exp(-1.0 / 20.0)
        return np.asarray(lfilter([math.sqrt(1.0 - keep**2)], [1.0, -keep], white))
    return white


def friction(level: float, over: float = 1e-3) -> Law:
    """Friction of `level` N m that turns over `over` rad/s, beside spring and damper."""
    return lambda m, k, b: k * m.deflection + b * m.rate + level * np.tanh(m.rate / over)


def cubic(factor: float) -> Law:
    """A spring with `factor` N m/rad^3 more."""
    return lambda m, k, b: k * m.deflection + b * m.rate + factor * m.deflection**3


def viscoelastic(share: float, constant: float) -> Law:
    """A standard linear solid: a Maxwell branch of `share` of Kc that relaxes in `constant` s beside Kc and Bc."""

    def law(m: Motion, k: float, b: float) -> Array:
        branch = m.deflection - _low_pass(m.deflection, constant, m.step)
        return np.asarray(k * m.deflection + b * m.rate + share * k * branch)

    return law


def bristles(coulomb: float, static: float, presliding: float, stribeck: float) -> Law:
    """LuGre friction (Canudas de Wit 1995): N m sliding, N m breaking away, rad of presliding, rad/s of Stribeck."""

    def law(m: Motion, k: float, b: float) -> Array:
        stiffness, z, found = coulomb / presliding, 0.0, np.zeros(len(m.time))
        levels = coulomb + (static - coulomb) * np.exp(-((m.rate / stribeck) ** 2))
        paces = stiffness * np.abs(m.rate) / levels
        ends = np.sign(m.rate) * levels / stiffness
        keeps = np.exp(-paces * m.step)
        for at, (keep, end) in enumerate(zip(keeps.tolist(), ends.tolist(), strict=True)):
            z = end + (z - end) * keep
            found[at] = z
        return k * m.deflection + b * m.rate + stiffness * found

    return law


def bouc_wen(share: float, yielding: float) -> Law:
    """Bouc and Wen's hysteresis: `share` of Kc yields at `yielding` rad."""

    def law(m: Motion, k: float, b: float) -> Array:
        z, found = 0.0, np.zeros(len(m.time))
        for at, moved in enumerate((m.rate * m.step).tolist()):
            z += moved * (1.0 - (0.5 + 0.5 * math.copysign(1.0, moved * z)) * abs(z) / yielding)
            found[at] = z
        return (1.0 - share) * k * m.deflection + share * k * found + b * m.rate

    return law


def capstan(share: float, pulled: Law = spring_and_damper) -> Law:
    """Friction of `share` of the torque that the tendon carries, which is that of the law `pulled`."""

    def law(m: Motion, k: float, b: float) -> Array:
        carried = pulled(m, k, b)
        return np.asarray(carried + share * np.abs(carried) * np.tanh(m.rate / 1e-2))

    return law


def pulley(share: float, over: float = 1e-2) -> Law:
    """Friction of `share` of the spring's torque that turns over `over` rad/s; the damper acts beside it."""
    return lambda m, k, b: k * (m.deflection + share * np.abs(m.deflection) * np.tanh(m.rate / over)) + b * m.rate


def sheath(share: float, reach: float) -> Law:
    """Friction of `share` of the torque that the tendon carries, which builds up over `reach` rad (Dahl)."""

    def law(m: Motion, k: float, b: float) -> Array:
        carried = k * m.deflection + b * m.rate
        return np.asarray(carried + share * np.abs(carried) * _built_up(m, reach))

    return law


def gear(play: float, level: float, share: float, reach: float) -> Law:
    """A gear with `play` rad: friction of `level` N m and of `share` of what its flanks push, over `reach` rad."""

    def law(m: Motion, k: float, b: float) -> Array:
        beyond = m.deflection - np.clip(m.deflection, -0.5 * play, 0.5 * play)
        pushed = k * beyond + b * m.rate
        pushed = np.where(beyond * pushed > 0.0, pushed, 0.0)
        return np.asarray(pushed + (level + share * np.abs(pushed)) * _built_up(m, reach))

    return law


def _built_up(m: Motion, reach: float) -> Array:
    """Dahl's state, -1 to 1, from rest."""
    z, found = 0.0, np.zeros(len(m.time))
    for at, moved in enumerate((m.rate * m.step).tolist()):
        end = math.copysign(1.0, moved)
        z = end + (z - end) * math.exp(-abs(moved) / reach)
        found[at] = z
    return found


def quadratic(factor: float) -> Law:
    """Damping of `factor` N m s^2/rad^2 times the square of the rate beside Bc."""
    return lambda m, k, b: k * m.deflection + b * m.rate + factor * m.rate * np.abs(m.rate)


def dead_band(gap: float) -> Law:
    """A spring that acts beyond a gap of `gap` rad in all, and a damper that always acts."""
    return lambda m, k, b: k * np.sign(m.deflection) * np.maximum(np.abs(m.deflection) - 0.5 * gap, 0.0) + b * m.rate


def fading(share: float) -> Law:
    """A stiffness that falls by `share` from the first sample to the last; Kc is its mean."""

    def law(m: Motion, k: float, b: float) -> Array:
        return k * (1.0 + share * (0.5 - m.time / m.time[-1])) * m.deflection + b * m.rate

    return law


def inertia(moment: float) -> Law:
    """An inertia of `moment` kg m^2 left in the torque."""
    return lambda m, k, b: k * m.deflection + b * m.rate + moment * m.acceleration


def drawn(seed: int) -> tuple[str, Bench]:
    """Return a bench drawn at random, with two of the effects that benches have, and their names.

    Drawn are also: stiffness over four decades, the corner of the damping, sampling rate, band, amplitude, duration,
    noise and its colour.
    """
    rng = np.random.default_rng([seed, 815])
    stiffness, peak = 10.0 ** rng.uniform(math.log10(0.02), math.log10(500.0)), 10.0 ** rng.uniform(-1.3, -0.3)
    bench = Bench(
        kind=str(rng.choice(["multisine", "chirp"])),
        stiffness=stiffness,
        damping=stiffness / (2.0 * math.pi * rng.uniform(10.0, 50.0)),
        peak=peak,
        band=(rng.uniform(0.1, 0.5), rng.uniform(6.0, 15.0)),
        duration=rng.uniform(10.0, 30.0),
        rate=float(rng.choice([250.0, 500.0, 1000.0])),
        torque_noise=stiffness * peak * 10.0 ** rng.uniform(-3.0, -1.7),
        colour=str(rng.choice(["white", "ar", "heavy"])),
    )
    names = sorted(rng.choice(list(_EFFECTS), 2, replace=False).tolist(), key=_order)
    for name in names:
        bench = _EFFECTS[name](bench, rng)
    return " and ".join(names), bench


def _also(bench: Bench, law: Law) -> Bench:
    """The bench with what a law adds to spring and damper."""

    def both(m: Motion, k: float, b: float) -> Array:
        return np.asarray(bench.law(m, k, b) + law(m, k, b) - (k * m.deflection + b * m.rate))

    return replace(bench, law=both)


_Drawn = Callable[[Bench, np.random.Generator], Bench]

_EFFECTS: Mapping[str, _Drawn] = {
    "friction": lambda b, r: _also(b, friction(r.uniform(0.01, 0.1) * b.stiffness * b.peak)),
    "cubic": lambda b, r: _also(b, cubic(r.uniform(-0.2, 0.4) * b.stiffness / b.peak**2)),
    "delay": lambda b, r: replace(b, delay=r.uniform(2e-4, 3e-3)),
    "lag": lambda b, r: replace(b, lag=10.0 ** r.uniform(-3.5, -2.2)),
    "viscoelastic": lambda b, r: _also(b, viscoelastic(r.uniform(0.05, 0.5), 10.0 ** r.uniform(-2.3, -1.0))),
    "bristles": lambda b, r: _also(
        b,
        bristles(
            *(np.array([1.0, 1.3]) * r.uniform(0.01, 0.1) * b.stiffness * b.peak), r.uniform(0.01, 0.1) * b.peak, b.peak
        ),
    ),
    "capstan": lambda b, r: replace(b, law=capstan(r.uniform(0.03, 0.2), b.law)),
    "quadratic": lambda b, r: _also(b, quadratic(r.uniform(0.1, 1.0) * b.damping / (30.0 * b.peak))),
    "dead band": lambda b, r: _also(b, dead_band(r.uniform(0.02, 0.2) * b.peak)),
    "fading": lambda b, r: _also(b, fading(r.uniform(-0.2, 0.2))),
    "inertia": lambda b, r: _also(b, inertia(r.uniform(0.02, 0.2) * b.stiffness / (2.0 * math.pi * b.band[1]) ** 2)),
    "angle noise": lambda b, r: replace(b, angle_noise=10.0 ** r.uniform(-3.3, -1.7) * b.peak),
    "counts": lambda b, r: replace(b, bits=round(math.log2(math.pi / b.peak * 10.0 ** r.uniform(1.6, 3.3)))),
    "slow cell": lambda b, r: replace(b, cell_rate=r.uniform(60.0, 150.0), interpolated=bool(r.integers(2))),
    "far zero": lambda b, r: replace(b, zero=r.uniform(-6.0, 6.0)),
}
"""What a bench may have, drawn at random in proportion to it."""

_CARRIED = {"cubic", "dead band", "fading", "quadratic", "viscoelastic"}
"""The effects whose torque the tendon carries, so that the friction in its sheath is in proportion to it."""


def _order(effect: str) -> tuple[bool, bool, str]:
    """What the tendon carries comes first, then its own friction, then all others."""
    return effect not in _CARRIED, effect != "capstan", effect


_ONE = Bench()

_JOINTS: Mapping[str, Joint] = {
    "friction": Joint(KC, BC, friction=2e-3),
    "cubic": Joint(KC, BC, cubic=0.3),
    "chirp, friction": Joint(KC, BC, friction=2e-3),
    "linear solid 10 %, 10 ms": Joint(KC, BC, branch=0.1 * KC, relaxing=0.01),
    "linear solid 30 %, 20 ms": Joint(KC, BC, branch=0.3 * KC, relaxing=0.02),
    "linear solid 50 %, 50 ms": Joint(KC, BC, branch=0.5 * KC, relaxing=0.05),
    "quadratic damping": Joint(KC, BC, quadratic=1e-3),
    "dead band 20 mrad": Joint(KC, BC, gap=0.02),
}
"""What MuJoCo simulates for benches whose coupling is more than a spring and a damper."""


def _with_mujoco(benches: Mapping[str, Bench]) -> Mapping[str, Bench]:
    """The benches, and those whose coupling MuJoCo has parameters for once more with a joint that it simulates."""
    found = dict(benches)
    for name, bench in benches.items():
        plain = Joint(bench.stiffness, bench.damping) if bench.law is spring_and_damper else None
        if (joint := _JOINTS.get(name, plain)) is not None and bench.torque_unit == bench.angle_unit == 1.0:
            found[f"{name}{MUJOCO}"] = replace(bench, joint=joint)
    return found


DESCRIBED: Mapping[str, Bench] = _with_mujoco(
    {
        "plain": _ONE,
        "coloured noise": replace(_ONE, colour="ar"),
        "heavy-tailed noise": replace(_ONE, colour="heavy"),
        "friction": replace(_ONE, law=friction(2e-3)),
        "cubic": replace(_ONE, law=cubic(0.3)),
        "skew": replace(_ONE, delay=1.5e-3),
        "chirp": replace(_ONE, kind="chirp"),
        "chirp, coloured": replace(_ONE, kind="chirp", colour="ar"),
        "chirp, friction": replace(_ONE, kind="chirp", law=friction(2e-3)),
        "prbs": replace(_ONE, kind="prbs"),
        "prbs, heavy": replace(_ONE, kind="prbs", colour="heavy"),
        "random walk": replace(_ONE, kind="walk", bits=16),
        "18 bit, 3 kHz": replace(_ONE, kind="chirp", rate=3000.0, duration=3.0, bits=18, peak=0.035, torque_noise=1e-5),
        "350 Hz, stamps to 1 ms": replace(_ONE, rate=350.0, clock=1e-3),
    }
)
"""Benches that a model of `hil identify` describes."""

ROWS: Mapping[str, Bench] = _with_mujoco(
    {
        "angle noise 2 mrad": replace(_ONE, angle_noise=2e-3),
        "angle noise 5 mrad": replace(_ONE, angle_noise=5e-3),
        "prbs, angle noise 2 mrad": replace(_ONE, kind="prbs", angle_noise=2e-3),
        "12 bit, 0.05 rad": replace(_ONE, bits=12, peak=0.05),
        "12 bit, 0.02 rad": replace(_ONE, bits=12, peak=0.02),
        "17 bit, 500 N m/rad, 0.01 rad": replace(
            _ONE, bits=17, peak=0.01, stiffness=500.0, damping=5.0, torque_noise=1e-2
        ),
        "cell of 30 Hz": replace(_ONE, lag=1.0 / (2.0 * math.pi * 30.0)),
        "cell of 100 Hz": replace(_ONE, lag=1.0 / (2.0 * math.pi * 100.0)),
        "80 Hz cell, held": replace(_ONE, cell_rate=80.0),
        "80 Hz cell, interpolated": replace(_ONE, cell_rate=80.0, interpolated=True),
        "linear solid 10 %, 10 ms": replace(_ONE, law=viscoelastic(0.1, 0.01)),
        "linear solid 30 %, 20 ms": replace(_ONE, law=viscoelastic(0.3, 0.02)),
        "linear solid 50 %, 50 ms": replace(_ONE, law=viscoelastic(0.5, 0.05)),
        "LuGre, soft bristles": replace(_ONE, law=bristles(5e-3, 7e-3, 0.01, 0.3)),
        "Bouc-Wen 20 %": replace(_ONE, law=bouc_wen(0.2, 0.02)),
        "capstan 15 %": replace(_ONE, law=capstan(0.15)),
        "pulley 15 %": replace(_ONE, law=pulley(0.15)),
        "pulley 15 %, smooth": replace(_ONE, law=pulley(0.15, 0.1)),
        "smooth friction": replace(_ONE, law=friction(2e-3, 0.1)),
        "sheath 20 %, 10 mrad": replace(_ONE, law=sheath(0.2, 0.01)),
        "gear, 40 mrad of play": replace(_ONE, law=gear(0.04, 2e-3, 0.2, 0.01)),
        "quadratic damping": replace(_ONE, law=quadratic(1e-3)),
        "dead band 20 mrad": replace(_ONE, law=dead_band(0.02)),
        "fading 20 %, chirp": replace(_ONE, kind="chirp", law=fading(0.2)),
        "inertia": replace(_ONE, law=inertia(2e-5)),
        "zero 1.5 rad away": replace(_ONE, zero=1.5),
        "zero 6 rad away": replace(_ONE, zero=6.0),
        "degrees for radians": replace(_ONE, angle_unit=180.0 / math.pi),
        "mN m for N m": replace(_ONE, torque_unit=1e3),
        "angle frozen from 8 s": replace(_ONE, frozen=8.0),
        "angle wrapped": replace(_ONE, zero=0.1, wrapped=True),
        "ramp": replace(_ONE, kind="ramp"),
    }
) | {f"yielding spring{MUJOCO}": replace(_ONE, joint=Joint(KC, BC, yielding=0.4, reach=0.01))}
"""Benches that were seen to give wrong numbers, and those whose readings are wrong."""
