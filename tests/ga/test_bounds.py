from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ga.bounds import PAPER_BOUNDS, Bounds, bounds_from_data
from ga.lad.exact import least_absolute_deviations


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        ([0.0, 2.0], [1.0, 1.0], "bounds of Bc: 2 is not below 1"),
        ([0.0, 1.0], [1.0, 1.0], "bounds of Bc: 1 is not below 1"),
        ([0.0, np.nan], [1.0, 1.0], "bounds of Bc: nan to 1 is not finite"),
        ([-np.inf, 0.0], [1.0, 1.0], "bounds of Kc: -inf to 1 is not finite"),
    ],
)
def test_bounds_that_are_no_range_are_refused_by_the_parameters_name(
    low: list[float], high: list[float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Bounds(np.array(low), np.array(high), ("Kc", "Bc"))


def test_without_names_the_message_counts_the_parameters() -> None:
    with pytest.raises(ValueError, match="bounds of parameter 1"):
        Bounds(np.array([0.0, 2.0]), np.array([1.0, 1.0]))


def test_bounds_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="one low and one high"):
        Bounds(np.array([0.0]), np.array([1.0, 2.0]))


def test_the_bounds_keep_their_own_copy() -> None:
    low = np.zeros(1)
    bounds = Bounds(low, np.ones(1))
    low[0] = 7.0
    assert bounds.low[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        bounds.high[0] = 3.0


def test_a_gene_at_a_bound_is_said_to_be_there() -> None:
    bounds = Bounds(np.zeros(4), np.full(4, 10.0))
    assert bounds.at_bound(np.array([0.0005, 5.0, 9.9995, 11.0])) == ("low", None, "high", "high")


def test_the_papers_bounds_hold_the_papers_joint_far_inside() -> None:
    assert PAPER_BOUNDS.at_bound(np.array([17.75e-3, 0.19e-3])) == (None, None)


@settings(max_examples=60)
@given(
    n=st.integers(1, 200),
    p=st.integers(1, 5),
    noise=st.sampled_from([0.0, 1e-3, 1.0, 30.0]),
    scales=st.lists(st.integers(-6, 6), min_size=5, max_size=5),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_bounds_from_the_data_hold_an_exact_optimum(
    n: int, p: int, noise: float, scales: list[int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(n, p)) * 10.0 ** np.array(scales[:p])
    torque = columns @ rng.normal(size=p) + noise * rng.standard_cauchy(n)
    bounds, optimum = bounds_from_data(columns, torque), least_absolute_deviations(columns, torque)
    assert not optimum.unique or bounds.at_bound(optimum.genes) == (None,) * p


def test_the_bounds_move_with_the_units() -> None:
    rng = np.random.default_rng(0)
    columns, torque = rng.normal(size=(100, 2)), rng.normal(size=100)
    one, other = bounds_from_data(columns, torque), bounds_from_data(columns * [1e-4, 1e3], torque)
    assert other.low * [1e-4, 1e3] == pytest.approx(one.low, rel=1e-9)
    assert other.high * [1e-4, 1e3] == pytest.approx(one.high, rel=1e-9)


@pytest.mark.parametrize("torque", [np.zeros(50), np.linspace(-1.0, 1.0, 50)])
def test_collinear_and_zero_columns_still_have_bounds(torque: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    column = np.sin(np.arange(50.0))
    columns = np.stack([column, 2.0 * column, np.zeros(50)], axis=1)
    bounds = bounds_from_data(columns, torque, ("Kc", "Bc", "Fc"))
    assert bounds.names == ("Kc", "Bc", "Fc")
    # an optimum with all of it in the first two columns' common part lies inside
    along = least_absolute_deviations(column[:, None], torque).genes[0]
    shared = np.array([along / 5.0, 2.0 * along / 5.0, 0.0])
    assert np.all((bounds.low <= shared) & (shared <= bounds.high))
