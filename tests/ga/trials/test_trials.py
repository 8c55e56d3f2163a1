from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from ga.bounds import PAPER_BOUNDS, bounds_from_data
from ga.evolution.evolution import PRESETS
from ga.lad.exact import least_absolute_deviations
from ga.trials.outcome import Trials
from ga.trials.trials import run_trials

if TYPE_CHECKING:
    from tests.ga.conftest import Data, Making

PAPER = replace(PRESETS["paper"], generations=3000)


def assert_same(one: Trials, other: Trials) -> None:
    assert np.array_equal(one.genes, other.genes)
    assert np.array_equal(one.fitness, other.fitness)
    assert np.array_equal(one.generations, other.generations)
    assert np.array_equal(one.history.fitness, other.history.fitness)
    assert one.evaluations == other.evaluations


def test_the_search_recovers_the_stiffness_the_data_was_made_with(paper_like: Data) -> None:
    bounds = bounds_from_data(paper_like.columns, paper_like.torque)
    trials = run_trials(paper_like.columns, paper_like.torque, bounds, PRESETS["default"], trials=4, seed=0, workers=2)
    assert trials.best == pytest.approx(paper_like.truth, rel=0.01)


def test_the_papers_algorithm_ends_within_one_percent_of_the_exact_optimum(paper_like: Data) -> None:
    settings = replace(PRESETS["paper"], generations=20_000)
    trials = run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, settings, trials=8, seed=0, workers=2)
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


@pytest.mark.parametrize("noise", [0.0, 1e-9])
def test_the_default_preset_finds_the_optimum_of_data_with_hardly_any_noise(made: Making, noise: float) -> None:
    data = made([263.0, 0.02, 1.0], noise=noise, count=1000, seed=0)
    bounds = bounds_from_data(data.columns, data.torque)
    trials = run_trials(data.columns, data.torque, bounds, PRESETS["default"], trials=10, seed=0, workers=2)
    exact = least_absolute_deviations(data.columns, data.torque)
    assert max(exact.relative_gap(float(fitness)) for fitness in trials.fitness) < 1e-6
    assert trials.genes == pytest.approx(np.tile(data.truth, (10, 1)), rel=1e-6)


def test_the_default_preset_finds_the_optimum_when_two_columns_are_nearly_one() -> None:
    rng = np.random.default_rng(0)
    column = rng.normal(size=1000)
    columns = np.stack([column, column + 0.003 * rng.normal(size=1000)], axis=1)
    torque = columns @ [1.0, 2.0] + 0.05 * rng.normal(size=1000)
    trials = run_trials(
        columns, torque, bounds_from_data(columns, torque), PRESETS["default"], trials=30, seed=0, workers=2
    )
    exact = least_absolute_deviations(columns, torque)
    assert max(exact.relative_gap(float(fitness)) for fitness in trials.fitness) < 1e-6


@pytest.mark.parametrize("preset", ["paper", "default"])
def test_the_result_does_not_depend_on_the_number_of_workers(paper_like: Data, preset: str) -> None:
    settings = replace(PRESETS[preset], generations=3000)
    one, two, seven = (
        run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, settings, trials=5, seed=4, workers=w)
        for w in (1, 2, 7)
    )
    assert_same(one, two)
    assert_same(one, seven)


def test_a_trial_is_the_same_however_many_follow_it(paper_like: Data) -> None:
    few, many = (
        run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=count, seed=4, workers=2)
        for count in (2, 4)
    )
    assert np.array_equal(few.genes, many.genes[:2])


def test_another_seed_gives_other_trials(paper_like: Data) -> None:
    one, other = (
        run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=2, seed=seed, workers=2)
        for seed in (0, 1)
    )
    assert not np.any(one.genes == other.genes)


def test_mean_and_deviation_are_over_the_trials(paper_like: Data) -> None:
    trials = run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=6, seed=0, workers=2)
    assert trials.mean == pytest.approx(sum(trials.genes) / 6)
    assert trials.std == pytest.approx(np.sqrt(sum((trials.genes - trials.mean) ** 2) / 5))
    assert np.array_equal(trials.best, trials.genes[trials.fitness == trials.fitness.min()][0])


def test_one_trial_has_no_deviation(paper_like: Data) -> None:
    trials = run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=1, seed=0, workers=2)
    assert np.isnan(trials.std).all()


def test_the_history_falls_from_the_first_population_to_the_final_fitness(paper_like: Data) -> None:
    trials = run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=3, seed=0, workers=2)
    history = trials.history
    assert history.generation[0] == 0
    assert history.generation[-1] == 3000
    assert np.all(np.diff(history.generation) > 0)
    assert np.max(np.diff(np.log10(history.generation[30:]))) < 1.5 / 20
    assert np.all(np.diff(history.fitness, axis=1) <= 0.0)
    assert np.array_equal(history.fitness[:, -1], trials.fitness)


def test_a_trial_that_stopped_early_keeps_its_last_fitness_in_the_history(paper_like: Data) -> None:
    trials = run_trials(
        paper_like.columns, paper_like.torque, PAPER_BOUNDS, PRESETS["default"], trials=8, seed=0, workers=2
    )
    assert trials.generations.min() < trials.generations.max() < PRESETS["default"].generations
    assert trials.history.generation[-1] == trials.generations.max()
    assert np.array_equal(trials.history.fitness[:, -1], trials.fitness)
    assert np.all(np.diff(trials.history.generation) > 0)


def test_evaluations_count_the_first_population_and_every_child(paper_like: Data) -> None:
    paper = run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=3, seed=0, workers=2)
    assert paper.evaluations == 3 * (10 + 3000)
    default = run_trials(
        paper_like.columns, paper_like.torque, PAPER_BOUNDS, PRESETS["default"], trials=3, seed=0, workers=2
    )
    assert default.evaluations == 3 * 26 + 10 * int(default.generations.sum())


def test_progress_rises_to_one(paper_like: Data) -> None:
    shares: list[float] = []
    run_trials(
        paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=3, seed=0, workers=1, progress=shares.append
    )
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
        run_trials(
            paper_like.columns,
            paper_like.torque,
            PAPER_BOUNDS,
            endless,
            trials=4,
            seed=0,
            workers=2,
            progress=interrupt,
        )


@pytest.mark.parametrize(("trials", "workers"), [(0, 1), (1, 0)])
def test_no_trials_or_no_workers_are_refused(paper_like: Data, trials: int, workers: int) -> None:
    with pytest.raises(ValueError, match="1 or more of each"):
        run_trials(paper_like.columns, paper_like.torque, PAPER_BOUNDS, PAPER, trials=trials, seed=0, workers=workers)


def test_data_with_a_nan_are_refused() -> None:
    columns = np.ones((5, 2))
    columns[2, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        run_trials(columns, np.ones(5), PAPER_BOUNDS, PAPER, trials=1, seed=0, workers=1)
