"""The sources of recordings of the truth study, which share nothing: simulated stand, closed form and MuJoCo.

`simulated` runs a servo through the recorder, as `hil record` does. `closed_form` writes down what would have been
read, `mujoco` what would have been read of MuJoCo's joint. The same case and seed give the same samples.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import truth_mujoco
from truth_cases import (
    GEAR,
    MOTOR_DAMPING,
    MOTOR_INERTIA,
    NOISE,
    RATE,
    SAMPLES,
    Array,
    Case,
    coupling_torque,
    simulated_tables,
)
from truth_mujoco import Driven

from drivers.clock import Clock
from drivers.servo import Command, Limits, Quantity, Sample, Servo, ServoInfo, Status
from hil.acquisition.excitation import make
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.recorder import Recorder, tick_count
from hil.recording.writer import Header, RecordingWriter, write
from hil.stand.file import parse
from hil.stand.opening import open_servo

OUTLIER = 20e-3  # N m


def rng_of(case: Case, seed: int) -> np.random.Generator:
    """The generator of one case and seed, which no other case shares."""
    return np.random.default_rng([seed, zlib.crc32(case.name.encode())])


def stand_text(case: Case, tables: Mapping[str, Mapping[str, float | bool]]) -> str:
    """A stand file with these tables below [sim]."""
    lines = [
        "[stand]",
        f'name = "truth study, {case.name}"',
        'backend = "sim"',
        f"gear_ratio = {GEAR}",
        f"motor_inertia = {MOTOR_INERTIA}",
        f"motor_damping = {MOTOR_DAMPING}",
        f'torque_source = "{"motor" if case.motor_side else "joint"}"',
        "[limits]\ntorque = 0.08\ndeflection = 1.0\nvelocity = 100.0\ntemperature = 80.0",
    ]
    for name, keys in tables.items():
        lines.append(f"[sim.{name}]")
        lines += [f"{key} = {str(value).lower()}" for key, value in keys.items()]
    return "\n".join(lines) + "\n"


class Spiked:
    """A servo whose torque cell is now and then wrong by 20 mN m, which the simulator has no parameter for."""

    def __init__(self, servo: Servo, share: float, rng: np.random.Generator) -> None:
        self._servo = servo
        self._share = share
        self._rng = rng

    @property
    def info(self) -> ServoInfo:
        return self._servo.info

    @property
    def clock(self) -> Clock:
        return self._servo.clock

    def arm(self, limits: Limits) -> None:
        self._servo.arm(limits)

    def exchange(self, command: Command) -> Sample:
        sample = self._servo.exchange(command)
        if self._rng.random() >= self._share:
            return sample
        spike = OUTLIER if self._rng.random() < 0.5 else -OUTLIER
        return Sample(
            **{name: getattr(sample, name) for name in Sample.__slots__ if name != "joint_torque"},
            joint_torque=sample.joint_torque + spike,
        )

    def disarm(self) -> None:
        self._servo.disarm()

    def close(self) -> None:
        self._servo.close()


def simulated(case: Case, number: int, path: Path) -> None:
    """Record the case on the simulated stand. Raises RuntimeError where the run does not come to its end.

    Each case has noise of its own: one rare draw in all of them would count as often as there are cases.
    """
    seed = int(rng_of(case, number).integers(1 << 31))
    text = stand_text(case, simulated_tables(case))
    stand = parse(text)
    profile = make(
        "chirp",
        Quantity.TORQUE if case.motor_side else Quantity.POSITION,
        amplitude=case.sim_amplitude,
        default_amplitude=case.sim_amplitude,
        duration=(SAMPLES - 1) / RATE,
        band=case.band,
        rate=RATE,
        fade=case.sim_soft,
    )
    servo, truth = open_servo(stand, seed=seed, realtime=False)
    if case.outliers:
        servo = Spiked(servo, case.outliers, rng_of(case, number))
    header = Header(profile=profile.attributes() | {"rate": RATE}, stand_toml=text, truth=truth, seed=seed)
    try:
        with RecordingWriter(path, header, tick_count(profile, RATE)) as part:
            outcome = Recorder(stand, servo, profile, RATE, part).run(StopRequest())
            part.finish(outcome.end_reason)
    finally:
        servo.close()
    if outcome.end_reason != "done":
        raise RuntimeError(f"{case.name}, seed {number}: the run ended with {outcome.end_reason}")


def closed_form(case: Case, seed: int, path: Path) -> None:
    """Write the case from its closed form."""
    write(path, _header(case, seed), closed_form_channels(case, rng_of(case, seed)))


def mujoco(case: Case, seed: int, path: Path) -> None:
    """Write what sensors read of MuJoCo's joint. Raises ValueError for a case that it has no parameter for."""
    channels = closed_form_channels(case, rng_of(case, seed), truth_mujoco.driven(case))
    write(path, _header(case, seed, "MuJoCo"), channels)


def _header(case: Case, seed: int, source: str = "closed form") -> Header:
    profile: dict[str, str | float] = {"kind": "prescribed", "band_low": case.band[0], "band_high": case.band[1]}
    truth = {name: float(getattr(case.truth, name)) for name in ("Kc", "Bc", *case.free)}
    return Header(
        profile=profile,
        stand_toml=stand_text(case, {}) if case.motor_side else "",
        truth=truth,
        seed=seed,
        operator_note=f"{source}, {case.name}",
    )


def closed_form_channels(case: Case, rng: np.random.Generator, driven: Driven | None = None) -> dict[str, Array]:
    """What would have been read, (n,) each: torque with noise, outliers and skew; angle in counts; stamps with jitter.

    driven: how the joint moved and what its coupling carried; None: as the closed form of the case says.
    A lost sample keeps its row, as the recorder keeps it: no value, and a status that says so.
    """
    planned = np.arange(SAMPLES) / RATE
    time = planned + case.jitter * rng.standard_normal(SAMPLES)
    stamp = time + case.jitter * rng.standard_normal(SAMPLES)
    joint = driven or case
    motion = joint.motion(time)
    noise = NOISE * rng.standard_normal(SAMPLES)
    hit = rng.random(SAMPLES) < case.outliers
    spikes = np.where(hit, OUTLIER * rng.choice([-1.0, 1.0], SAMPLES), 0.0)
    angle = _counted(motion.deflection, case.position_lsb)
    if case.stands_still:
        angle = angle + case.position_lsb * rng.integers(-1, 2, SAMPLES)
    channels = {"time": planned, "read_time": stamp, "dtheta": angle}
    if case.motor_side:
        shaft = MOTOR_INERTIA * GEAR * motion.acceleration + MOTOR_DAMPING * GEAR * motion.rate  # equation 1
        shaft += coupling_torque(motion, case.truth) / GEAR + noise / GEAR
        channels |= {"motor_torque": shaft, "motor_position": angle * GEAR, "torque": shaft * GEAR}
    else:
        channels["torque"] = joint.torque(time) + noise + spikes
    lost = rng.random(SAMPLES) < case.lost
    for name, values in channels.items():
        if name != "time":
            channels[name] = np.where(lost, np.nan, values)
    return channels | {"status": np.where(lost, float(Status.NO_REPLY), 0.0)}


def _counted(angle: Array, lsb: float) -> Array:
    return np.round(angle / lsb) * lsb if lsb else angle


SOURCES: Mapping[str, Callable[[Case, int, Path], None]] = {
    "simulator": simulated,
    "closed form": closed_form,
    "MuJoCo": mujoco,
}


def can_make(source: str, case: Case) -> bool:
    """Return whether a source can make the recordings of a case."""
    return source != "MuJoCo" or case.name not in truth_mujoco.WITHOUT
