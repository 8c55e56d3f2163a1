"""Averages over models: each submodel equals its refit, and the interval holds the truth beside small effects."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from ga.arrays import Array
from hil.identification.mixture.model_average import AKAIKE, average, without_positive

NOISE = 0.3
AS_RULE = {2: AKAIKE, 3: AKAIKE}
SELDOM = {2: 8.0, 3: 8.0}
NOTHING = np.stack([np.zeros(4), np.full(4, np.inf)])


def regression(seed: int, truth: tuple[float, ...] = (2.0, 1.0, 0.02, 0.0)) -> tuple[Array, Array]:
    """Four columns that resemble each other, (200, 4), and a torque with noise."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((200, 4)) + rng.standard_normal((200, 1))
    return columns, columns @ np.array(truth) + NOISE * rng.standard_normal(200)


def fitted(columns: Array, torque: Array) -> tuple[Array, Array]:
    """The least-squares estimates and their covariance."""
    covariance = NOISE**2 * np.linalg.inv(columns.T @ columns)
    return np.asarray(covariance @ columns.T @ torque / NOISE**2), np.asarray(covariance)


def test_the_average_is_that_of_refits_of_every_submodel_weighted_by_akaike() -> None:
    columns, torque = regression(1)
    found = average(*fitted(columns, torque), AS_RULE, [], NOTHING)
    assert found is not None
    refits, errors, criteria = [], [], []
    for left_out in [part for count in range(3) for part in combinations((2, 3), count)]:
        kept = [at for at in range(4) if at not in left_out]
        values, covariance = fitted(columns[:, kept], torque)
        refits.append(np.zeros(4))
        refits[-1][kept] = values
        errors.append(np.zeros(4))
        errors[-1][kept] = np.diag(covariance)
        criteria.append(np.sum((torque - columns[:, kept] @ values) ** 2) / NOISE**2 + 2.0 * len(kept))
    weights = np.exp(-0.5 * (np.array(criteria) - min(criteria)))
    weights /= weights.sum()
    mean = weights @ np.array(refits)
    np.testing.assert_allclose(found.weights, weights, rtol=1e-6)
    np.testing.assert_allclose(found.values, mean, rtol=1e-9)
    variance = weights @ (np.array(errors) + (np.array(refits) - mean) ** 2)
    np.testing.assert_allclose(found.errors, np.sqrt(variance), rtol=1e-9)


def test_a_scale_gives_the_estimate_of_ridge_regression() -> None:
    columns, torque = regression(2)
    found = average(*fitted(columns, torque), {}, [], np.array([[0.0, 0.0, 0.5, 0.0], [np.inf, np.inf, 0.01, np.inf]]))
    assert found is not None
    precision = columns.T @ columns / NOISE**2 + np.diag([0.0, 0.0, 0.01**-2, 0.0])
    pulled = columns.T @ torque / NOISE**2 + np.array([0.0, 0.0, 0.5 * 0.01**-2, 0.0])
    np.testing.assert_allclose(found.values, np.linalg.solve(precision, pulled), rtol=1e-9)
    np.testing.assert_allclose(found.errors, np.sqrt(np.diag(np.linalg.inv(precision))), rtol=1e-9)


def test_a_model_with_a_negative_parameter_is_not_among_them() -> None:
    columns, torque = regression(3, (2.0, 1.0, -1.0, 0.0))
    values, covariance = fitted(columns, torque)
    found = average(values, covariance, AS_RULE, [2], NOTHING)
    assert found is not None
    assert all(2 in left_out for left_out in found.left_out)
    assert average(values, covariance, {3: AKAIKE}, [2], NOTHING) is None


@pytest.mark.parametrize("last", [-0.5, 0.0, 0.7])
def test_what_a_parameter_hides_that_is_positive_and_limited_is_that_of_draws(last: float) -> None:
    """Bayes' theorem by importance sampling: a flat prior of the others, half a normal one of the last."""
    columns, torque = regression(4, (2.0, 1.0, 0.0, 0.0))
    columns[:, 3] *= 0.05  # hardly seen: its standard error is about its likely size
    values, covariance = fitted(columns, torque)
    values += covariance[:, 3] / covariance[3, 3] * (last - values[3])
    found, matrix, criterion = without_positive(values, covariance, np.column_stack([NOTHING[:, :3], [0.0, 0.4]]))
    draws = np.random.default_rng(1).multivariate_normal(values, covariance, 100_000)
    weights = np.where(draws[:, 3] > 0.0, np.exp(-0.5 * (draws[:, 3] / 0.4) ** 2), 0.0)
    mean = weights @ draws[:, :3] / weights.sum()
    spread = (draws[:, :3] - mean).T @ ((draws[:, :3] - mean) * weights[:, None]) / weights.sum()
    size, known = np.sqrt(np.diag(matrix)), 0.4**2 / (0.4**2 + covariance[3, 3])
    assert (found - mean) / size == pytest.approx(np.zeros(3), abs=0.05)
    assert np.sqrt(np.diag(spread)) == pytest.approx(size, rel=0.05)
    assert criterion == pytest.approx(2.0 * known - known * max(last, 0.0) ** 2 / covariance[3, 3])


def test_a_bounded_parameter_is_refitted_without_its_column_where_it_would_be_negative() -> None:
    columns, torque = regression(3, (2.0, -0.1, 0.02, 0.0))
    values, covariance = fitted(columns, torque)
    found = average(values, covariance, AS_RULE, [], NOTHING, bounded=[0, 1])
    free = average(values, covariance, AS_RULE, [], NOTHING)
    assert found is not None
    assert free is not None
    assert free.values[1] < 0.0 == found.values[1]
    assert found.errors[1] > 0.5 * free.errors[1]
    both = average(*fitted(columns[:, [0, 2, 3]], torque), {1: AKAIKE, 2: AKAIKE}, [], NOTHING[:, :3])
    assert both is not None
    np.testing.assert_allclose(found.values[[0, 2, 3]], both.values, rtol=1e-9)


@pytest.mark.parametrize("costs", [AS_RULE, SELDOM])
@pytest.mark.parametrize("small", [0.0, 0.1])
def test_the_interval_holds_a_parameter_beside_a_small_effect_that_selection_leaves_out(
    small: float, costs: dict[int, float]
) -> None:
    """100 runs: 95 % lies within 6.5 % at three standard deviations; the significant model alone holds far fewer."""
    averaged, selected = [], []
    for seed in range(100):
        columns, torque = regression(seed, (2.0, 1.0, small, 0.0))
        values, covariance = fitted(columns, torque)
        found = average(values, covariance, costs, [], NOTHING)
        assert found is not None
        averaged.append(abs(found.values[0] - 2.0) < 1.96 * found.errors[0])
        without, narrow = fitted(columns[:, :2], torque)
        selected.append(abs(without[0] - 2.0) < 1.96 * np.sqrt(narrow[0, 0]))
    assert np.mean(averaged) >= 0.88
    assert small < 0.05 or np.mean(selected) < 0.9


def test_noise_that_looks_like_a_parameter_moves_the_value_little_where_that_is_seldom_there() -> None:
    """Of 300 runs the 10 in which the noise looks most like it: Akaike's average has followed it most of the way."""
    runs = [fitted(*regression(seed, (2.0, 1.0, 0.0, 0.0))) for seed in range(300)]
    runs.sort(key=lambda run: -abs(run[0][2]) / run[1][2, 2] ** 0.5)
    as_rule, seldom = ([average(*run, costs, [], NOTHING) for run in runs[:10]] for costs in (AS_RULE, SELDOM))
    for one, other in zip(as_rule, seldom, strict=True):
        assert one is not None
        assert other is not None
        assert other.errors[0] ** 2 == pytest.approx(one.errors[0] ** 2 + (one.values[0] - other.values[0]) ** 2)
    followed, drawn = (
        np.median([abs(one.values[2]) for one in found if one is not None]) for found in (as_rule, seldom)
    )
    assert drawn < 0.5 * followed


def test_a_parameter_of_which_the_data_say_nothing_is_known_by_its_likely_size() -> None:
    """Rounding would leave nothing of its variance: the data's is 1e18 times as large."""
    likely = np.array([[0.0, 0.0], [np.inf, 1e-9]])
    values, matrix, criterion = without_positive(np.array([1.0, 0.5]), np.diag([0.01, 1.0]), likely)
    assert (values[0], matrix[0, 0], criterion) == pytest.approx((1.0, 0.01, 0.0), abs=1e-6)
