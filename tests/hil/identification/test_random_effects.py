"""Between and within, held against closed forms and against draws from the model itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, linregress, t

from hil.identification.verdict.random_effects import between, drift, is_outside
from hil.recording.reader import Array


def test_with_equal_errors_the_variances_are_those_of_the_analysis_of_variance() -> None:
    values, error = np.array([1.0, 1.4, 0.7, 1.9, 1.1]), 0.2
    pooled = between(values, np.full(5, error))
    scatter = float(np.var(values, ddof=1))
    assert pooled.value == pytest.approx(values.mean())
    assert pooled.between == pytest.approx(math.sqrt(scatter - error**2))
    assert pooled.within == pytest.approx(error)
    assert pooled.standard_error == pytest.approx(math.sqrt(scatter / 5))
    half = t.ppf(0.975, 4) * math.sqrt(scatter / 5)
    assert pooled.ci95 == pytest.approx((values.mean() - half, values.mean() + half))
    assert pooled.p_alike == pytest.approx(chi2.sf(4 * scatter / error**2, 4))
    ends = [math.sqrt(4 * scatter / chi2.ppf(tail, 4) - error**2) for tail in (0.975, 0.025)]
    assert pooled.between_ci95 == pytest.approx(ends)


def test_measurements_that_agree_are_weighted_by_their_errors_and_nothing_lies_between() -> None:
    values, errors = np.array([1.0, 1.01]), np.array([0.1, 0.2])
    pooled = between(values, errors)
    assert pooled.between == pooled.between_ci95[0] == 0.0
    assert pooled.value == pytest.approx((1.0 / 0.01 + 1.01 / 0.04) / 125.0)
    assert pooled.standard_error == pytest.approx(1.0 / math.sqrt(125.0))
    assert pooled.p_alike > 0.9


def test_luck_does_not_make_an_interval_narrower_than_the_errors_allow() -> None:
    pooled = between(np.array([1.0, 1.0, 1.0]), np.full(3, 0.3))
    assert pooled.ci95[1] - pooled.value == pytest.approx(1.959964 * 0.3 / math.sqrt(3))


def test_a_wild_measurement_is_not_outvoted_by_its_small_error_once_something_lies_between() -> None:
    """Far apart, everyone counts nearly the same: the mean moves to the plain one."""
    values, errors = np.array([0.0, 100.0]), np.array([0.1, 1.0])
    assert between(values, errors).value == pytest.approx(50.0, rel=0.01)


def test_a_change_of_unit_changes_nothing_but_the_unit() -> None:
    values, errors = np.array([1.0, 1.4, 0.7]), np.array([0.1, 0.2, 0.1])
    large, small = between(values, errors), between(values * 1e-6, errors * 1e-6)
    assert small.between == pytest.approx(large.between * 1e-6)
    assert small.ci95 == pytest.approx(tuple(end * 1e-6 for end in large.ci95))
    assert small.p_alike == pytest.approx(large.p_alike)


def test_measurements_a_million_errors_apart_are_pooled_all_the_same() -> None:
    values = np.array([-1.0, 1.0, 0.0])
    assert between(values, np.full(3, 1e-6)).between == pytest.approx(1.0, rel=1e-9)


@pytest.mark.study
@pytest.mark.parametrize(("count", "ratio"), [(2, 0.0), (2, 3.0), (4, 1.0)])
def test_the_intervals_cover_with_few_recordings(count: int, ratio: float) -> None:
    """95 % of 100 draws is 95 with a standard deviation of 2.2."""
    rng = np.random.default_rng([count, int(ratio)])
    held = covered = 0
    for _ in range(100):
        errors = rng.uniform(0.5, 1.5, count)
        values = 7.0 + ratio * rng.standard_normal(count) + errors * rng.standard_normal(count)
        pooled = between(values, errors)
        held += pooled.ci95[0] <= 7.0 <= pooled.ci95[1]
        covered += pooled.between_ci95[0] <= ratio <= pooled.between_ci95[1]
    assert held >= 88
    assert covered >= 88


def test_a_drift_with_equal_errors_is_the_line_of_least_squares() -> None:
    times = np.array([0.0, 1.0, 2.5, 3.0, 5.0]) * 3600.0
    values = np.array([1.0, 1.3, 1.2, 1.6, 1.9])
    found, line = drift(times, values, np.full(5, 0.01)), linregress(times, values)
    assert found.slope == pytest.approx(line.slope)
    assert found.p == pytest.approx(line.pvalue)
    half = t.ppf(0.975, 3) * line.stderr
    assert found.ci95 == pytest.approx((line.slope - half, line.slope + half))


def test_a_drift_is_found_by_chance_no_more_often_than_it_says() -> None:
    rng = np.random.default_rng(3)
    times = np.arange(5.0)
    found = [drift(times, rng.standard_normal(5), rng.uniform(0.5, 1.0, 5)).p < 0.05 for _ in range(100)]
    assert sum(found) <= 11  # 5 expected, three standard deviations above


def test_a_line_that_fits_by_luck_is_not_called_certain() -> None:
    assert drift(np.arange(3.0), np.array([1.0, 1.1, 1.2]), np.full(3, 1.0)).p > 0.8


@pytest.mark.parametrize(
    ("values", "errors", "said"),
    [
        ([1.0], [0.1], "add more"),
        ([1.0, 2.0], [0.1], "standard errors"),
        ([1.0, 2.0], [0.1, 0.0], "above zero"),
        ([1.0, 2.0], [0.1, math.inf], "finite"),
        ([1.0, math.nan], [0.1, 0.1], "finite"),
    ],
)
def test_what_cannot_be_pooled_is_refused(values: list[float], errors: list[float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        between(np.array(values), np.array(errors))


def test_a_drift_needs_three_measurements_at_different_times() -> None:
    ones: Array = np.ones(2)
    with pytest.raises(ValueError, match="add more"):
        drift(np.arange(2.0), ones, ones)
    with pytest.raises(ValueError, match="same time"):
        drift(np.zeros(3), np.ones(3), np.ones(3))


@pytest.mark.parametrize(("value", "outside"), [(1.3, True), (1.03, False)])
def test_a_measurement_is_outside_where_the_others_do_not_predict_it(value: float, *, outside: bool) -> None:
    others = np.array([1.0, 1.01, 1.02, 0.99])
    assert is_outside(value, others, 1e-3) is outside
    assert not is_outside(1.3, 10.0 * (others - 1.0) + 1.0, 1e-3)  # they differ as much
