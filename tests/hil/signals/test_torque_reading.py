"""What was done to the readings of a torque, seen from them: named with its size, and not where nothing was done."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.signal import butter, lfilter, resample

from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, write
from hil.signals.prepare import prepare
from hil.signals.torque_reading import seen_in_torque

STEP = 2e-3
FINE = 10  # points a sample
TIME = np.arange(45_000) * STEP / FINE
LONGEST = 0.02

Reading = Callable[[Array, np.random.Generator], Array]
"""What is logged every 2 ms of a torque on the fine grid."""


def moved() -> Array:
    phases = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 30)
    speeds = 2.0 * np.pi * np.geomspace(0.2, 12.0, 30)
    return np.asarray(0.02 * np.exp(1j * (np.outer(TIME, speeds) + phases)).real.sum(axis=1))


ANGLE = moved()
TORQUE = 0.3 * ANGLE + 3e-3 * np.gradient(ANGLE, TIME)


def plain(torque: Array, rng: np.random.Generator) -> Array:
    return torque[::FINE] + 1e-3 * rng.standard_normal(len(torque) // FINE)


def quiet(torque: Array, rng: np.random.Generator) -> Array:
    return torque[::FINE] + 1e-4 * rng.standard_normal(len(torque) // FINE)


def mean(count: int) -> Reading:
    return lambda torque, rng: lfilter(np.full(count, 1.0 / count), [1.0], plain(torque, rng))


def median(count: int) -> Reading:
    def read(torque: Array, rng: np.random.Generator) -> Array:
        before = np.pad(plain(torque, rng), (count - 1, 0), mode="edge")
        return np.median(np.lib.stride_tricks.sliding_window_view(before, count), axis=1)

    return read


def resampled(curve: Callable[[Array, Array], Callable[[Array], Array]], hertz: float) -> Reading:
    def read(torque: Array, rng: np.random.Generator) -> Array:
        at = np.arange(-0.01, TIME[-1] + 0.05, 1.0 / hertz)
        readings = np.interp(at, TIME, torque) + 1e-3 * rng.standard_normal(len(at))
        return np.asarray(curve(at, readings)(TIME[::FINE]))

    return read


def by_fourier(torque: Array, rng: np.random.Generator) -> Array:
    """A cell of 100 Hz, resampled by its spectrum."""
    readings = torque[:: 5 * FINE] + 1e-3 * rng.standard_normal(len(torque) // (5 * FINE))
    return np.asarray(resample(readings, 5 * len(readings)))


def late(delay: float) -> Reading:
    return lambda torque, rng: plain(np.interp(TIME - delay, TIME, torque), rng)


def low_passed(order: int) -> Reading:
    return lambda torque, rng: lfilter(*butter(order, 40.0 / 250.0), plain(torque, rng))


def seen(path: Path, reading: Reading, angle: Array = ANGLE, torque: Array = TORQUE) -> str:
    torque = np.asarray(reading(torque, np.random.default_rng(3)))
    channels = {"time": TIME[::FINE], "torque": torque, "dtheta": angle[::FINE]}
    write(path, Header(profile={}, stand_toml=""), channels)
    with Recording(path) as recording:
        return seen_in_torque(prepare(recording, None), LONGEST)


SEEN: dict[str, tuple[Reading, str]] = {
    "mean of 20": (mean(20), "multiples of 25 Hz: each reading is the mean of 20 and 19 ms late"),
    "spline of 80 Hz": (resampled(CubicSpline, 80.0), "a smooth curve joins the readings of a cell"),
    "spectrum of 100 Hz": (by_fourier, "the torque has nothing above 5"),
    "median of 21": (median(21), "typical of a median filter"),
    "30 ms late": (late(0.03), "a model corrects at most 20 ms"),
}


@pytest.mark.parametrize("name", SEEN)
def test_what_was_done_to_the_torque_is_named(tmp_path: Path, name: str) -> None:
    reading, said = SEEN[name]
    assert said in seen(tmp_path / "a.h5", reading)


UNSEEN: dict[str, Reading] = {
    "9 ms late": late(9e-3),
    "Butterworth of order 4": low_passed(4),
    "a cell of 80 Hz, held": lambda torque, rng: np.repeat(plain(torque, rng)[::6], 6)[: len(torque) // FINE],
}


@pytest.mark.parametrize("name", UNSEEN)
def test_nothing_is_named_that_was_not_done(tmp_path: Path, name: str) -> None:
    assert seen(tmp_path / "a.h5", UNSEEN[name]) == ""


def test_a_piecewise_cubic_is_no_mean(tmp_path: Path) -> None:
    assert "mean" not in seen(tmp_path / "a.h5", resampled(PchipInterpolator, 50.0))


def ringing(hertz: float) -> tuple[Array, Array]:
    """Angle and torque of a joint with dry friction whose drive rings at `hertz` after each set-point."""
    rng, level, at = np.random.default_rng(7), np.zeros(len(TIME)), 0
    while at < len(TIME):
        level[at:] = rng.uniform(-0.2, 0.2)
        at += int(rng.uniform(0.15, 0.21) * FINE / STEP)
    pole = np.exp((-0.2 + 1j) * 2.0 * np.pi * hertz * STEP / FINE)
    drive = np.poly([pole, pole.conj()]).real
    angle = lfilter([drive.sum()], drive, level)
    rate = np.gradient(angle, TIME)
    return angle, 0.3 * angle + 3e-3 * rate + 0.02 * np.tanh(rate / 5e-3)


@pytest.mark.parametrize("half", [20])
def test_friction_that_turns_every_so_many_readings_is_no_mean_of_these(tmp_path: Path, half: int) -> None:
    """Its torque lacks the multiples of one frequency, as the direction of the motion does."""
    assert seen(tmp_path / "a.h5", plain, *ringing(0.5 / (half * STEP))) == ""


@pytest.mark.parametrize(("held", "hertz"), [(20, 80.0)])
def test_torque_of_a_ripple_too_fast_to_be_sampled_is_no_mean(tmp_path: Path, held: int, hertz: float) -> None:
    """The set-points of a drive are held for so many readings: motion and torque lack the multiples of that pace."""
    growth, count = np.log(40.0) / TIME[-1], 2.0 * np.pi / 2**15
    aimed = 0.2 * np.sin(2.0 * np.pi * 0.3 * np.expm1(growth * TIME) / growth)
    pole = 1.0 - 2.0 * np.pi * hertz * STEP / FINE
    held_points = np.repeat(aimed[:: held * FINE], held * FINE)[: len(TIME)]
    angle = lfilter([(1.0 - pole) ** 2], np.poly([pole, pole]), held_points)
    torque = 0.3 * angle + 3e-3 * np.gradient(angle, TIME)
    assert seen(tmp_path / "a.h5", quiet, count * np.round(angle / count), torque) == ""
