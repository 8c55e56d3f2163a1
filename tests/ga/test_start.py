"""Where a search begins, and the collapsed samples it then looks at: the fitness stays the plain sum everywhere."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from ga.bounds import Bounds, bounds_from_data
from ga.compiled import compiled_when_worth
from ga.evolution.evolution import PRESETS, begin
from ga.evolution.generator import seeded, uniforms
from ga.fitness.dense import WIDER, collapse, dense_error, dense_tangent
from ga.fitness.engine import evaluate
from ga.lad.exact import least_absolute_deviations
from ga.start import Start, start_of
from ga.trials.trials import run_trials

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.ga.conftest import Data, Making

    Array = NDArray[np.float64]

TRUTH = [17.75e-3, 0.19e-3, 1e-3, 5e-4, 0.05, -1e-5]
NASTY = ("bimodal", "one side", "cauchy", "one huge", "units", "collinear", "few rows", "no noise")


def nasty(name: str, made: Making) -> tuple[Array, Array]:
    rng = np.random.default_rng(7)
    data = made(TRUTH[:3], noise=2e-4, count=1500, seed=1)
    columns, torque = data.columns, data.torque.copy()
    if name == "bimodal":  # no residual near zero: the estimator's error is many times what normal residuals tell
        columns, torque = columns[:, :2], torque + np.where(rng.random(1500) < 0.5, 3e-3, -3e-3)
    if name == "one side":
        torque += np.where(rng.random(1500) < 0.3, 0.05, 0.0)
    if name == "cauchy":
        torque += 2e-4 * rng.standard_cauchy(1500)
    if name == "one huge":
        torque[7] = 1e6
    if name == "units":
        columns = columns * [1.0, 1e6, 1e-6]
    if name == "collinear":
        columns = columns[:, :1] + np.array([0.0, 3e-3]) * rng.normal(size=(1500, 2))
    if name == "few rows":
        columns, torque = columns[::300], torque[::300]
    if name == "no noise":
        torque = columns @ TRUTH[:3]
    return columns, torque


def started(columns: Array, torque: Array) -> Start:
    start = start_of(columns, torque, bounds_from_data(columns, torque))
    assert start is not None
    return start


@pytest.mark.parametrize(("p", "count"), [(1, 200), (2, 200), (2, 2500), (3, 2500), (6, 2500)])
def test_collapsed_samples_give_the_plain_mean_everywhere(made: Making, p: int, count: int) -> None:
    data = made(TRUTH[:p], noise=2e-4, count=count, seed=p)
    start = started(data.columns, data.torque)
    engine = collapse(data.columns, data.torque, start)
    rng = np.random.default_rng(0)
    for size in (0.0, 0.5, 0.99 * WIDER, 1.01 * WIDER, 5.0, 1e4):
        for _ in range(20):
            genes = start.centre + start.backward @ (size * start.reach * rng.choice([-1.0, 1.0], size=p))
            plain = float(np.mean(np.abs(data.torque - data.columns @ genes)))
            assert evaluate(engine, genes) == pytest.approx(plain, rel=1e-12)


def test_collapsing_leaves_few_rows_to_be_looked_at(made: Making) -> None:
    data = made(TRUTH[:2], noise=2e-4, count=200_000, seed=0)
    engine = collapse(data.columns, data.torque, started(data.columns, data.torque))
    assert engine.blocks[:, 0].size < 0.03 * 200_000


@pytest.mark.parametrize("name", NASTY)
def test_only_what_exceeds_the_limit_is_turned_down_unseen(made: Making, name: str) -> None:
    columns, torque = nasty(name, made)
    start = started(columns, torque)
    engine, rng = collapse(columns, torque, start), np.random.default_rng(1)
    turned_down = 0
    for size in np.repeat([1.0, 2.0, 5.0, 50.0], 15):
        genes = start.centre + start.backward @ (size * start.reach * rng.uniform(-1.0, 1.0, len(start.centre)))
        plain = float(np.mean(np.abs(torque - columns @ genes)))
        found = dense_error(engine, genes, 0.999 * plain)
        assert found == np.inf or found == pytest.approx(plain, rel=1e-12)
        turned_down += found == np.inf
        assert dense_error(engine, genes, 1.001 * plain) == pytest.approx(plain, rel=1e-12)
    assert turned_down > 0


def test_the_tangent_of_collapsed_samples_touches_the_fitness_and_stays_below_it(paper_like: Data) -> None:
    start = started(paper_like.columns, paper_like.torque)
    engine, slope = collapse(paper_like.columns, paper_like.torque, start), np.empty(2)
    rng = np.random.default_rng(2)
    for size in (0.5, 20.0):
        at = start.centre + start.backward @ (size * start.reach * rng.uniform(-1.0, 1.0, 2))
        height = dense_tangent(engine, at, slope)
        if size < 1.0:
            assert height == pytest.approx(evaluate(engine, at), rel=1e-12)
        for _ in range(100):
            genes = start.centre + start.backward @ (30.0 * start.reach * rng.uniform(-1.0, 1.0, 2))
            assert height + slope @ (genes - at) <= evaluate(engine, genes) * (1.0 + 1e-9)


@pytest.mark.parametrize("name", [*NASTY, "few of many rows"])
def test_python_and_machine_code_begin_with_the_same_bits(
    made: Making, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns, torque = nasty(name, made)
    if name == "few of many rows":
        columns, torque = np.tile(columns, (30, 1)), np.tile(torque, 30)
    bounds = bounds_from_data(columns, torque)
    settings = replace(PRESETS["default"], generations=3)
    runs = []
    for worth in (np.inf, 0.0):
        monkeypatch.setattr(compiled_when_worth, "worth", worth)
        runs.append(run_trials(columns, torque, bounds, settings, trials=2, seed=0, workers=1))
    assert runs[0].genes.tobytes() == runs[1].genes.tobytes()
    assert runs[0].fitness.tobytes() == runs[1].fitness.tobytes()


@pytest.mark.parametrize("name", [*NASTY, "plain"])
def test_the_cube_holds_the_optimum(made: Making, name: str) -> None:
    columns, torque = nasty(name, made)
    start = started(columns, torque)
    away = start.forward @ (least_absolute_deviations(columns, torque).genes - start.centre)
    assert np.abs(away).max() <= start.reach


@pytest.mark.parametrize("name", NASTY)
def test_every_trial_finds_the_optimum_of_nasty_data(made: Making, name: str) -> None:
    columns, torque = nasty(name, made)
    bounds = bounds_from_data(columns, torque)
    trials = run_trials(columns, torque, bounds, PRESETS["default"], trials=8, seed=0, workers=1)
    exact = least_absolute_deviations(columns, torque)
    assert max(exact.relative_gap(float(fitness)) for fitness in trials.fitness) < 1e-6


def test_a_search_whose_bounds_cut_off_the_optimum_ends_on_the_bound_as_from_a_uniform_start(made: Making) -> None:
    data = made(TRUTH[:2], noise=2e-4, count=2500, seed=0)
    best = least_absolute_deviations(data.columns, data.torque).genes
    start = started(data.columns, data.torque)
    bounds = Bounds(np.array([best[0] + 0.02 * start.reach * start.backward[0, 0], 0.0]), np.array([1.0, 1e-2]))
    assert start_of(data.columns, data.torque, bounds) is not None
    ends = [
        run_trials(
            data.columns,
            data.torque,
            bounds,
            replace(PRESETS["default"], start=beginning),
            trials=10,
            seed=0,
            workers=1,
        )
        for beginning in ("uniform", "informed")
    ]
    assert ends[1].fitness == pytest.approx(ends[0].fitness.min(), rel=1e-6)
    assert np.all(ends[1].genes[:, 0] >= bounds.low[0])


@pytest.mark.parametrize("why", ["a copy", "nothing", "too few", "outside", "narrow", "not a number"])
def test_without_a_cube_within_the_bounds_there_is_no_informed_start(made: Making, why: str) -> None:
    data = made(TRUTH[:2], noise=2e-4, count=500, seed=0)
    columns, torque = data.columns.copy(), data.torque.copy()
    bounds = bounds_from_data(columns, torque)
    if why == "a copy":
        columns[:, 1] = 3.0 * columns[:, 0]
    if why == "nothing":
        columns[:, 1] = 0.0
    if why == "too few":
        columns, torque = columns[:1], torque[:1]
    if why == "outside":
        bounds = Bounds(np.array([0.02, 1e-5]), np.array([0.2, 1e-2]))
    if why == "narrow":
        bounds = Bounds(data.truth * 0.9999, data.truth * 1.0001)
    if why == "not a number":
        torque[3] = np.nan
    assert start_of(columns, torque, bounds) is None


def test_trials_that_start_informed_are_independent_and_fill_the_cube(paper_like: Data) -> None:
    bounds = bounds_from_data(paper_like.columns, paper_like.torque)
    start = started(paper_like.columns, paper_like.torque)
    engine = collapse(paper_like.columns, paper_like.torque, start)
    settings = replace(PRESETS["default"], population=100)
    populations = [begin(engine, bounds, settings, 0, trial, start=start) for trial in range(30)]
    genes = np.stack([population.genes for population in populations])
    place = (genes - start.centre) @ start.forward.T / start.reach
    assert np.abs(place).max() <= 1.0 + 1e-9
    assert place.mean(axis=(0, 1)) == pytest.approx([0.0, 0.0], abs=0.05)
    assert place.std(axis=(0, 1)) == pytest.approx([3.0**-0.5] * 2, rel=0.05)
    together = np.asarray(np.corrcoef(place[:, :, 0]))
    assert np.abs(together[np.triu_indices(30, 1)]).max() < 0.5
    for population in populations:
        assert population.fitness.tolist() == [evaluate(engine, chromosome) for chromosome in population.genes]


def test_a_chromosome_outside_the_bounds_is_drawn_again_before_the_next_one(paper_like: Data) -> None:
    start = started(paper_like.columns, paper_like.torque)
    bounds = Bounds(start.centre - 0.4 * start.reach * np.diag(start.backward), start.centre + np.ones(2))
    engine = collapse(paper_like.columns, paper_like.torque, start)
    genes = begin(engine, bounds, PRESETS["default"], 3, 0, start=start).genes
    state = seeded(3, 0)
    expected: list[Array] = []
    while len(expected) < len(genes):
        one = start.centre + start.backward @ (start.reach * (2.0 * uniforms(state, 2) - 1.0))
        if (one >= bounds.low).all():
            expected.append(one)
    assert genes == pytest.approx(np.array(expected), rel=1e-12)
