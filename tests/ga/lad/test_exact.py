from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.optimize import linprog

from ga.lad import exact
from ga.lad.exact import fitness_of, least_absolute_deviations, not_negative
from ga.lad.simplex import lowest_crossing, room_for

if TYPE_CHECKING:
    from numpy.typing import NDArray


def highs(columns: NDArray[np.float64], torque: NDArray[np.float64], positive: tuple[int, ...] = ()) -> float:
    """The least mean absolute error by an independent solver: HiGHS on the linear programme, some genes bounded."""
    n, p = columns.shape
    scale = np.abs(columns).max(axis=0)
    scale[scale == 0.0] = 1.0
    size = float(np.abs(torque).max()) or 1.0
    constraints = sparse.hstack([sparse.csr_matrix(columns / scale), sparse.eye(n), -sparse.eye(n)])
    cost = np.concatenate([np.zeros(p), np.full(2 * n, 1.0 / n)])
    bounds = [(0.0 if k in positive else None, None) for k in range(p)] + [(0.0, None)] * (2 * n)
    result = linprog(cost, A_eq=constraints, b_eq=torque / size, bounds=bounds, method="highs")
    assert result.status == 0
    genes = result.x[:p] * size / scale
    return float(np.mean(np.abs(torque - columns @ genes)))


def recording(kind: str, n: int, p: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    columns = rng.normal(size=(n, p)) * 10.0 ** rng.integers(-4, 3, size=p)
    if kind == "collinear":
        columns[:, -1] = 2.0 * columns[:, 0]
    if kind == "a zero column":
        columns[:, 0] = 0.0
    if kind == "counts":
        columns = np.round(rng.normal(size=(n, p)) * 2.0)
    torque = columns @ (
        rng.normal(size=p) / (1e-300 + np.abs(columns).mean(axis=0)) * (np.abs(columns).sum(axis=0) > 0)
    )
    torque += 0.3 * (rng.standard_cauchy(n) if kind == "outliers" else rng.normal(size=n))
    if kind == "counts":
        torque = np.round(torque)
    if kind == "repeated rows":
        pick = rng.integers(0, max(n // 4, 1), size=n)
        columns, torque = columns[pick], torque[pick]
    return columns, torque


KINDS = ["normal", "outliers", "counts", "repeated rows", "collinear", "a zero column"]


@settings(max_examples=40)
@given(kind=st.sampled_from(KINDS), n=st.integers(1, 120), p=st.integers(1, 8), seed=st.integers(0, 2**32 - 1))
def test_the_optimum_is_that_of_an_independent_solver(kind: str, n: int, p: int, seed: int) -> None:
    columns, torque = recording(kind, n, p, np.random.default_rng(seed))
    optimum = least_absolute_deviations(columns, torque)
    size = float(np.mean(np.abs(torque)))
    assert optimum.fitness == pytest.approx(np.mean(np.abs(torque - columns @ optimum.genes)), abs=1e-12 * size)
    # HiGHS solves to 1e-7 of the largest torque: it can be worse by that much, but never better
    other = highs(columns, torque)
    assert other - 1e-6 * float(np.abs(torque).max()) <= optimum.fitness <= other * (1.0 + 1e-12) + 1e-12 * size
    assert optimum.certificate <= 1e-12


@pytest.mark.parametrize("kind", ["counts", "repeated rows"])
def test_ties_never_cost_the_proof(kind: str) -> None:
    for seed in range(100):
        rng = np.random.default_rng(seed)
        columns, torque = recording(kind, int(rng.integers(1, 400)), int(rng.integers(1, 9)), rng)
        assert least_absolute_deviations(columns, torque).certificate <= 1e-12


@pytest.mark.parametrize("p", [2, 8])
@pytest.mark.parametrize("kind", ["normal", "outliers", "counts", "repeated rows"])
def test_bracketing_a_long_recording_gives_the_proven_optimum(kind: str, p: int) -> None:
    columns, torque = recording(kind, 30_000, p, np.random.default_rng(p))
    optimum = least_absolute_deviations(columns, torque)
    assert optimum.certificate <= 1e-12
    # any step away goes up: the certificate does not stand alone
    rng = np.random.default_rng(0)
    for size in (1e-6, 1e-2):
        for _ in range(20):
            moved = optimum.genes * (1.0 + size * rng.normal(size=p))
            assert np.mean(np.abs(torque - columns @ moved)) >= optimum.fitness * (1.0 - 1e-14)


@pytest.mark.study
@pytest.mark.parametrize("seed", [9, 26, 28])
def test_hum_in_step_with_the_readings_of_a_periodic_motion_has_a_proven_optimum(seed: int) -> None:
    """Rows of one period after the other are alike to rounding, and the residuals have ten values."""
    time, rng = np.arange(10_000) / 500.0, np.random.default_rng(seed)
    speeds = 0.4 * np.pi * np.arange(1, 60)
    phases = np.outer(time, speeds) + rng.uniform(0.0, 2.0 * np.pi, 59)
    angle, rate = 0.03 * np.sin(phases).sum(axis=1), 0.03 * (np.cos(phases) @ speeds)
    hum = 0.02 * np.tile(np.sin(2.0 * np.pi * np.arange(10) / 10.0 + seed), 1000)
    columns = np.stack([angle, rate, np.ones(len(time)), np.sign(rate)], axis=1)

    assert least_absolute_deviations(columns, 0.3 * angle + 3e-3 * rate + hum).certificate <= 1e-12


def test_as_many_residuals_as_parameters_vanish() -> None:
    columns, torque = recording("normal", 2500, 3, np.random.default_rng(4))
    optimum = least_absolute_deviations(columns, torque)
    residual = np.abs(torque - columns @ optimum.genes)
    assert np.sum(residual < 1e-12 * np.abs(torque).mean()) == 3
    assert optimum.unique


def test_one_column_of_ones_gives_the_median() -> None:
    torque = np.array([3.0, -1.0, 4.0, 1.0, 5.0, -9.0, 2.0])
    optimum = least_absolute_deviations(np.ones((7, 1)), torque)
    assert optimum.genes.tolist() == [2.0]
    assert optimum.unique


def test_an_even_number_of_readings_has_no_single_median() -> None:
    optimum = least_absolute_deviations(np.ones((4, 1)), np.array([1.0, 2.0, 3.0, 4.0]))
    assert optimum.fitness == 1.0
    assert not optimum.unique


def test_noise_free_data_give_back_what_they_were_made_with() -> None:
    rng = np.random.default_rng(1)
    columns, truth = rng.normal(size=(20_000, 4)) * [1e-2, 1.0, 1e2, 1e-4], np.array([263.0, -1e-4, 0.5, 17.75e-3])
    optimum = least_absolute_deviations(columns, columns @ truth)
    # the column of 1e-4 makes 4e-8 of the torque, whose rounding leaves 6e-9 of its factor open
    assert optimum.genes == pytest.approx(truth, rel=1e-8)
    assert optimum.fitness < 1e-13
    assert optimum.relative_gap(optimum.fitness) == 0.0


def test_a_parameter_without_a_column_of_its_own_is_zero_and_not_unique() -> None:
    column = np.sin(np.arange(300.0))
    columns = np.stack([column, np.zeros(300)], axis=1)
    optimum = least_absolute_deviations(columns, 3.0 * column)
    assert optimum.genes == pytest.approx([3.0, 0.0], abs=1e-12)
    assert not optimum.unique


def test_columns_of_nothing_leave_the_torque_as_it_is() -> None:
    optimum = least_absolute_deviations(np.zeros((10, 2)), np.full(10, -2.0))
    assert optimum.genes.tolist() == [0.0, 0.0]
    assert optimum.fitness == 2.0
    assert not optimum.unique


def test_torque_of_nothing_is_fitted_by_nothing() -> None:
    optimum = least_absolute_deviations(np.random.default_rng(0).normal(size=(50, 3)), np.zeros(50))
    assert np.all(optimum.genes == 0.0)
    assert optimum.fitness == 0.0


def test_data_with_a_nan_are_refused() -> None:
    with pytest.raises(ValueError, match="NaN"):
        least_absolute_deviations(np.array([[np.nan], [1.0]]), np.ones(2))


@settings(max_examples=25)
@given(
    rows=st.lists(st.tuples(st.integers(-5, 5), st.integers(-3, 3)), min_size=1, max_size=40),
    slack=st.floats(0.0, 0.99),
)
def test_the_lowest_point_of_a_ray_is_found_among_ties(rows: list[tuple[int, int]], slack: float) -> None:
    residual, along = (np.array(side, dtype=np.float64) for side in zip(*rows, strict=True))
    falling = float(np.sum(np.where(residual >= 0.0, along, -along))) - slack
    crosses = ((residual >= 0.0) & (along > 0.0)) | ((residual < 0.0) & (along < 0.0))
    if falling < 0.0 or not crosses.any():
        return
    room = room_for(len(residual), 1)
    room.residual[:], room.along[:] = residual, along
    entering, step = lowest_crossing(room, falling, 1.0)
    assert crosses[entering]
    assert step == residual[entering] / along[entering]

    def height(t: float) -> float:
        return float(np.sum(np.abs(residual - t * along))) + slack * t

    lowest = min(height(t) for t in residual[crosses] / along[crosses])
    assert height(step) == pytest.approx(lowest, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("off", [0.0, 1e-4, 3.0])
def test_a_start_close_by_or_far_off_leads_to_the_same_optimum(kind: str, off: float) -> None:
    for seed in range(2):
        columns, torque = recording(kind, 5000 if seed == 0 else 300, 4, np.random.default_rng(seed))
        plain = least_absolute_deviations(columns, torque)
        near = plain.genes * (1.0 + off) + off * (plain.genes == 0.0)
        found = least_absolute_deviations(columns, torque, near)
        assert found.certificate < 1e-9
        assert found.fitness == pytest.approx(plain.fitness, rel=1e-12)


@pytest.mark.study
@settings(max_examples=25)
@given(kind=st.sampled_from(KINDS), n=st.integers(1, 120), p=st.integers(1, 8), seed=st.integers(0, 2**32 - 1))
def test_with_signs_it_is_the_optimum_of_the_linear_programme_with_bounds(kind: str, n: int, p: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, torque = recording(kind, n, p, rng)
    positive = tuple(np.flatnonzero(rng.random(p) < 0.7).tolist())
    near = rng.normal(size=p) * (rng.random(p) < 0.6)
    found = not_negative(columns, torque, positive, near if rng.random() < 0.5 else None)
    assert all(found.genes[k] >= 0.0 for k in positive)
    least = highs(columns, torque, positive)
    assert found.fitness == pytest.approx(fitness_of(columns, torque, found.genes), rel=1e-12)
    assert found.fitness >= least * (1.0 - 1e-7) - 1e-9 * float(np.abs(torque).max())
    # of many chromosomes that are best without bounds, the one it begins with may lead beside the best with them
    if np.linalg.matrix_rank(columns) == p:
        assert found.fitness <= least * (1.0 + 1e-7) + 1e-9 * float(np.abs(torque).max())


@pytest.mark.parametrize("seed", range(5))
def test_at_a_bound_the_error_falls_only_towards_what_is_not_allowed(seed: int) -> None:
    """The conditions of Karush, Kuhn and Tucker, with the signs of the residuals as the subgradient."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(400, 4)) @ (np.eye(4) + 0.4)
    torque = columns @ np.array([1.0, -0.2, 0.01, -0.01]) + 0.3 * rng.normal(size=400)
    found = not_negative(columns, torque, (0, 1, 2, 3))
    zero = found.genes == 0.0
    left = torque - columns @ found.genes
    met = np.abs(left) < 1e-12
    slope = np.linalg.lstsq(
        columns[np.ix_(met, ~zero)].T, -columns[~met][:, ~zero].T @ np.sign(left[~met]), rcond=None
    )[0]
    assert np.abs(slope).max() <= 1.0
    assert zero[1]
    assert (columns[~met][:, zero].T @ np.sign(left[~met]) + columns[np.ix_(met, zero)].T @ slope <= 0.0).all()


def test_where_no_bound_is_broken_it_is_the_free_optimum_after_one_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    columns, torque = recording("normal", 200, 3, np.random.default_rng(0))
    free, solutions = least_absolute_deviations(columns, torque), iter([least_absolute_deviations(columns, torque)])
    monkeypatch.setattr(exact, "least_absolute_deviations", lambda *_: next(solutions))
    above = tuple(k for k in range(3) if free.genes[k] > 0.0)
    assert above
    np.testing.assert_array_equal(not_negative(columns, torque, above).genes, free.genes)


@pytest.mark.parametrize("held", [(1,), (1, 3)])
def test_genes_that_are_zero_nearby_and_stay_so_take_one_solution(
    held: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the others the optimum without bounds is positive, so that no other gene is left out."""
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(400, 4)) @ (np.eye(4) + 0.4)
    torque = columns @ np.where(np.isin(np.arange(4), held), -0.3, 1.0) + 0.3 * rng.normal(size=400)
    expected = not_negative(columns, torque, (0, 1, 2, 3))
    assert tuple(np.flatnonzero(expected.genes == 0.0)) == held

    calls: list[int] = []

    def counted(columns: NDArray[np.float64], *arguments: NDArray[np.float64]) -> exact.Optimum:
        calls.append(columns.shape[1])
        return least_absolute_deviations(columns, *arguments)

    monkeypatch.setattr(exact, "least_absolute_deviations", counted)
    found = not_negative(columns, torque, (0, 1, 2, 3), expected.genes + 1e-3 * (expected.genes > 0.0))
    assert calls == [4 - len(held)]
    assert found.fitness == expected.fitness
    np.testing.assert_array_equal(found.genes, expected.genes)


@pytest.mark.parametrize("other", [-0.5, 0.5])
def test_a_gene_that_is_zero_nearby_and_no_longer_is_found(other: float) -> None:
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(400, 3))
    torque = columns @ np.array([1.0, 0.5, other]) + 0.3 * rng.normal(size=400)
    found = not_negative(columns, torque, (1, 2), np.array([1.0, 0.0, 0.4]))
    np.testing.assert_allclose(found.genes, not_negative(columns, torque, (1, 2)).genes, rtol=1e-12)
    assert found.genes[1] == pytest.approx(0.5, abs=0.1)
