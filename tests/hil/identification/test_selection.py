"""Model selection includes the terms that a recording pays for, and no others."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import parse
from ga.model.separable import Problem
from hil.identification.candidates.criterion import Criterion, criterion_of
from hil.identification.candidates.fits import Candidate, Fits
from hil.identification.candidates.selection import Selection

from .chirps import (
    BC,
    HIGHEST,
    KC,
    RATE,
    SAMPLES,
    TIME,
    Moved,
    building_up,
    chirp,
    linear,
    noise,
    selected,
    signals,
    slow,
)

Array = NDArray[np.float64]

MOVED, LATE = chirp(), chirp(TIME - 2e-3)
ANGLE, SPEED = MOVED.dtheta, MOVED.rate


def beyond(gap: float, angle: Array = ANGLE) -> Array:
    return np.asarray(np.sign(angle) * np.maximum(np.abs(angle) - gap, 0.0))


def squared(rate: Array) -> Array:
    return rate * np.abs(rate)


CASES: dict[str, Array] = {
    "linear": linear(MOVED),
    "linear+coulomb": linear(MOVED) + 1e-3 * np.sign(SPEED),
    "linear+offset+quadratic+deadband": KC * beyond(0.05) + BC * SPEED + 3e-7 * squared(SPEED),
    "linear+offset+coulomb+skew": linear(LATE) + 1e-3 * np.sign(LATE.rate) + 5e-4,
    "linear+offset+coulomb+capstan": linear(MOVED) + (1e-3 + 0.1 * np.abs(linear(MOVED))) * np.sign(SPEED),
    "linear+offset+inertia+capstan": linear(MOVED)
    + 0.15 * np.abs(linear(MOVED)) * np.sign(SPEED)
    + 4e-7 * MOVED.acceleration
    + 5e-4,
}
QUICK = "linear+coulomb"


@cache
def case(name: str) -> Selection:
    return selected(signals(MOVED.motion, CASES[name] + noise(5e-5)))


@pytest.mark.parametrize("name", [pytest.param(one, marks=() if one == QUICK else pytest.mark.study) for one in CASES])
def test_the_terms_that_are_there_are_selected_and_no_others(name: str) -> None:
    found = case(name)
    assert found.model.name == name
    assert found.chosen.stiffness == pytest.approx(KC, rel=1e-2)
    assert found.chosen.damping == pytest.approx(BC, rel=2e-2)


def test_each_step_says_what_its_term_gains_and_does_to_stiffness_and_damping() -> None:
    first, second, *others = case("linear+coulomb").steps
    assert (first.term, first.included) == ("linear", True)
    assert np.isnan(first.gain)
    assert (second.term, second.included) == ("coulomb", True)
    assert second.gain > 1000.0
    assert second.fitness < 0.5 * first.fitness
    assert second.held_out < 0.5 * first.held_out
    assert first.Bc > 1.2 * BC  # friction that is left out lands in the damping
    assert {step.term for step in others} >= {"offset", "cubic", "skew"}
    assert all(step.gain < 0.0 and not step.included for step in others)


@pytest.mark.study
def test_friction_that_builds_up_is_found_beside_a_gap() -> None:
    moved = slow()
    torque = KC * beyond(0.1, moved.dtheta) + building_up(moved, 0.02) + 1e-3 + noise(5e-5, samples=len(moved.time))
    found = selected(signals(moved.motion, torque, 0.5))
    assert {"dahl", "gear", "boucwen"}.intersection(found.chosen.terms)
    assert found.chosen.stiffness == pytest.approx(KC, rel=0.02)


@pytest.mark.study
def test_friction_that_grows_with_the_load_is_found_where_the_rates_of_fast_samples_are_uncertain() -> None:
    """In a sweep to 12 Hz that is recorded at 125 Hz with its rates, they are a third of all."""
    given = signals(MOVED.motion, CASES["linear+offset+coulomb+capstan"] + noise(5e-5))
    found = selected(replace(given, window=None))
    assert {"coulomb", "capstan"} <= set(found.chosen.terms)
    assert found.chosen.stiffness == pytest.approx(KC, rel=0.01)


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_that_follows_itself_is_not_taken_for_a_term(seed: int) -> None:
    """Counted a sample at a time, noise over a tenth of a second looks like an effect."""
    rolling = np.convolve(noise(2e-4, seed, SAMPLES + 12), np.full(13, 0.28), mode="valid")
    assert set(selected(signals(MOVED.motion, linear(MOVED) + rolling)).chosen.terms) <= {"linear", "offset"}


@pytest.mark.study
def test_a_skew_is_not_told_from_damping_where_the_joint_moves_slowly() -> None:
    moved, late = chirp(TIME, 0.02, 0.3), chirp(TIME - 5e-3, 0.02, 0.3)
    assert "skew" not in selected(signals(moved.motion, linear(late) + noise(2e-4), 0.3)).model.name


@pytest.mark.study
def test_what_is_explained_to_the_accuracy_of_the_rate_needs_no_further_term() -> None:
    """Without noise every error of the rate is significant, and none of them is the stand's."""
    torque = linear(MOVED) * (1.0 + 1e-5 * np.sin(TIME))
    assert selected(signals(MOVED.motion, torque)).model.name == "linear"


def test_the_model_selected_is_anchored_to_the_recording() -> None:
    moved = chirp(TIME + 5.0)
    model = selected(signals(moved.motion, linear(moved)), ("offset",)).model
    assert model.origin == 5.0
    assert model.smoothing is not None


@pytest.mark.parametrize(
    ("gap", "error", "expected"),
    [(0.0, 2e-3, "linear+offset"), (0.0, 5e-3, "linear+offset"), (0.02, 2e-3, "linear+offset+slack")],
)
def test_a_joint_that_rests_at_two_angles_is_slack_by_more_than_errors_of_these(
    gap: float, error: float, expected: str
) -> None:
    """Where it rests, the errors of the readings are in no torque, and a tendon that is slack there takes them out."""
    generator = np.random.default_rng(0)
    starts = np.arange(0.25, SAMPLES / RATE, 0.5)
    turn = np.pi * np.clip((TIME[:, None] - starts) / 0.1, 0.0, 1.0)
    signs = np.where(np.arange(len(starts)) % 2 == 0, 1.0, -1.0)
    angle = 0.35 * ((1.0 - np.cos(turn)) @ signs - 1.0)
    rate, acceleration = 3.5 * np.pi * np.sin(turn) @ signs, 35.0 * np.pi**2 * np.cos(turn) * (np.sin(turn) > 0) @ signs
    pulled = np.maximum(angle + 0.35 - gap, 0.0)
    torque = (KC * pulled + BC * rate) * (pulled > 0.0) + 2e-5 * generator.standard_normal(SAMPLES)
    read = Moved(TIME, angle + error * generator.standard_normal(SAMPLES), rate, acceleration)
    found = selected(signals(read.motion, torque, error=error), ("offset", "slack"))
    assert found.model.name == expected


@pytest.mark.parametrize(("times", "stops"), [(3.0, False), (300.0, True)])
def test_a_spring_that_is_hundreds_of_times_as_stiff_in_one_direction_is_a_stop(times: float, stops: bool) -> None:
    torque = linear(MOVED) + (times - 1.0) * KC * np.maximum(ANGLE - 0.25, 0.0) + noise(1e-5)
    found = Fits(MOVED.motion, torque, HIGHEST).candidate(("linear", "offset", "asymmetric"), {})
    assert found.is_impossible("asymmetric") is stops


@pytest.mark.parametrize(
    ("gap", "centre", "is_error"), [(4e-3, -0.39, True), (4e-3, 0.39, True), (4e-3, 0.0, False), (0.1, -0.36, False)]
)
def test_a_gap_as_wide_as_the_errors_at_an_end_of_the_motion_is_none(gap: float, centre: float, is_error: bool) -> None:
    motion = replace(MOVED.motion, dtheta=ANGLE * (0.39 / np.abs(ANGLE).max()))
    terms = ("linear", "offset", "backlash")
    model = parse("+".join(terms)).anchored(motion)
    problem = Problem(model, motion, linear(MOVED), *model.bounds(motion, HIGHEST))
    found = Candidate(terms, model, problem, problem.solve(np.array([gap, centre])), error=1e-3)
    assert found.is_impossible("backlash") is is_error


def judged(fits: Fits, *terms: str) -> tuple[Criterion, Candidate]:
    """Return the model of these terms, and the criterion with its residuals as the noise."""
    found = fits.candidate(("linear", *terms), {})
    return criterion_of(fits, found, 10), found


def test_friction_that_falls_with_speed_pays_with_the_damping_at_its_bound() -> None:
    moved = slow()
    torque = KC * moved.dtheta + building_up(moved, 0.02) - BC * moved.rate + noise(1e-4, samples=len(moved.time))
    fits = Fits(moved.motion, torque, 0.5)
    criterion, larger = judged(fits, "dahl")
    smaller = fits.candidate(("linear",), {})
    assert larger.damping == 0.0 < smaller.damping
    assert larger.fit.fitness < 0.5 * smaller.fit.fitness
    assert criterion.pays(smaller, larger, "dahl")


@pytest.mark.study
def test_a_term_that_makes_an_earlier_one_idle_is_still_judged_by_its_own_column() -> None:
    """With friction in proportion to the load, friction that falls with the rate is zero, and so is a column of it."""
    fits = Fits(MOVED.motion, CASES["linear+offset+coulomb+capstan"] + noise(5e-5), HIGHEST)
    criterion, larger = judged(fits, "offset", "coulomb", "stribeck", "capstan")
    assert larger.values["Fs"] == 0.0
    assert math.isfinite(criterion.correlation(larger, "capstan"))
    assert criterion.pays(judged(fits, "offset", "coulomb", "stribeck")[1], larger, "capstan")
    assert not criterion.pays(judged(fits, "offset", "coulomb", "capstan")[1], larger, "stribeck")


def test_a_joint_at_rest_whose_reading_repeats_one_count_is_not_without_noise() -> None:
    count, still = 5e-3, np.heaviside(TIME - 0.5 * TIME[-1], 1.0)
    moved = Moved(TIME, *(still * part for part in MOVED[1:]))
    fits = Fits(moved.motion, count * np.round(linear(moved) / count), HIGHEST)
    assert judged(fits)[0].density <= 1.0 / count
