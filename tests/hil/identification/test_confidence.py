"""The 95 % interval holds the truth 95 % of the time, for residuals that are white and for ones that are not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from ga.lad.exact import least_absolute_deviations, not_negative
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import confidence_intervals
from hil.identification.result import interval


def coverage(correlation: float, runs: int) -> tuple[float, float]:
    """The share of runs whose interval holds the truth, and the mean half-width over its expectation."""
    rng = np.random.default_rng(1)
    time = np.arange(1000) / 250.0
    columns = np.column_stack([np.sin(9 * time) + np.sin(40 * time), 9 * np.cos(9 * time) + 40 * np.cos(40 * time)])
    truth = np.array([0.018, 2e-4])
    held, halves, found = [], [], []
    for _ in range(runs):
        noise = lfilter([1.0], [1.0, -correlation], rng.standard_normal(len(time)))
        torque = columns @ truth + 2e-4 * noise
        genes = least_absolute_deviations(columns, torque).genes
        half = confidence_intervals(Blocks.of(columns, torque), genes).half_width
        held.append(np.abs(genes - truth) <= half)
        halves.append(half)
        found.append(genes)
    ratio = np.mean(halves, axis=0) / (1.96 * np.std(found, axis=0))
    return float(np.mean(held)), float(ratio.mean())


@pytest.mark.study
@pytest.mark.parametrize(("runs", "slack"), [(100, 0.25), pytest.param(400, 0.2, marks=pytest.mark.study)])
@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_the_interval_holds_the_truth_as_often_as_it_says(correlation: float, runs: int, slack: float) -> None:
    share, ratio = coverage(correlation, runs)
    chance = 3.0 * np.sqrt(0.95 * 0.05 / (2 * runs))
    assert 0.95 - chance <= share <= 0.97 + chance  # of a thousand rows the intervals are rather too wide
    assert 1.05 - slack <= ratio <= 1.05 + slack


def test_a_column_of_zeros_has_an_infinite_interval() -> None:
    rng = np.random.default_rng(0)
    columns = np.column_stack([rng.standard_normal(500), np.zeros(500)])
    intervals = confidence_intervals(Blocks.of(columns, columns[:, 0] + rng.standard_normal(500)), np.array([1.0, 0.0]))
    assert np.isfinite(intervals.half_width).tolist() == [True, False]


@pytest.mark.parametrize("near_zero_only", [False, True])
def test_dependent_columns_take_the_interval_from_their_own_parameters_only(near_zero_only: bool) -> None:
    """Dependent in all rows, or only in those of small residuals, on which the density is estimated."""
    rng = np.random.default_rng(0)
    columns, truth = rng.standard_normal((2000, 3)), np.array([1.0, 2.0, 3.0, 0.0])
    noise = rng.standard_normal(2000)
    twin = np.where(near_zero_only & (np.abs(noise) > 1.5), rng.standard_normal(2000), 2.0 * columns[:, 2])
    torque = columns @ truth[:3] + noise
    alone = confidence_intervals(Blocks.of(columns, torque), truth[:3])
    beside = confidence_intervals(Blocks.of(np.column_stack([columns, twin]), torque), truth)
    assert np.isfinite(beside.half_width).tolist() == [True, True, False, False]
    assert np.isfinite(beside.inflation).tolist() == [True, True, False, False]
    np.testing.assert_allclose(beside.half_width[:2], alone.half_width[:2], rtol=0.02)


def test_columns_that_look_alike_have_a_large_inflation() -> None:
    rng = np.random.default_rng(0)
    first = rng.standard_normal(500)
    columns = np.column_stack([first, first + 0.05 * rng.standard_normal(500)])
    intervals = confidence_intervals(Blocks.of(columns, first + rng.standard_normal(500)), np.array([1.0, 0.0]))
    assert intervals.inflation.min() > 100.0
    apart = confidence_intervals(Blocks.of(rng.standard_normal((500, 2)), rng.standard_normal(500)), np.zeros(2))
    assert apart.inflation.max() < 1.1


@pytest.mark.parametrize("truth", [(1.0, 2.0), (0.0, 0.0)])
def test_residuals_that_are_all_zero_leave_an_interval_of_nothing(truth: tuple[float, float]) -> None:
    """Of a torque of zero too, as in the half of a recording in which its sensor was unplugged."""
    columns = np.random.default_rng(0).standard_normal((500, 2))
    intervals = confidence_intervals(Blocks.of(columns, columns @ truth), np.array(truth))
    assert np.all(intervals.half_width < 1e-12)


def test_data_in_blocks_give_the_interval_of_data_in_one() -> None:
    rng = np.random.default_rng(0)
    columns, truth = rng.standard_normal((5000, 2)), np.array([1.0, 2.0])
    torque = columns @ truth + rng.standard_normal(5000)
    whole = confidence_intervals(Blocks.of(columns, torque), truth)
    cuts = [0, 1, 17, 1000, 1001, 4200, 5000]
    parts = confidence_intervals(
        Blocks(len(torque), lambda: [(columns[a:b], torque[a:b]) for a, b in pairwise(cuts)]), truth
    )
    np.testing.assert_allclose(parts.half_width, whole.half_width, rtol=1e-9)
    np.testing.assert_allclose(parts.inflation, whole.inflation, rtol=1e-9)


@pytest.mark.parametrize("true", [0.0, 1.0])
def test_the_interval_that_is_cut_at_zero_holds_a_damping_of_zero_or_just_above(true: float) -> None:
    """true: in standard errors of the damping. The value is never negative, and always in its interval."""
    time = np.arange(500) / 250.0
    angle, rate = 0.2 * np.sin(9.0 * time) + 0.1 * np.sin(31.0 * time), 1.8 * np.cos(9.0 * time)
    rate += 3.1 * np.cos(31.0 * time)
    columns = np.stack([angle, rate, np.ones(500)], axis=1)
    damping = true * np.sqrt(0.5 * np.pi) / np.linalg.norm(rate)  # noise of 1: the median's error
    held = np.zeros(30, dtype=bool)
    for seed in range(len(held)):
        torque = columns @ np.array([50.0, damping, 0.0]) + np.random.default_rng([seed, 7]).standard_normal(500)
        values = not_negative(columns, torque, (0, 1)).genes
        half = confidence_intervals(Blocks.of(columns, torque), values).half_width
        low, high = interval(float(values[1]), float(half[1]), positive=True)
        assert 0.0 <= low <= values[1] <= high
        held[seed] = low <= damping <= high
    assert held.mean() >= 0.9
