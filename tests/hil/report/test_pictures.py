"""The pictures show the numbers of the result: of the search, the fitness around it, the terms and the residuals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ga.model.coupling import parse
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Identification, Step
from hil.report.pictures import checks
from hil.report.pictures.result import pictures
from hil.report.pictures.search import Landscape, has_landscape, landscape
from hil.report.pictures.traces import modelled

from .conftest import recording


def error(found: Identification, kc: float, bc: float) -> float:
    """The mean absolute error, N m, by the definition."""
    motion = found.signals.motion
    return float(np.mean(np.abs(found.signals.torque - kc * motion.dtheta - bc * motion.dtheta_dot)))


@pytest.mark.parametrize("reach", [1e-3, 0.5])
def test_the_landscape_is_the_mean_absolute_error(found: Identification, reach: float) -> None:
    """Near the optimum most residuals keep their sign, far away none does."""
    kc, bc = found["Kc"].exact, found["Bc"].exact
    seen = landscape(found, ((kc * (1.0 - reach), kc * (1.0 + reach)), (bc * (1.0 - reach), bc * (1.0 + reach))))
    for row in (0, 20, 33):
        for column in (0, 20, 40):
            expected = error(found, float(seen.Kc[column]), float(seen.Bc[row]))
            assert seen.error[row, column] == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(lowest(seen), (kc, bc), rtol=1e-9)
    assert seen.error.min() == pytest.approx(found.optimum, rel=1e-9)


def lowest(seen: Landscape) -> tuple[float, float]:
    row, column = np.unravel_index(int(seen.error.argmin()), seen.error.shape)
    return float(seen.Kc[column]), float(seen.Bc[row])


def test_the_first_and_the_last_generation_of_the_best_trial_are_handed_over(found: Identification) -> None:
    populations, trials = found.trials.populations, found.trials
    assert populations is not None
    best = int(trials.fitness.argmin())
    errors = [
        [float(np.mean(np.abs(found.signals.torque - columns @ one))) for one in genes]
        for columns in [found.model.columns(found.signals.motion)]
        for genes in (populations.first, populations.last)
    ]
    assert min(errors[0]) == pytest.approx(trials.history.fitness[best, 0], rel=1e-9)
    assert min(errors[1]) == pytest.approx(trials.fitness[best], rel=1e-9)
    assert np.ptp(populations.last, axis=0)[0] < 1e-3 * np.ptp(populations.first, axis=0)[0]


@pytest.mark.study
@pytest.mark.parametrize("model", ["linear+backlash"])
def test_the_modelled_torque_has_the_error_that_was_found(tmp_path: Path, model: str) -> None:
    """Of a model with nonlinear parameters too, some of which change what the others multiply."""
    result = identify(
        [recording(tmp_path / "a.h5", samples=1000, gap=0.05)], parse(model), Search(trials=1, seed=0, workers=1)
    )
    residuals = (result.signals.torque - modelled(result))[result.fitted]
    assert float(np.mean(np.abs(residuals))) == pytest.approx(result.optimum, rel=2e-3)
    assert has_landscape(result)
    assert result.trials.populations is None


def test_every_picture_names_its_numbers(found: Identification) -> None:
    shown = {one.name: one.alt for one in pictures(found)}
    assert list(shown) == ["loop", "traces", "residuals", "fit", "intervals", "dynamic", "convergence", "landscape"]
    optimum = f"{1e3 * found.optimum:.5g} mN m"
    assert f"the exact optimum is {optimum}" in shown["convergence"]
    assert f"{found.optimiser_gap:.1e} above it" in shown["convergence"]
    assert f"{1e3 * found.optimum:.4g} mN m at the exact optimum" in shown["landscape"]
    assert "coherence 0.9" in shown["dynamic"]
    assert "95 % bounds" in shown["residuals"]


def test_the_convergence_has_a_line_for_each_trial_their_mean_and_the_optimum(found: Identification) -> None:
    fitness = {one.name: one.chart for one in pictures(found)}["convergence"]().panels[0]
    history, lines = found.trials.history, [line.y for line in fitness.lines]
    for trial in range(4):
        np.testing.assert_allclose(lines[trial], 1e3 * history.fitness[trial])
    np.testing.assert_allclose(lines[4], 1e3 * history.fitness.mean(axis=0))
    np.testing.assert_allclose(lines[5], 1e3 * found.optimum)


def test_a_search_by_another_fitness_than_the_optimum_has_no_convergence(found: Identification) -> None:
    history = replace(found.trials.history, fitness=1.002 * found.trials.history.fitness)
    other = replace(found, trials=replace(found.trials, history=history))
    assert "convergence" not in {one.name for one in pictures(other)}


def test_model_selection_is_drawn_with_the_gain_of_each_term(found: Identification) -> None:
    gains_of = {"linear": np.nan, "coulomb": 12.5, "skew": -3.0, "cubic": 0.4}
    steps = tuple(
        Step("linear", term, 2e-4, 2e-4, gain, 0.02, 2e-4, gain > 1.0, 2.0) for term, gain in gains_of.items()
    )
    picture = {one.name: one for one in pictures(replace(found, steps=steps))}["selection"]
    gains = {
        place: gain
        for line in picture.chart().panels[0].lines
        for place, gain in zip(line.x.tolist(), line.y.tolist(), strict=True)
    }
    assert gains == {float(at): step.gain for at, step in enumerate(steps) if at}
    for step in steps[1:]:
        decision = "included" if step.included else "rejected"
        assert f"{step.term} {step.gain:.3g} ({decision})" in picture.alt


def test_the_spectrum_of_white_noise_lies_in_its_band() -> None:
    """The mean of the power over frequency is the variance over half the sampling rate."""
    values = np.random.default_rng(3).standard_normal(20_000)
    panel = checks.spectrum_panel(values, 500.0, "N m")
    (line,), (band,) = panel.lines, panel.bands
    assert float(line.y.mean()) == pytest.approx(2.0 / 500.0, rel=0.03)
    assert float(np.mean((line.y > band.low) & (line.y < band.high))) > 0.9
