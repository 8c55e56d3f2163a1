from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from ga.bounds import PAPER_BOUNDS, Bounds
from ga.evolution.ask_tell import Search
from ga.evolution.evolution import PRESETS, advance, begin
from ga.fitness.dense import pack
from ga.fitness.engine import evaluate
from ga.lad.exact import least_absolute_deviations

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tests.ga.conftest import Data


def run(search: Search, error: Callable[[NDArray[np.float64]], float]) -> None:
    while not search.done:
        genes = search.ask()
        search.tell(genes, [error(chromosome) for chromosome in genes])


@pytest.mark.study
def test_the_bottom_of_rosenbrocks_valley_is_found() -> None:
    search = Search(Bounds(np.array([-2.0, -1.0]), np.array([2.0, 3.0])), seed=1, floor=1e-12)
    run(search, lambda x: float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2))
    assert search.best == pytest.approx([1.0, 1.0], abs=1e-6)
    assert search.evaluations < 20_000


def test_an_optimum_on_the_bounds_is_found_within_them() -> None:
    search = Search(Bounds(np.zeros(3), np.ones(3)), seed=0, floor=1e-9)
    run(search, lambda x: float(np.sum(np.abs(x - [2.0, 0.5, -1.0]))))
    assert search.best == pytest.approx([1.0, 0.5, 0.0], abs=1e-6)


def test_a_parameter_that_the_torque_is_not_linear_in_is_found() -> None:
    """A tendon that only pulls: the slack enters through max(dtheta - slack, 0)."""
    rng = np.random.default_rng(0)
    dtheta = rng.uniform(-0.1, 0.4, size=400)
    torque = 17.75e-3 * np.maximum(dtheta - 0.05, 0.0) + rng.laplace(scale=1e-5, size=400)

    def error(genes: NDArray[np.float64]) -> float:
        return float(np.mean(np.abs(torque - genes[0] * np.maximum(dtheta - genes[1], 0.0))))

    search = Search(Bounds(np.array([0.5e-3, 0.0]), np.array([0.2, 0.3])), seed=0)
    run(search, error)
    pulled = np.maximum(dtheta - search.best[1], 0.0)[:, None]
    assert search.best == pytest.approx([17.75e-3, 0.05], rel=0.01)
    # for this slack the stiffness is the exact one
    assert search.best_fitness <= least_absolute_deviations(pulled, torque).fitness * (1.0 + 1e-6)


def test_told_the_papers_fitness_it_goes_the_way_of_the_compiled_search(paper_like: Data) -> None:
    samples = pack(paper_like.columns, paper_like.torque)
    population = begin(samples, PAPER_BOUNDS, PRESETS["default"], seed=3, trial=0)
    advance(samples, PAPER_BOUNDS, PRESETS["default"], population, 20_000)
    search = Search(PAPER_BOUNDS, seed=3, floor=samples.floor)
    run(search, lambda genes: evaluate(samples, genes))
    assert np.array_equal(search.best, population.best)
    assert search.evaluations == population.evaluations


def test_a_fitness_that_is_not_a_number_counts_as_the_worst() -> None:
    search = Search(Bounds(np.array([-3.0]), np.array([1.0])), seed=0, floor=1e-9)
    with np.errstate(invalid="ignore"):
        run(search, lambda x: float(np.abs(np.sqrt(x[0]) - 0.5)))
    assert search.best == pytest.approx([0.25], abs=1e-6)


def test_asking_twice_gives_the_same_chromosomes_until_they_are_told() -> None:
    search = Search(PAPER_BOUNDS, seed=0)
    first = search.ask()
    assert np.array_equal(search.ask(), first)
    search.tell(first, np.arange(len(first)))
    assert np.array_equal(search.best, first[0])
    assert search.ask().shape == (10, 2)


def test_the_number_of_generations_ends_a_search() -> None:
    search = Search(PAPER_BOUNDS, replace(PRESETS["default"], generations=7, tolerance=None), seed=0)
    run(search, lambda x: float(x @ x))
    assert search.evaluations == 26 + 7 * 10


def test_what_was_not_asked_for_is_refused() -> None:
    search = Search(PAPER_BOUNDS, seed=0)
    with pytest.raises(ValueError, match="not the chromosomes that were asked for"):
        search.tell(np.zeros((26, 2)), np.zeros(26))
    genes = search.ask()
    with pytest.raises(ValueError, match="for 26 chromosomes"):
        search.tell(genes, np.zeros(3))


def test_settings_of_the_paper_are_refused() -> None:
    with pytest.raises(ValueError, match='only the scheme "generational"'):
        Search(PAPER_BOUNDS, PRESETS["paper"])
