from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from ga.bounds import PAPER_BOUNDS, Bounds
from ga.evolution.evolution import PRESETS, Settings, advance, begin
from ga.evolution.population import Population
from ga.fitness.cells import grow
from ga.fitness.dense import Samples, pack
from ga.fitness.engine import Engine, evaluate

if TYPE_CHECKING:
    from tests.ga.conftest import Data

SHORT = replace(PRESETS["paper"], generations=500)


def searched(data: Data, settings: Settings, *stops: int) -> Population:
    samples = pack(data.columns, data.torque)
    population = begin(samples, PAPER_BOUNDS, settings, seed=1, trial=0)
    for stop in stops:
        advance(samples, PAPER_BOUNDS, settings, population, stop)
    return population


@pytest.mark.parametrize("preset", ["paper", "default"])
def test_the_first_population_is_uniform_in_the_bounds_and_evaluated(paper_like: Data, preset: str) -> None:
    samples = pack(paper_like.columns, paper_like.torque)
    settings = replace(PRESETS[preset], population=400)
    population = begin(samples, PAPER_BOUNDS, settings, seed=0, trial=0)
    part = (population.genes - PAPER_BOUNDS.low) / (PAPER_BOUNDS.high - PAPER_BOUNDS.low)
    assert part.min() > 0.0
    assert part.max() < 1.0
    assert part.mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.06)
    assert population.fitness.tolist() == [evaluate(samples, genes) for genes in population.genes]
    assert population.best_fitness[0] == population.fitness.min()
    assert population.evaluations == 400


@pytest.mark.parametrize("preset", ["paper", "default"])
def test_a_search_in_pieces_ends_in_the_same_bits_as_one_in_one_go(paper_like: Data, preset: str) -> None:
    settings = replace(PRESETS[preset], generations=60)
    whole, pieces = searched(paper_like, settings, 60), searched(paper_like, settings, 1, 2, 17, 17, 60)
    for one, other in zip(whole, pieces, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("replacement", ["worst", "worst-if-better", "oldest", "random"])
@pytest.mark.parametrize("weights", ["error", "inverse-error"])
@pytest.mark.parametrize("selection", ["minimise", "larger"])
def test_every_reading_keeps_the_books(paper_like: Data, selection: Any, weights: Any, replacement: Any) -> None:
    settings = replace(SHORT, selection=selection, weights=weights, replacement=replacement)
    population = searched(paper_like, settings, 500)
    samples = pack(paper_like.columns, paper_like.torque)
    assert population.generation == 500
    assert population.evaluations == 510
    assert np.all((population.genes >= PAPER_BOUNDS.low) & (population.genes <= PAPER_BOUNDS.high))
    assert population.fitness.tolist() == [evaluate(samples, genes) for genes in population.genes]
    assert population.best_fitness[0] == evaluate(samples, population.best)
    assert population.best_fitness[0] <= population.fitness.min()


def changed_rows(data: Data, settings: Settings, generations: int) -> list[tuple[list[int], np.ndarray[Any, Any]]]:
    """For each generation the rows of the population that changed, and the fitness before it."""
    samples: Samples = pack(data.columns, data.torque)
    population = begin(samples, PAPER_BOUNDS, settings, seed=3, trial=0)
    changes = []
    for generation in range(1, generations + 1):
        genes, fitness = population.genes.copy(), population.fitness.copy()
        advance(samples, PAPER_BOUNDS, settings, population, generation)
        changes.append((np.flatnonzero((population.genes != genes).any(axis=1)).tolist(), fitness))
    return changes


def test_the_child_replaces_the_worst(paper_like: Data) -> None:
    for rows, before in changed_rows(paper_like, SHORT, 50):
        assert rows == [before.argmax()]


def test_the_child_replaces_the_worst_only_if_it_is_better(paper_like: Data) -> None:
    settings = replace(SHORT, replacement="worst-if-better")
    changes = changed_rows(paper_like, settings, 200)
    assert all(rows in ([], [before.argmax()]) for rows, before in changes)
    assert 0 < sum(not rows for rows, _ in changes) < 200
    worst = [before.max() for _, before in changes]
    assert worst == sorted(worst, reverse=True)


def test_the_child_replaces_the_oldest(paper_like: Data) -> None:
    changes = changed_rows(paper_like, replace(SHORT, replacement="oldest"), 25)
    assert [rows for rows, _ in changes] == [[i % 10] for i in range(25)]


def test_the_child_replaces_any_at_random(paper_like: Data) -> None:
    changes = changed_rows(paper_like, replace(SHORT, replacement="random"), 100)
    assert {row for rows, _ in changes for row in rows} == set(range(10))


def test_without_mutation_the_papers_crossover_only_contracts(paper_like: Data) -> None:
    settings = replace(SHORT, mutation=0.0)
    start = searched(paper_like, settings)
    low, high = start.genes.min(axis=0), start.genes.max(axis=0)
    end = searched(paper_like, settings, 500)
    assert np.all((end.genes >= low) & (end.genes <= high))
    assert np.all(np.ptp(end.genes, axis=0) < 1e-3 * (high - low))


def test_the_stop_rule_ends_a_settled_search_and_only_then(paper_like: Data) -> None:
    stopped = searched(paper_like, PRESETS["default"], 20_000)
    assert stopped.stopped
    assert stopped.generation < 20_000
    assert np.ptp(stopped.fitness) <= 1e-8 * stopped.fitness.min()
    before = searched(paper_like, PRESETS["default"], stopped.generation - 1)
    assert not before.stopped


def test_children_stay_in_the_bounds_when_the_optimum_lies_outside(paper_like: Data) -> None:
    bounds = Bounds(np.array([0.02, 1e-5]), np.array([0.2, 1e-2]))
    samples = pack(paper_like.columns, paper_like.torque)
    population = begin(samples, bounds, PRESETS["default"], seed=0, trial=0)
    advance(samples, bounds, PRESETS["default"], population, 2000)
    assert np.all((population.genes >= bounds.low) & (population.genes <= bounds.high))
    assert bounds.at_bound(population.best) == ("low", None)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"selection": "largest"}, 'selection "largest" is not one of minimise, larger'),
        ({"weights": "none"}, "is not one of error, inverse-error"),
        ({"replacement": "best"}, "is not one of worst, worst-if-better, oldest, random"),
        ({"scheme": "islands"}, "is not one of steady-state, generational"),
        ({"generations": 0}, "0 generations"),
        ({"mutation": 1.5}, "mutation 1.5 is not a probability"),
        ({"mutation": float("nan")}, "is not a probability"),
        ({"tournament": 0}, "tournament of 0"),
        ({"population": 1}, "population of 1"),
        ({"reach": 0.0}, "reach 0"),
        ({"tolerance": -1.0}, "tolerance -1"),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(PRESETS["paper"], **wrong)


def test_a_population_smaller_than_a_tournament_is_refused(paper_like: Data) -> None:
    with pytest.raises(ValueError, match="population of 2: 3 different"):
        searched(paper_like, replace(SHORT, population=2))


def test_bounds_of_another_number_of_parameters_are_refused(paper_like: Data) -> None:
    with pytest.raises(ValueError, match="bounds of 1 parameters for 2 columns"):
        begin(pack(paper_like.columns, paper_like.torque), Bounds(np.zeros(1), np.ones(1)), SHORT, 0, 0)


def test_the_papers_preset_is_as_printed() -> None:
    paper = PRESETS["paper"]
    assert (paper.population, paper.mutation, paper.tournament) == (10, 0.6, 3)
    assert paper.generations == 200_000_000
    assert paper.weights == "error"
    assert paper.tolerance is None


READINGS = [
    ("minimise", "worst"),
    ("minimise", "worst-if-better"),
    ("larger", "worst-if-better"),
    ("larger", "worst"),
    ("minimise", "oldest"),
]


@pytest.mark.parametrize(("selection", "replacement"), READINGS)
@pytest.mark.parametrize(
    "engine", [pytest.param(grow, id="boxes", marks=pytest.mark.study), pytest.param(pack, id="dense")]
)
def test_turning_hopeless_children_away_changes_nothing(
    paper_like: Data, engine: Any, selection: Any, replacement: Any
) -> None:
    settings = replace(SHORT, selection=selection, replacement=replacement, generations=6000)
    data = (paper_like.columns, paper_like.torque)
    with_all: Engine = grow(*data, PAPER_BOUNDS) if engine is grow else pack(*data)
    end = 6000 if engine is grow else 3000
    populations = [begin(with_all, PAPER_BOUNDS, settings, seed=5, trial=0) for _ in range(2)]
    for until in (100, 101, 102, 999, end):  # what is open at the end of a piece is settled there
        for population, reject in zip(populations, (True, False), strict=True):
            advance(with_all, PAPER_BOUNDS, settings, population, until, reject=reject)
        for one, other in zip(*populations, strict=True):
            assert np.array_equal(one, other)


@pytest.mark.parametrize("boxes", [pytest.param(True, marks=pytest.mark.study), False])
def test_turning_hopeless_children_away_changes_nothing_in_the_default_preset(paper_like: Data, *, boxes: bool) -> None:
    ends = []
    for reject in (True, False):
        data = (paper_like.columns, paper_like.torque)
        engine: Engine = grow(*data, PAPER_BOUNDS) if boxes else pack(*data)
        population = begin(engine, PAPER_BOUNDS, PRESETS["default"], seed=5, trial=0)
        advance(engine, PAPER_BOUNDS, PRESETS["default"], population, 6000, reject=reject)
        ends.append(population)
    for one, other in zip(*ends, strict=True):
        assert np.array_equal(one, other)


def test_with_minimise_the_worst_is_replaced_always_or_only_if_better_with_the_same_result(paper_like: Data) -> None:
    engine = pack(paper_like.columns, paper_like.torque)
    ends = []
    for rule in ("worst", "worst-if-better"):
        settings = replace(SHORT, replacement=rule, generations=3000)
        population = begin(engine, PAPER_BOUNDS, settings, seed=2, trial=0)
        advance(engine, PAPER_BOUNDS, settings, population, 3000)
        ends.append(population)
    one, other = ends
    assert np.array_equal(one.best, other.best)
    assert np.array_equal(one.generator, other.generator)
    # all but the worst are the same
    assert np.array_equal(np.sort(one.fitness)[:-1], np.sort(other.fitness)[:-1])


@pytest.mark.study  # a search over boxes is compiled for a minute
@pytest.mark.parametrize("preset", ["paper", "default"])
def test_both_engines_lead_the_search_to_the_same_optimum(paper_like: Data, preset: str) -> None:
    settings = replace(PRESETS[preset], generations=3000)
    fitness = []
    for engine in (
        grow(paper_like.columns, paper_like.torque, PAPER_BOUNDS),
        pack(paper_like.columns, paper_like.torque),
    ):
        population = begin(engine, PAPER_BOUNDS, settings, seed=1, trial=0)
        advance(engine, PAPER_BOUNDS, settings, population, 3000)
        fitness.append(population.best_fitness[0])
    assert fitness[0] == pytest.approx(fitness[1], rel=1e-3 if preset == "paper" else 1e-7)
