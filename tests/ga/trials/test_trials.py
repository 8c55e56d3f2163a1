from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from ga.bounds import PAPER_BOUNDS, bounds_from_data
from ga.evolution.evolution import PRESETS, Settings
from ga.lad.exact import least_absolute_deviations
from ga.trials.outcome import Trials
from ga.trials.trials import run_trials

if TYPE_CHECKING:
    from tests.ga.conftest import Data, Making

PAPER = replace(PRESETS["paper"], generations=3000)


def tried(data: Data, settings: Settings = PAPER, *, trials: int = 3, seed: int = 0, **how: Any) -> Trials:
    how = {"workers": 2} | how
    return run_trials(data.columns, data.torque, PAPER_BOUNDS, settings, trials=trials, seed=seed, **how)


def assert_same(one: Trials, other: Trials) -> None:
    assert np.array_equal(one.genes, other.genes)
    assert np.array_equal(one.fitness, other.fitness)
    assert np.array_equal(one.generations, other.generations)
    assert np.array_equal(one.history.generation, other.history.generation)
    assert np.array_equal(one.history.fitness, other.history.fitness)
    assert one.evaluations == other.evaluations


def test_the_papers_algorithm_ends_within_one_percent_of_the_exact_optimum(paper_like: Data) -> None:
    settings = replace(PRESETS["paper"], generations=20_000)
    trials = tried(paper_like, settings, trials=8)
    exact = least_absolute_deviations(paper_like.columns, paper_like.torque)
    assert trials.mean[0] == pytest.approx(exact.genes[0], rel=0.01)
    assert 0.0 <= exact.relative_gap(float(trials.fitness.min())) < 1e-4


@pytest.mark.parametrize("p", [2, 5, pytest.param(8, marks=pytest.mark.study)])
def test_every_trial_of_the_default_preset_reaches_the_exact_optimum(made: Making, p: int) -> None:
    truth = [17.75e-3, 0.19e-3, 1e-3, 5e-4, 0.05, -1e-5, 1e-6, 0.3][:p]
    data = made(truth, noise=2e-4, count=1000, seed=p)
    bounds = bounds_from_data(data.columns, data.torque)
    trials = run_trials(data.columns, data.torque, bounds, PRESETS["default"], trials=10, seed=p, workers=2)
    exact = least_absolute_deviations(data.columns, data.torque)
    gaps = [exact.relative_gap(float(fitness)) for fitness in trials.fitness]
    assert min(gaps) >= -1e-13
    assert max(gaps) < 1e-6


@pytest.mark.parametrize("preset", ["paper", "default"])
def test_the_result_does_not_depend_on_the_number_of_workers(paper_like: Data, preset: str) -> None:
    settings = replace(PRESETS[preset], generations=3000)
    one, two, seven = (tried(paper_like, settings, trials=5, seed=4, workers=workers) for workers in (1, 2, 7))
    assert_same(one, two)
    assert_same(one, seven)


def test_a_trial_is_the_same_however_many_follow_it(paper_like: Data) -> None:
    few, many = (tried(paper_like, trials=count, seed=4) for count in (2, 4))
    assert np.array_equal(few.genes, many.genes[:2])


def test_another_seed_gives_other_trials(paper_like: Data) -> None:
    one, other = (tried(paper_like, trials=2, seed=seed) for seed in (0, 1))
    assert not np.any(one.genes == other.genes)


def test_mean_and_deviation_are_over_the_trials(paper_like: Data) -> None:
    trials = tried(paper_like, trials=6)
    assert trials.mean == pytest.approx(sum(trials.genes) / 6)
    assert trials.std == pytest.approx(np.sqrt(sum((trials.genes - trials.mean) ** 2) / 5))
    assert np.array_equal(trials.best, trials.genes[trials.fitness == trials.fitness.min()][0])


def test_one_trial_has_no_deviation(paper_like: Data) -> None:
    trials = tried(paper_like, trials=1)
    assert np.isnan(trials.std).all()


def test_the_history_falls_from_the_first_population_to_the_final_fitness(paper_like: Data) -> None:
    trials = tried(paper_like)
    history = trials.history
    assert history.generation[0] == 0
    assert history.generation[-1] == 3000
    assert np.all(np.diff(history.generation) > 0)
    assert np.max(np.diff(np.log10(history.generation[30:]))) < 1.5 / 20
    assert np.all(np.diff(history.fitness, axis=1) <= 0.0)
    assert np.array_equal(history.fitness[:, -1], trials.fitness)


def test_a_trial_that_stopped_early_keeps_its_last_fitness_in_the_history(paper_like: Data) -> None:
    trials = tried(paper_like, PRESETS["default"], trials=8)
    assert trials.generations.min() < trials.generations.max() < PRESETS["default"].generations
    assert trials.history.generation[-1] == trials.generations.max()
    assert np.array_equal(trials.history.fitness[:, -1], trials.fitness)
    assert np.all(np.diff(trials.history.generation) > 0)


def test_evaluations_count_the_first_population_and_every_child(paper_like: Data) -> None:
    paper = tried(paper_like)
    assert paper.evaluations == 3 * (10 + 3000)
    default = tried(paper_like, PRESETS["default"])
    assert default.evaluations == 3 * 26 + 10 * int(default.generations.sum())


def test_progress_rises_to_one(paper_like: Data) -> None:
    shares: list[float] = []
    tried(paper_like, workers=1, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_an_interrupt_ends_the_run_and_leaves_no_thread_working(
    paper_like: Data, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ga.fitness.engine.WORTHWHILE", 10**30)  # the other engine takes a minute to compile

    def interrupt(_done: float) -> None:
        raise KeyboardInterrupt

    endless = replace(PRESETS["paper"], generations=10**12)
    with pytest.raises(KeyboardInterrupt):
        tried(paper_like, endless, trials=4, progress=interrupt)


@pytest.mark.parametrize(("trials", "workers"), [(0, 1), (1, 0)])
def test_no_trials_or_no_workers_are_refused(paper_like: Data, trials: int, workers: int) -> None:
    with pytest.raises(ValueError, match="1 or more of each"):
        tried(paper_like, trials=trials, workers=workers)


def test_data_with_a_nan_are_refused() -> None:
    columns = np.ones((5, 2))
    columns[2, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        run_trials(columns, np.ones(5), PAPER_BOUNDS, PAPER, trials=1, seed=0, workers=1)
