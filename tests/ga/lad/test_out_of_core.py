"""Collapsing rows whose sign is settled changes nothing: the optimum is that of all the data."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.bounds import bounds_from_data
from ga.evolution.evolution import PRESETS
from ga.lad import out_of_core
from ga.lad.exact import fitness_of, least_absolute_deviations, not_negative
from ga.lad.out_of_core import Blocks, Reduced, reduce
from ga.trials.trials import run_trials

Data = tuple[NDArray[np.float64], NDArray[np.float64]]


def data(p: int, rows: int = 60_000, *, tail: float = 30.0, seed: int = 0) -> Data:
    rng = np.random.default_rng(seed)
    columns = np.cumsum(rng.standard_normal((rows, p)), axis=0) / 50.0 + rng.standard_normal((rows, p))
    columns *= 10.0 ** -np.arange(p)
    torque = columns @ rng.standard_normal(p) + 0.1 * rng.standard_t(tail, rows)
    return columns, torque


def in_blocks(columns: NDArray[np.float64], torque: NDArray[np.float64], block: int = 7001) -> Blocks:
    def blocks() -> Iterator[Data]:
        for start in range(0, len(torque), block):
            yield columns[start : start + block], torque[start : start + block]

    return blocks


@pytest.fixture(autouse=True)
def small_subsample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(out_of_core, "_SUBSAMPLE", 2000)


def reduced(columns: NDArray[np.float64], torque: NDArray[np.float64]) -> Reduced:
    return reduce(in_blocks(columns, torque), len(torque))


@pytest.mark.parametrize("tail", [30.0, 1.5])
@pytest.mark.parametrize("p", [1, 2, 5])
def test_the_optimum_is_the_one_of_all_the_data_in_memory(p: int, tail: float) -> None:
    columns, torque = data(p, tail=tail, seed=p)
    whole, found = least_absolute_deviations(columns, torque), reduced(columns, torque)
    np.testing.assert_allclose(found.optimum.genes, whole.genes, rtol=1e-9)
    assert found.optimum.fitness == pytest.approx(whole.fitness, rel=1e-12)
    assert found.optimum.floor == pytest.approx(whole.floor, rel=1e-9)
    assert found.optimum.certificate < 1e-9
    assert found.length == len(torque)


def test_with_signs_it_is_that_of_all_the_data_too_and_the_rest_is_refitted() -> None:
    columns, torque = data(3, seed=3)
    free = least_absolute_deviations(columns, torque).genes
    signs = np.where(free > 0.0, -1.0, 1.0) * np.array([1.0, -1.0, -1.0])  # only the first is below zero then
    columns = columns * signs
    found = reduce(in_blocks(columns, torque), len(torque), (0, 1, 2)).optimum
    whole = not_negative(columns, torque, (0, 1, 2))
    assert found.genes[0] == 0.0
    np.testing.assert_allclose(found.genes, whole.genes, rtol=1e-9)
    assert found.fitness == pytest.approx(whole.fitness, rel=1e-12)


def test_most_rows_are_collapsed() -> None:
    found = reduced(*data(2))
    assert len(found.torque) < 0.35 * 60_000


def test_the_fitness_near_the_optimum_is_that_of_all_the_data_and_elsewhere_never_more() -> None:
    columns, torque = data(2)
    found = reduced(columns, torque)
    rng = np.random.default_rng(1)
    for distance, exact in ((1e-4, True), (1.0, False)):
        for _ in range(20):
            genes = found.optimum.genes * (1.0 + distance * rng.standard_normal(2))
            whole = float(np.mean(np.abs(torque - columns @ genes)))
            small = found.share * float(np.mean(np.abs(found.torque - found.columns @ genes)))
            assert small <= whole * (1.0 + 1e-12)
            if exact:
                assert small == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("sigmas", [1e-3, 0.05, 0.5])
def test_a_ball_that_is_too_small_is_widened_until_it_holds_the_optimum(
    monkeypatch: pytest.MonkeyPatch, sigmas: float
) -> None:
    columns, torque = data(2, seed=3)
    monkeypatch.setattr(out_of_core, "_SIGMAS", sigmas)
    whole = least_absolute_deviations(columns, torque)
    np.testing.assert_allclose(reduced(columns, torque).optimum.genes, whole.genes, rtol=1e-9)


def test_a_search_of_the_reduced_rows_begins_around_the_optimum_and_ends_there() -> None:
    columns, torque = data(2)
    found = reduced(columns, torque)
    assert found.start is not None
    away = found.start.forward @ (found.optimum.genes - found.start.centre)
    assert np.abs(away).max() < found.start.reach
    whitened = columns @ found.start.backward
    np.testing.assert_allclose(whitened.T @ whitened / len(torque), np.eye(2), atol=1e-9)
    bounds = bounds_from_data(columns, torque)
    trials = run_trials(
        found.columns, found.torque, bounds, PRESETS["default"], trials=5, seed=0, workers=1, start=found.start
    ).scaled(found.share)
    assert found.optimum.relative_gap(float(trials.fitness.max())) < 1e-6


def test_few_rows_are_taken_as_they_are() -> None:
    columns, torque = data(2, rows=500)
    found = reduced(columns, torque)
    assert len(found.torque) == 500
    assert found.share == 1.0


def test_a_column_of_nothing_and_a_repeated_one_do_no_harm() -> None:
    columns, torque = data(2, seed=5)
    degenerate = np.column_stack([columns, np.zeros(len(torque)), columns[:, 0]])
    whole, found = least_absolute_deviations(degenerate, torque), reduced(degenerate, torque)
    assert found.optimum.fitness == pytest.approx(whole.fitness, rel=1e-10)
    assert not found.optimum.unique


def test_data_without_noise_are_fitted_exactly() -> None:
    columns, _ = data(2, seed=6)
    found = reduced(columns, columns @ np.array([2.0, 3.0]))
    np.testing.assert_allclose(found.optimum.genes, [2.0, 3.0], rtol=1e-9)
    assert found.optimum.fitness < 1e-12


@pytest.mark.parametrize("noise", [0.0, 1e-12, 1e-3])
def test_no_search_is_better_than_the_optimum_it_is_compared_with(noise: float) -> None:
    """Without noise both are rounding, and which is the smaller would be chance."""
    rng = np.random.default_rng(0)
    time = np.arange(3000) / 300.0
    angle = 0.3 * np.sin(2.0 * np.pi * (0.3 + 0.6 * time) * time)
    columns = np.stack([angle, np.gradient(angle, time), np.ones_like(time)], axis=1)
    torque = columns @ np.array([0.02, 2e-4, 1e-3]) + noise * rng.standard_normal(len(time))
    bounds = bounds_from_data(columns, torque)
    trials = run_trials(columns, torque, bounds, PRESETS["default"], trials=10, seed=0, workers=1)
    found = reduced(columns, torque)
    for genes in (*trials.genes, np.array([0.02, 2e-4, 1e-3])):
        optimum, gap = found.compared(genes)
        assert gap >= 0.0
        assert optimum.fitness <= found.optimum.fitness
        assert gap == optimum.relative_gap(fitness_of(found.columns, found.torque, genes) * found.share)
        assert optimum.genes == pytest.approx(found.optimum.genes, rel=1e-9)
