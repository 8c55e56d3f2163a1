"""What residuals that follow each other do to an estimate, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil.identification.candidates.residual_spectrum import measure
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import confidence_intervals

Array = NDArray[np.float64]

SAMPLES = 10_000


def signs(correlation: float, seed: int, samples: int = SAMPLES) -> Array:
    """Of noise in which each sample keeps that part of the one before."""
    noise: Array = lfilter([1.0], [1.0, -correlation], np.random.default_rng(seed).standard_normal(samples))
    return np.sign(noise)


def power_of_slow_signs(correlation: float) -> float:
    lags = np.arange(1, 500)
    return float(1.0 + 2.0 * np.sum(2.0 / np.pi * np.arcsin(correlation**lags)))


def test_the_bands_hold_all_of_the_columns_and_all_of_the_signs() -> None:
    columns = np.random.default_rng(0).standard_normal((1001, 3))
    found = measure([(columns, signs(0.0, 1, 1001))])
    np.testing.assert_allclose(found.crossed.sum(axis=0), columns.T @ columns, rtol=1e-12, atol=1e-10)
    assert np.average(found.power, weights=found.lines) == pytest.approx(1.0, rel=1e-12)


def test_signs_that_do_not_follow_each_other_have_the_same_power_everywhere() -> None:
    found = measure([(np.ones((SAMPLES, 1)), signs(0.0, 2))])
    assert np.all(np.abs(found.power - 1.0) < 4.0 / np.sqrt(found.lines))


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_the_variance_of_a_slow_sum_is_the_closed_form(correlation: float) -> None:
    """For Gaussian noise of correlation r^k at lag k that of the signs is 2/pi arcsin(r^k); their sum is the power."""
    slow = np.sin(2.0 * np.pi * 3.0 * np.arange(SAMPLES) / SAMPLES)[:, None]
    all_left = [replace(measure([(slow, signs(correlation, seed))]), fitted=np.zeros(1)) for seed in range(40)]
    found = [one.covariance[0, 0] / (slow.T @ slow)[0, 0] for one in all_left]
    # a band that is quiet by chance counts as white
    assert np.mean(found) == pytest.approx(power_of_slow_signs(correlation), rel=0.25)


@pytest.mark.parametrize(
    ("line", "step"), [(1, 0.5), *(pytest.param(*one, marks=pytest.mark.study) for one in ((1, 0.0), (5, 0.06)))]
)
def test_a_zero_that_walks_makes_the_slowest_columns_the_least_certain(line: int, step: float) -> None:
    """The products of a column with a random walk add up to those of the walk's steps with the rest of the column."""
    slow, found = np.sin(2.0 * np.pi * line * np.arange(2500) / 2500), []
    for seed in range(40):
        white, steps = np.random.default_rng(seed).standard_normal((2, 2500))
        noise = white + step * np.cumsum(steps)
        spectrum = measure([(slow[:, None], noise - noise.mean())])
        found.append(replace(spectrum, fitted=np.zeros(1)).covariance[0, 0])
    real = slow @ slow + step**2 * np.sum(np.cumsum(slow[::-1]) ** 2)
    assert np.mean(found) / real > 0.35  # 0.15 by the mean of the lowest band, in the slowest line
    assert np.mean(found) / real < (1.5 if step == 0.0 else 6.0)  # no line counts for less than that mean


def test_what_a_fit_has_removed_of_a_band_is_not_missing_from_its_power() -> None:
    """An offset and two slow waves take five of the sixteen numbers that the lines of the lowest band have."""
    turns = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    slow = np.stack([np.ones(SAMPLES), *(wave(k * turns) for k in (1, 2) for wave in (np.cos, np.sin))], axis=1)
    found = []
    for seed in range(60):
        sign = signs(0.9, seed)
        left = sign - slow @ np.linalg.lstsq(slow, sign, rcond=None)[0]
        found.append(measure([(slow, left)]).covariance[0, 0] / SAMPLES)
    assert np.mean(found) == pytest.approx(power_of_slow_signs(0.9), rel=0.15)


def test_cutting_the_data_changes_nothing() -> None:
    columns, sign = np.random.default_rng(3).standard_normal((70_000, 2)), signs(0.5, 4, 70_000)
    whole = measure([(columns, sign)])
    parts = measure([(columns[a:b], sign[a:b]) for a, b in pairwise([0, 1, 40_000, 40_000, 69_999, 70_000])])
    np.testing.assert_array_equal(parts.covariance, whole.covariance)


def test_a_band_of_many_lines_is_told_with_as_many_degrees_of_freedom() -> None:
    white = np.random.default_rng(5).standard_normal((SAMPLES, 1))
    slow = np.ones((SAMPLES, 1))
    bread = np.eye(1)
    assert measure([(white, signs(0.0, 6))]).freedom(bread)[0] > 1000.0
    assert 8.0 < measure([(slow, signs(0.0, 6))]).freedom(bread)[0] < 20.0


def test_a_parameter_that_nothing_shows_has_as_many_degrees_of_freedom_as_one_that_much_does() -> None:
    """Its variance of 1e200 ended in a warning that a square overflows."""
    found, bread = measure([(np.random.default_rng(5).standard_normal((SAMPLES, 1)), signs(0.0, 6))]), np.eye(1)
    np.testing.assert_allclose(found.freedom(1e100 * bread), found.freedom(bread), rtol=1e-9)


def test_the_interval_of_what_a_few_samples_tell_is_as_sure_as_that_of_what_all_do() -> None:
    """The second column is there in a twentieth of the recording only, as a skew is at the fast end of a chirp.

    Blocks in time would have two of forty for its variance: an interval that is wrong by 50 %.
    """
    columns = np.random.default_rng(0).standard_normal((4000, 2))
    columns[:3800, 1] = 0.0
    halves = []
    for seed in range(60):
        torque = np.random.default_rng(1 + seed).standard_normal(4000)
        halves.append(confidence_intervals(Blocks.of(columns, torque), np.zeros(2)).half_width)
    found = np.array(halves)
    # of the second, a fifth of two hundred samples tell the density, one part in six
    assert np.all(found.std(axis=0) < np.array([0.06, 0.25]) * found.mean(axis=0))
    expected = 1.96 * np.sqrt(0.5 * np.pi / (columns**2).sum(axis=0))
    np.testing.assert_allclose(found.mean(axis=0), expected, rtol=0.1)
