"""The physical simulation of the archive: a motor pulls a tendon that ends in a fixture with a torque cell.

Two or three inertias: motor, fixture, and in some draws a guide of the tendon with friction of its own. A draw has all
that real benches have at once: a toe, filters before the converter, stamps of a loop in Python, coarse encoders. None
of it is a model of `hil identify`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import benches
import numba
import numpy as np
from benches import Array, Bench
from scipy.integrate import odeint
from scipy.signal import butter, sosfilt

FINE, MOST = 10_000.0, 9990  # Hz of what is integrated, before the sensors; rows of a recording
CELL, MOTOR = "torque cell", "motor torque"
MOTIONS: Mapping[str, tuple[str, tuple[float, float], tuple[float, float]]] = {
    "chirp": ("chirp", (0.1, 0.4), (5.0, 12.0)),
    "multisine": ("multisine", (0.1, 0.4), (5.0, 12.0)),
    "steps": ("prbs", (0.2, 0.2), (15.0, 60.0)),
    "hand": ("walk", (0.2, 0.4), (1.5, 4.0)),
}
"""For each motion the kind of set-point in `benches`, and the ranges of both ends of its band, Hz."""
PAIRS = tuple((one, source) for one in MOTIONS for source in (CELL, MOTOR) if (one, source) != ("hand", MOTOR))


class Plant(NamedTuple):
    """The mechanics, SI at the joint.

    inertia, damping, friction: of the motor; gain, gain_rate: of its position loop, both 0 if torque is commanded; lag:
    s, of its current. stiffness, loss: of the tendon up to the guide (an inertia), or up to the fixture if that is 0;
    toe: by how much of `stiffness` the tendon is softer when slack, over `reach` rad; beyond, beyond_loss: of the
    tendon behind the guide; rubbing, capstan: friction of the guide, N m and share of the load, which builds up over
    `bristle` rad. fixture: inertia; cell, cell_loss: its spring.
    """

    inertia: float
    damping: float
    friction: float
    gain: float
    gain_rate: float
    lag: float
    stiffness: float
    loss: float
    toe: float
    reach: float
    guide: float
    beyond: float
    beyond_loss: float
    rubbing: float
    capstan: float
    bristle: float
    fixture: float
    cell: float
    cell_loss: float

    @property
    def truth(self) -> tuple[float, float]:
        """Kc and Bc of small, slow motion: spring and damper of each part, in series."""
        parts = [(self.stiffness * (1.0 - self.toe), self.loss), (self.cell, self.cell_loss)]
        parts += [(self.beyond, self.beyond_loss)] if self.guide else []
        kc = 1.0 / sum(1.0 / k for k, _ in parts)
        return kc, kc**2 * sum(b / k**2 for k, b in parts)


class Drawn(NamedTuple):
    """One draw: the plant, what moves it and what reads it. peak: rad; band, rate, corner (of a filter, 0: none): Hz.

    commanded: with the set-point; python: stamps of a loop in Python; delay: s, of the torque; noise: of its peak;
    counts: in the motion; wrong: factor of the motor's inertia and damping in the stand file.
    """

    seed: int
    motion: str
    motor: bool
    plant: Plant
    peak: float
    band: tuple[float, float]
    rate: float
    commanded: bool
    python: bool
    delay: float
    noise: float
    counts: float
    corner: float
    both_filtered: bool
    gear: float
    wrong: float

    @property
    def identifies_damping(self) -> bool:
        """Whether a recording identifies Bc: nothing that nobody has stated acts as a damping in it."""
        plant = self.plant
        if self.motor and (plant.friction or plant.gain or self.wrong != 1.0):
            return False
        slow = self.rate < (20.0 if self.motion == "hand" else 200.0) or 0.0 < self.corner < 100.0
        return not plant.guide and (self.both_filtered or not slow) and self.counts > 60.0


@numba.njit(cache=True)
def _slope(state: Any, time: Any, plant: Any, command: Any) -> Any:
    """The derivative of angle and rate of motor, guide and fixture, bristle of the guide, and torque of the motor."""
    q, v, q_guide, v_guide, q_end, v_end, z, torque = state
    at = min(max(time * FINE, 0.0), len(command) - 1.001)
    low = int(at)
    wanted = command[low] + (at - low) * (command[low + 1] - command[low])
    if plant.gain > 0.0:
        wanted = plant.gain * (wanted - q) - plant.gain_rate * v
    far, far_rate = (q_guide, v_guide) if plant.guide > 0.0 else (q_end, v_end)
    pull = q - far
    pulled = plant.stiffness * (pull - plant.toe * plant.reach * math.tanh(pull / plant.reach))
    pulled += plant.loss * (v - far_rate)
    onward, found = pulled, np.zeros(8)
    if plant.guide > 0.0:
        onward = plant.beyond * (q_guide - q_end) + plant.beyond_loss * (v_guide - v_end)
        found[3] = (pulled - onward - (plant.rubbing + plant.capstan * abs(pulled)) * z) / plant.guide
        found[6] = (v_guide - abs(v_guide) * z) / plant.bristle
    found[0], found[2], found[4] = v, v_guide, v_end
    found[1] = (torque - plant.damping * v - plant.friction * math.tanh(v / 0.01) - pulled) / plant.inertia
    found[5] = (onward - plant.cell * q_end - plant.cell_loss * v_end) / plant.fixture
    found[7] = (wanted - torque) / plant.lag
    return found


def draw(motion: str, source: str, seed: int) -> Drawn:
    """A bench at random; the same arguments give the same one."""
    rng = np.random.default_rng([seed, PAIRS.index((motion, source)), 44])
    kc, peak, motor = 10.0 ** rng.uniform(math.log10(0.02), 2.0), rng.uniform(0.04, 0.3), source == MOTOR
    tau = 1.0 / (2.0 * math.pi * rng.uniform(6.0, 40.0))  # s, Bc over Kc
    guide, toed = (bool(rng.random() < share) for share in (0.25, 0.4))
    toe, share = (rng.uniform(0.1, 0.4) if toed else 0.0), rng.uniform(0.3, 0.7) if guide else 1.0
    cell = kc * 10.0 ** rng.uniform(1.3, 2.5)
    natural = [2.0 * math.pi * rng.uniform(*of) for of in ((4.0, 15.0), (200.0, 500.0), (150.0, 600.0))]
    inertia, loop = kc / natural[0] ** 2, 2.0 * math.pi * rng.uniform(12.0, 35.0)
    by_position = motion in ("steps", "hand") or bool(rng.random() < 0.5)
    loop = 2.0 * natural[0] if motion == "hand" else max(loop, 2.0 * natural[0])
    clean = motor and bool(rng.random() < 0.5) and not by_position
    beyond = kc / max(1.0 - share, 0.1)
    plant = Plant(
        inertia=inertia,
        damping=(0.1 if motor else 0.3) * kc * tau * rng.random(),
        friction=0.0 if clean else kc * peak * 10.0 ** rng.uniform(-3.0, -1.5),
        gain=inertia * loop**2 if by_position else 0.0,
        gain_rate=1.4 * inertia * loop if by_position else 0.0,
        lag=rng.uniform(2e-4, 1e-3),
        stiffness=kc / share,
        loss=kc / share * tau,
        toe=toe,
        reach=peak * rng.uniform(0.2, 1.0),
        guide=kc * 5.0 / natural[1] ** 2 if guide else 0.0,
        beyond=beyond,
        beyond_loss=beyond * tau * rng.uniform(0.5, 1.5),
        rubbing=kc * peak * 10.0 ** rng.uniform(-3.0, -1.5),
        capstan=float(rng.choice([0.0, rng.uniform(0.02, 0.1)])),
        bristle=peak * 10.0 ** rng.uniform(-2.5, -1.5),
        fixture=cell / natural[2] ** 2,
        cell=cell,
        cell_loss=cell * rng.uniform(1e-5, 1e-4),
    )
    _, lowest, highest = MOTIONS[motion]
    rate = float(rng.choice([100.0, 200.0, 250.0, 500.0, 500.0, 1000.0]))
    return Drawn(
        seed,
        motion,
        motor,
        plant,
        peak=peak * (1.0 if by_position else min(1.0, 3.0 * tau * natural[0])),
        band=(rng.uniform(*lowest), min(rng.uniform(*highest), math.inf if motion == "steps" else 0.1 * rate)),
        rate=rate,
        commanded=motion != "hand" and bool(rng.random() < 0.6),
        python=bool(rng.random() < 0.5),
        delay=rng.uniform(0.0, 1.0) / rate,
        noise=10.0 ** rng.uniform(-3.7, -2.3),
        counts=10.0 ** rng.uniform(1.5, 4.0),
        corner=float(rng.choice([0.0, 0.0, rng.uniform(40.0, 400.0)])),
        both_filtered=bool(rng.random() < 0.5),
        gear=float(rng.choice([1.0, 4.0, 20.0])),
        wrong=1.0 if clean else 1.0 + 0.03 * rng.standard_normal(),
    )


def read(drawn: Drawn) -> tuple[Mapping[str, Array], str, str]:
    """Return the channels, the stand file ("" with a torque cell) and the mode of the command ("" without one)."""
    rng = np.random.default_rng([drawn.seed, len(drawn.motion), drawn.motor, 4711])
    plant, rate = drawn.plant, drawn.rate
    duration = min(rng.uniform(10.0, 20.0), MOST / rate)
    kind = MOTIONS[drawn.motion][0]
    bench = Bench(kind, peak=drawn.peak, band=drawn.band, duration=duration, rate=FINE / benches.FINER)
    wanted = benches.MOTIONS[kind](bench, rng).deflection * (1.0 if plant.gain else plant.truth[0])
    torque, angle = _moved(plant, wanted, drawn.motor, plant.truth[0] * drawn.peak)
    if drawn.corner:
        sections = butter(int(rng.integers(1, 3)), drawn.corner, fs=FINE, output="sos")
        torque, angle = sosfilt(sections, torque), sosfilt(sections, angle) if drawn.both_filtered else angle
    when = np.arange(round(duration * rate)) / rate
    stamp, fine = when, np.arange(len(wanted)) / FINE
    if drawn.python:
        late = rng.exponential(0.06, len(when)) + (rng.random(len(when)) < 2e-3) * rng.uniform(0.5, 2.5, len(when))
        when = np.maximum.accumulate(when + late / rate)
        when = when[np.diff(when, prepend=-1.0) > 0.1 / rate]  # what a stall delayed is read once
        stamp = when + 2e-5 * np.abs(rng.standard_normal(len(when)))
    torque, angle = _converted(drawn, rng, np.interp(when - drawn.delay, fine, torque), np.interp(when, fine, angle))
    channels = {"time": stamp - stamp[0], "torque": torque, "dtheta": angle}
    if drawn.motor:
        channels |= {"motor_torque": torque / drawn.gear, "motor_position": angle * drawn.gear}
    if drawn.commanded:
        channels["command"] = np.interp(when, fine, wanted)
    mode = "position" if plant.gain else "torque"
    return channels, _stand(drawn) if drawn.motor else "", mode if drawn.commanded else ""


def _moved(plant: Plant, command: Array, motor: bool, size: float) -> tuple[Array, Array]:
    """The torque (n,) N m of motor or cell and the motor's angle (n,) rad; size: N m, of the torque."""
    time, within = np.arange(len(command)) / FINE, [*[1e-9, 1e-7] * 3, 1e-6, 1e-8 * size]
    moved = odeint(_slope, np.zeros(8), time, (plant, command), rtol=1e-7, atol=within, hmax=1e-3, mxstep=10_000)
    if not np.isfinite(moved).all() or not np.abs(moved[-1]).any():
        raise ArithmeticError("the integration stopped")
    return moved[:, 7] if motor else plant.cell * moved[:, 4] + plant.cell_loss * moved[:, 5], moved[:, 0]


def _converted(drawn: Drawn, rng: np.random.Generator, torque: Array, angle: Array) -> tuple[Array, Array]:
    """Noise, a zero and counts: what the converters make of torque and angle."""
    peak = float(np.abs(torque).max())
    count, step = float(np.ptp(angle)) / drawn.counts, 0.5 * drawn.noise * peak
    torque = torque + drawn.noise * peak * rng.standard_normal(len(torque)) + 0.01 * peak * rng.standard_normal()
    return step * np.round(torque / step), count * np.round(angle / count + rng.random())


def _stand(drawn: Drawn) -> str:
    inertia, damping = (part * drawn.wrong / drawn.gear**2 for part in (drawn.plant.inertia, drawn.plant.damping))
    return (
        f'[stand]\nname = "drawn"\ngear_ratio = {drawn.gear}\ntorque_source = "motor"\n'
        f"motor_inertia = {inertia:.6g}\nmotor_damping = {damping:.6g}\n"
    )
