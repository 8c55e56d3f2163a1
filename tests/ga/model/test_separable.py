"""Models with a shape, against closed forms and an independent minimiser."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ga.evolution.evolution import PRESETS
from ga.model import separable
from ga.model.coupling import parse
from ga.model.separable import Fit, Problem, _other_starts, best_start, compass_search, descend, fit
from ga.model.trajectory import Motion
from ga.trials.nonlinear import search_nonlinear

Array = NDArray[np.float64]

KC, BC = 0.02, 2e-4
SAMPLES, RATE = 3000, 300.0


@dataclass(frozen=True)
class Chirp:
    """0.3 rad from 0.3 to 12 Hz in ten seconds, in closed form at any time."""

    time: Array

    @property
    def motion(self) -> Motion:
        sweep = (12.0 - 0.3) / 10.0
        phase = 2.0 * np.pi * (0.3 * self.time + 0.5 * sweep * self.time**2)
        omega = 2.0 * np.pi * (0.3 + sweep * self.time)
        rate = 0.3 * omega * np.cos(phase)
        acceleration = -0.3 * omega**2 * np.sin(phase) + 0.3 * 2.0 * np.pi * sweep * np.cos(phase)
        return Motion(self.time, 0.3 * np.sin(phase), rate, acceleration, np.zeros(len(self.time)))


TIME = np.arange(SAMPLES) / RATE
MOTION = Chirp(TIME).motion


def noise(seed: int = 0) -> Array:
    return 5e-5 * np.random.default_rng(seed).standard_normal(SAMPLES)


def skewed(skew: float) -> Array:
    then = Chirp(TIME - skew).motion
    return KC * then.dtheta + BC * then.dtheta_dot + noise()


def with_play(gap: float, centre: float) -> Array:
    """Flanks that push only: the torque of spring and damper, where it has the sign of the flank."""
    beyond = MOTION.dtheta - centre
    pushed = np.sign(beyond) * np.maximum(np.abs(beyond) - 0.5 * gap, 0.0)
    torque = KC * pushed + BC * MOTION.dtheta_dot
    return np.where(pushed * torque > 0.0, torque, 0.0) + noise()


def problem(name: str, torque: Array) -> Problem:
    model = parse(name).anchored(MOTION)
    return Problem(model, MOTION, torque, *model.bounds(MOTION, highest=12.0))


def test_a_fit_of_many_parameters_begins_at_a_few_hundred_values_that_cover_the_grid_of_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = list[Array]()
    monkeypatch.setattr(separable, "solve_or_none", lambda _problem, nonlinear, _near: tried.append(nonlinear))
    many = problem("linear+maxwell+maxwell2+exponential+sheath+skew", skewed(0.0))
    with pytest.raises(RuntimeError):
        best_start(many)
    assert len(tried) <= 300
    found = [len(set(values)) for values in np.array(tried).T.tolist()]
    assert found == [len(parameter.starts) for parameter in many.model.nonlinear]


def test_starts_without_a_gap_are_one_wherever_its_middle_is() -> None:
    """A descent from one of them that gained nothing is followed by one from a start with a gap."""
    asked = problem("linear+offset+deadband", with_play(0.1, 0.02))
    places = [one.name for one in asked.model.nonlinear]
    closed, alike, moved, gaping = (
        asked.solve(np.array([{"gap": gap, "centre": centre}[name] for name in places]))
        for gap, centre in ((0.0, 0.0), (0.0, 0.05), (0.0, -0.05), (0.3, -0.1))
    )
    assert pytest.approx(closed.fitness, rel=1e-9) == alike.fitness < gaping.fitness
    assert gaping in _other_starts(asked, closed, moved, [closed, alike, gaping])


@pytest.mark.parametrize("skew", [-3e-3, 2e-3])
def test_a_skew_comes_back_with_stiffness_and_damping(skew: float) -> None:
    found = fit(problem("linear+skew", skewed(skew)))
    assert found.nonlinear[0] == pytest.approx(skew, abs=1e-4)
    assert found.values[:2] == pytest.approx([KC, BC], rel=0.01)
    assert fit(problem("linear", skewed(skew))).values[1] != pytest.approx(BC, rel=0.1)


@pytest.mark.parametrize("late", [2e-3, 6e-3])
def test_of_two_delays_that_fit_alike_that_with_a_positive_damping_is_found(late: float) -> None:
    """Bc + Kc late and the stiffening, which goes with late (Bc - Kc late/2), are nearly the same at -Bc and a lead."""
    damping, then = 1e-4, Chirp(TIME - late).motion
    found = fit(problem("linear+skew", KC * then.dtheta + damping * then.dtheta_dot + noise(1)))
    assert found.nonlinear[0] == pytest.approx(late, abs=1e-4)
    assert found.values[1] == pytest.approx(damping, rel=0.03)


def test_the_bottom_of_the_valley_is_that_of_an_independent_minimiser() -> None:
    asked = problem("linear+skew", skewed(2e-3))
    found = fit(asked)
    other = minimize_scalar(
        lambda skew: asked.solve(np.array([skew])).fitness,
        bounds=(1.5e-3, 2.5e-3),
        method="bounded",
        options={"xatol": 1e-9},
    )
    assert found.fitness <= other.fun * (1.0 + 1e-7)
    assert found.nonlinear[0] == pytest.approx(other.x, abs=2e-6)


def test_play_comes_back_with_its_centre_and_flanks_that_push_only() -> None:
    found = fit(problem("linear+offset+backlash", with_play(0.06, 0.03)))
    gap, centre = found.nonlinear
    assert (gap, centre) == pytest.approx((0.06, 0.03), abs=2e-3)
    assert found.values[:2] == pytest.approx([KC, BC], rel=0.015)
    assert found.lag == pytest.approx(BC / KC, rel=0.02)


@pytest.mark.parametrize("gap", [0.004, 0.06])
def test_play_comes_back_where_the_flanks_part_at_its_edge(gap: float) -> None:
    """The damper acts until the deflection has left the flank, and pulls there."""
    beyond = np.sign(MOTION.dtheta) * np.maximum(np.abs(MOTION.dtheta) - 0.5 * gap, 0.0)
    torque = KC * beyond + BC * MOTION.dtheta_dot * (beyond != 0.0) + noise()
    found = fit(problem("linear+offset+backlash", torque))
    assert found.lag == 0.0
    assert found.nonlinear == pytest.approx([gap, 0.0], abs=2e-3)
    assert found.values[:2] == pytest.approx([KC, BC], rel=0.015)
    assert found.fitness < fit(problem("linear", torque)).fitness


def test_a_slack_tendon_comes_back() -> None:
    beyond = np.maximum(MOTION.dtheta - 0.05, 0.0)
    torque = KC * beyond + BC * MOTION.dtheta_dot
    torque = np.where((beyond > 0.0) & (torque > 0.0), torque, 0.0) + noise()
    found = fit(problem("linear+slack", torque))
    assert found.nonlinear[0] == pytest.approx(0.05, abs=2e-3)
    assert found.values[:2] == pytest.approx([KC, BC], rel=0.02)


@pytest.mark.parametrize(
    ("name", "torque"), [("linear+skew", skewed(2e-3)), ("linear+offset+backlash", with_play(0.06, 0.0))]
)
def test_the_neighbourhood_has_the_residuals_of_the_fit(name: str, torque: Array) -> None:
    asked = problem(name, torque)
    found = fit(asked)
    columns, target = asked.linearised(found)
    assert target - columns @ found.values == pytest.approx(asked.residuals(found), abs=1e-12)
    assert float(np.mean(np.abs(asked.residuals(found)))) == pytest.approx(found.fitness, rel=1e-9)


def test_a_step_that_cannot_be_solved_is_not_better_and_ends_no_descent(monkeypatch: pytest.MonkeyPatch) -> None:
    model, torque = parse("linear+skew").anchored(MOTION), skewed(4e-3)
    problem, solved, calls = Problem(model, MOTION, torque, *model.bounds(MOTION, 12.0)), Problem._solved, [0]

    def failing(self: Problem, *words: Any) -> Any:
        calls[0] += 1
        if calls[0] == 2:
            raise RuntimeError("no optimal vertex was found")
        return solved(self, *words)

    monkeypatch.setattr(Problem, "_solved", failing)

    assert descend(problem, np.zeros(1)).nonlinear[0] == pytest.approx(4e-3, abs=1e-4)


@pytest.mark.study
def test_a_compass_passes_over_points_that_cannot_be_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    model = parse("linear+backlash").anchored(MOTION)
    problem = Problem(model, MOTION, with_play(0.1, 0.02), *model.bounds(MOTION, 12.0))
    best, solved, calls = problem.solve(0.5 * (problem.low + problem.high)), Problem._solved, [0]

    def failing(self: Problem, *words: Any) -> Any:
        calls[0] += 1
        if calls[0] % 3 == 0:
            raise RuntimeError("no optimal vertex was found")
        return solved(self, *words)

    monkeypatch.setattr(Problem, "_solved", failing)

    assert compass_search(problem, best).fitness < best.fitness


@dataclass(frozen=True)
class Place:
    """What a compass sees of a fit."""

    nonlinear: Array
    fitness: float


def test_a_compass_follows_a_long_and_narrow_minimum_with_ever_larger_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """With steps along the axes alone, as short as it is narrow, it took 5,000 of them to its end."""
    seen = 0

    def solved(_: object, at: Array, __: Place) -> SimpleNamespace:
        nonlocal seen
        seen += 1
        across, along = float(at[0] - at[1]), float(at[0] + at[1]) - 1.4
        return SimpleNamespace(fit=Place(at, 1e3 * across**2 + along**2))

    monkeypatch.setattr(separable, "_solved_or_none", solved)
    monkeypatch.setattr(separable, "_rough", lambda _: np.eye(2))
    bounds = SimpleNamespace(low=np.zeros(2), high=np.ones(2))
    found = compass_search(cast("Problem", bounds), cast("Fit", Place(np.full(2, 0.1), 1.44)))
    assert found.nonlinear == pytest.approx([0.7, 0.7], abs=0.02)
    assert seen < 1000


def test_a_descent_stays_within_the_bounds() -> None:
    asked = problem("linear+skew", skewed(5e-3))
    narrow = Problem(asked.model, asked.motion, asked.torque, np.array([-1e-3]), np.array([1e-3]))
    assert descend(narrow, np.array([0.0])).nonlinear[0] == pytest.approx(1e-3)


def test_some_of_the_samples_are_delayed_as_if_all_were_there() -> None:
    some = MOTION.of(slice(None, None, 7)).delayed(2e-3)
    assert np.array_equal(some.dtheta, MOTION.delayed(2e-3).dtheta[::7])


def test_nothing_is_interpolated_from_one_stretch_to_the_next() -> None:
    twice = Motion(
        np.concatenate([TIME, TIME]),
        np.concatenate([MOTION.dtheta, MOTION.dtheta + 1.0]),
        np.concatenate([MOTION.dtheta_dot, MOTION.dtheta_dot]),
        np.concatenate([MOTION.dtheta_ddot, MOTION.dtheta_ddot]),
        np.zeros(2 * SAMPLES),
        starts=(0, SAMPLES),
    )
    delayed = twice.delayed(2e-3)
    assert delayed.dtheta[SAMPLES:] == pytest.approx(MOTION.delayed(2e-3).dtheta + 1.0, abs=1e-9)


def searched(workers: int, trials: int = 3) -> Array:
    asked = problem("linear+skew", skewed(2e-3))
    return search_nonlinear(asked, PRESETS["default"], trials=trials, seed=4, workers=workers)[0].genes


def test_the_search_comes_to_the_bottom_whatever_the_number_of_workers() -> None:
    alone, together = searched(1), searched(2)
    assert np.array_equal(alone, together)
    exact = fit(problem("linear+skew", skewed(2e-3))).values
    assert alone == pytest.approx(np.tile(exact, (3, 1)), rel=1e-4)


@pytest.mark.study
@pytest.mark.parametrize("name", ["linear+skew", "linear+dahl"])
def test_a_search_for_one_parameter_ends_early_and_every_trial_at_the_lowest_minimum(name: str) -> None:
    asked = problem(name, skewed(2e-3))
    trials, best = search_nonlinear(asked, PRESETS["default"], trials=3, seed=1, workers=1)
    assert trials.evaluations < 3 * 250
    assert best.fitness <= fit(asked).fitness * (1.0 + 1e-9)
    assert trials.fitness == pytest.approx(np.full(3, best.fitness), rel=1e-6)


def test_the_search_counts_its_work_and_tells_how_far_it_is() -> None:
    shares: list[float] = []
    asked = problem("linear+skew", skewed(2e-3))
    found, _ = search_nonlinear(asked, PRESETS["default"], trials=2, seed=0, workers=1, progress=shares.append)
    assert found.finished.all()
    assert found.evaluations == found.made > 2 * 18
    assert shares[-1] == 1.0
    assert np.all(np.diff(found.history.fitness, axis=1) <= 0.0)


@pytest.mark.parametrize(("upper", "lower"), [(0.003, 0.0), (0.002, 0.003)])
def test_each_flank_of_a_gap_is_found_though_the_other_one_is_right_already(upper: float, lower: float) -> None:
    """A flank that is wrong alone moves gap and centre together: along either of them there is no way down."""
    torque = with_play(0.04, 0.01)
    model = parse("linear+offset+backlash")
    problem = Problem(model, MOTION, torque, *model.bounds(MOTION, 12.0))
    found = compass_search(problem, descend(problem, np.array([0.04 + upper - lower, 0.01 + 0.5 * (upper + lower)])))
    gap, centre = found.nonlinear
    assert centre + 0.5 * gap == pytest.approx(0.03, abs=3e-4)
    assert centre - 0.5 * gap == pytest.approx(-0.01, abs=3e-4)


def test_a_gap_is_fitted_at_least_as_well_as_by_its_true_ends() -> None:
    asked = problem("linear+offset+backlash", with_play(0.15, -0.05) - noise() + 4.0 * noise(2))
    assert fit(asked).fitness <= asked.solve(np.array([0.15, -0.05])).fitness


def test_a_shape_that_cannot_be_fitted_is_passed_over_in_the_search_for_a_valley() -> None:
    """At rest every lag is like every other: one shape of the grid without a fit is not the end of the search."""
    still = Motion(TIME, np.full(SAMPLES, 0.1), np.zeros(SAMPLES), np.zeros(SAMPLES), np.zeros(SAMPLES))
    problem = Problem(parse("linear+slack"), still, noise(), np.array([0.05]), np.array([0.2]))
    assert np.isfinite(fit(problem).fitness)


@pytest.mark.study
def test_no_trial_is_better_than_the_best_fit_returned_with_them() -> None:
    """When flanks part depends on Bc/Kc, which is agreed on to a tolerance: solving again would end beside it."""
    asked = problem("linear+offset+backlash", with_play(0.06, 0.03))
    trials, best = search_nonlinear(asked, PRESETS["default"], trials=2, seed=0, workers=1)
    assert best.fitness == trials.fitness.min()
    assert np.array_equal(best.values, trials.best)
    assert float(np.mean(np.abs(asked.residuals(best)))) == pytest.approx(best.fitness, rel=1e-12)
