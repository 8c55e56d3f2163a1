from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ga.fitness.dense import pack
from ga.fitness.engine import evaluate


@settings(max_examples=60)
@given(n=st.integers(1, 700), p=st.integers(1, 8), exponent=st.integers(-6, 6), seed=st.integers(0, 2**32 - 1))
def test_the_fitness_is_the_mean_absolute_error_of_equation_5(n: int, p: int, exponent: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, torque = rng.normal(size=(n, p)) * 10.0**exponent, rng.normal(size=n)
    genes = rng.normal(size=p) * 10.0 ** rng.integers(-3, 3, size=p)
    terms = np.abs(torque - columns @ genes)
    size = np.abs(torque) + np.abs(columns) @ np.abs(genes)
    assert abs(evaluate(pack(columns, torque), genes) - math.fsum(terms) / n) <= 1e-14 * math.fsum(size) / n


def test_rows_without_residual_cost_nothing() -> None:
    columns = np.array([[1.0, 2.0], [3.0, 4.0], [0.0, 0.0]])
    assert evaluate(pack(columns, columns @ [0.5, 0.25]), np.array([0.5, 0.25])) == 0.0


def test_a_chromosome_that_is_not_a_number_has_no_fitness() -> None:
    assert math.isnan(evaluate(pack(np.ones((200, 2)), np.ones(200)), np.array([np.nan, 0.0])))


@pytest.mark.parametrize(
    ("columns", "torque", "message"),
    [
        (np.ones((3, 2)), np.ones(4), "are not of shape"),
        (np.ones(3), np.ones(3), "are not of shape"),
        (np.ones((0, 2)), np.ones(0), "nothing to fit"),
        (np.ones((3, 0)), np.ones(3), "nothing to fit"),
        (np.array([[1.0], [np.nan]]), np.ones(2), "NaN or infinite"),
        (np.ones((2, 1)), np.array([1.0, -np.inf]), "NaN or infinite"),
    ],
)
def test_data_that_cannot_be_fitted_are_refused(
    columns: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    torque: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    message: str,
) -> None:
    with pytest.raises(ValueError, match=message):
        pack(columns, torque)
