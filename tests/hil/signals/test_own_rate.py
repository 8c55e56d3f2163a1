"""A rate that a drive reports beside the deflection: used where it is the derivative, noticed where it is filtered."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, write
from hil.signals.inspection import inspect
from hil.signals.prepare import Signals, prepare
from hil.signals.rate.own_rate import is_difference, own_rate

TIME = np.arange(3000) / 500.0
KC, BC = 0.3, 3e-3


def moved() -> tuple[Array, Array]:
    phases = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 30)
    speeds = 2.0 * np.pi * np.geomspace(0.2, 12.0, 30)
    waves = 0.02 * np.exp(1j * (np.outer(TIME, speeds) + phases))
    return waves.real.sum(axis=1), (1j * speeds * waves).real.sum(axis=1)


ANGLE, RATE = moved()
NOISE = np.random.default_rng(1).standard_normal((2, len(TIME)))


def lagged(rate: Array, constant: float) -> Array:
    keep = math.exp(-(TIME[1] - TIME[0]) / constant)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], rate))


def delayed(rate: Array, delay: float) -> Array:
    return np.interp(TIME - delay, TIME, rate)


def read(path: Path, rate: Array | None, angle: Array = ANGLE) -> Signals:
    """The signals of a recording with that rate among its columns."""
    torque = KC * ANGLE + BC * RATE + 1e-3 * NOISE[0]
    channels = {"time": TIME, "torque": torque, "dtheta": angle} | ({} if rate is None else {"dtheta_dot": rate})
    write(path, Header(profile={}, stand_toml=""), channels)
    with Recording(path) as recording:
        return prepare(recording, None)


def fitted(signals: Signals) -> Array:
    """Kc and Bc by least squares."""
    columns = np.stack([signals.motion.dtheta, signals.motion.dtheta_dot, np.ones(len(signals))], axis=1)
    return np.asarray(np.linalg.lstsq(columns, signals.torque, rcond=None)[0][:2])


@pytest.mark.parametrize("late", [3e-3, 0.015])
def test_a_rate_that_is_late_is_noticed_with_its_lag(late: float) -> None:
    found = own_rate(TIME, delayed(RATE, late) + 0.01 * NOISE[1], RATE, 12.0)
    assert found is not None
    assert found.lag == pytest.approx(late, rel=0.05)
    assert found.size == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.5])
def test_noise_of_a_reported_rate_is_no_lag(noise: float) -> None:
    assert own_rate(TIME, RATE + noise * NOISE[1], RATE, 12.0) is None


@pytest.mark.study
def test_kc_and_bc_do_not_follow_the_filter_of_a_drive(tmp_path: Path) -> None:
    signals = read(tmp_path / "a.h5", lagged(RATE, 8e-3))
    (said,) = [one.message for one in inspect(tmp_path / "a.h5").diagnostics if one.code == "unused-rate"]
    assert "ms late and" in said
    assert signals.rate_window > 0.0
    assert fitted(signals) == pytest.approx([KC, BC], rel=0.01)


@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_a_rate_that_is_the_derivative_but_for_noise_that_the_torque_does_not_show_is_used(
    tmp_path: Path, noise: float
) -> None:
    signals = read(tmp_path / "a.h5", RATE + noise * NOISE[1])
    assert signals.refused_rate is None
    assert signals.rate_window == 0.0


@pytest.mark.parametrize(("noise", "step"), [(0.1, 0.0), (0.0, 0.4)])
def test_a_rate_with_noise_or_coarse_steps_gives_way_to_the_derivative(
    tmp_path: Path, noise: float, step: float
) -> None:
    """Noise in the rate lowers Bc by its share of the rate's power."""
    given = RATE + noise * NOISE[1]
    signals = read(tmp_path / "a.h5", step * np.round(given / step) if step else given)
    assert signals.refused_rate is not None
    assert "% more power" in signals.refused_rate.diagnostic().message
    assert signals.rate_window > 0.0
    assert fitted(signals)[1] == pytest.approx(BC, rel=0.01)


@pytest.mark.study
@pytest.mark.parametrize("count", [1e-4])
def test_a_rate_that_was_computed_from_differences_of_the_deflection_gives_way_without_a_word(
    tmp_path: Path, count: float
) -> None:
    """It has all noise of the deflection, and is wrong where the acceleration changes fast."""
    angle = count * np.round(ANGLE / count) if count else ANGLE
    without = read(tmp_path / "without.h5", None, angle)
    signals = read(tmp_path / "with.h5", np.gradient(angle, TIME), angle)
    np.testing.assert_array_equal(signals.motion.dtheta_dot, without.motion.dtheta_dot)
    assert signals.refused_rate is None


@pytest.mark.parametrize("shift", [0, 1, -1])
def test_differences_are_recognised_by_their_errors(shift: int) -> None:
    """Central ones, and those of the sample before and after, beside those of another reading of the same motion."""
    read = [ANGLE + 1e-4 * noise for noise in NOISE]
    quotients = np.diff(read[0]) / np.diff(TIME)
    rate = np.gradient(read[0], TIME) if shift == 0 else np.append(*((quotients[:1], quotients)[::shift]))
    assert is_difference(TIME, read[0], rate, RATE)
    assert not is_difference(TIME, read[1], rate, RATE)
    assert not is_difference(TIME, read[0], RATE, RATE)


def test_the_rate_is_not_compared_across_the_gaps_between_short_pieces() -> None:
    late = TIME + 0.5 * (np.arange(len(TIME)) // 100)
    assert own_rate(late, RATE, RATE + 1e-3 * NOISE[1], 12.0) is None
    found = own_rate(late, delayed(RATE, 0.004), RATE, 12.0)
    assert found is not None
    assert (found.lag, found.size) == pytest.approx((0.004, 1.0), abs=1e-5)
