"""Model selection includes the terms that a recording pays for, and no others."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import NamedTuple, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel, parse
from ga.model.memory import lagged
from ga.model.separable import Fit, Problem, best_start
from ga.model.terms import RARER, is_addable, with_another
from ga.model.trajectory import Motion
from hil.identification.candidates import criterion, stepwise
from hil.identification.candidates import fits as fits_module
from hil.identification.candidates.fits import LATE, Candidate, Fits
from hil.identification.candidates.late import EARLIER, LateReading
from hil.identification.candidates.stepwise import Selection, select
from hil.signals.rate.windows import Window
from hil.uncertainty.residual_spectrum import ResidualSpectrum

Array = NDArray[np.float64]

KC, BC = 17.75e-3, 0.19e-3
SAMPLES, RATE, HIGHEST = 2000, 125.0, 12.0


class Moved(NamedTuple):
    """Time s, deflection rad, rate and acceleration, in closed form."""

    time: Array
    dtheta: Array
    rate: Array
    acceleration: Array


def with_error(error: float) -> Window:
    """A window of readings of the deflection with an error, rad, one standard deviation."""
    return Window(6, 6, 1.0 / RATE, (0.0, HIGHEST), 0.0, error, 0.0)


def chirp(time: Array, low: float = 0.2, high: float = HIGHEST) -> Moved:
    sweep = (high - low) / (SAMPLES / RATE)
    phase, omega = 2.0 * np.pi * (low * time + 0.5 * sweep * time**2), 2.0 * np.pi * (low + sweep * time)
    return Moved(
        time,
        0.35 * np.sin(phase),
        0.35 * omega * np.cos(phase),
        0.35 * (2.0 * np.pi * sweep * np.cos(phase) - omega**2 * np.sin(phase)),
    )


TIME = np.arange(SAMPLES) / RATE


def linear(moved: Moved) -> Array:
    return KC * moved.dtheta + BC * moved.rate


def with_play(moved: Moved) -> Array:
    pushed = np.sign(moved.dtheta) * np.maximum(np.abs(moved.dtheta) - 0.015, 0.0)
    torque = KC * pushed + BC * moved.rate
    return np.where(pushed * torque > 0.0, torque, 0.0)


def relaxing(moved: Moved) -> Array:
    """A standard linear solid: a branch of 40 % of Kc that relaxes in 30 ms, integrated in small steps."""
    fine = np.linspace(0.0, TIME[-1], 40 * SAMPLES)
    angle, keep = chirp(fine).dtheta, np.exp(-(fine[1] - fine[0]) / 0.03)
    state, states = angle[0], np.empty(len(fine))
    for at, value in enumerate(angle.tolist()):
        state = value + (state - value) * keep
        states[at] = state
    return linear(moved) + 0.4 * KC * (moved.dtheta - np.interp(moved.time, fine, states))


CASES: dict[str, Callable[[Moved], Array]] = {
    "linear": linear,
    "linear+offset": lambda moved: linear(moved) + 5e-4,
    "linear+offset+drift": lambda moved: linear(moved) + 5e-4 + 5e-5 * moved.time,
    "linear+coulomb": lambda moved: linear(moved) + 1e-3 * np.sign(moved.rate),
    "linear+cubic": lambda moved: linear(moved) + 0.05 * moved.dtheta**3,
    "linear+skew": lambda moved: linear(chirp(moved.time - 2e-3)),
    "linear+offset+backlash": with_play,
    "linear+offset+coulomb+skew": lambda moved: (
        linear(chirp(moved.time - 2e-3)) + 1e-3 * np.sign(chirp(moved.time - 2e-3).rate) + 5e-4
    ),
}


def selected(torque: Array, moved: Moved, highest: float = HIGHEST) -> Selection:
    motion = Motion(moved.time, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES), rate_noise=0.02)
    return select(motion, torque, highest)


@cache
def case(name: str) -> Selection:
    moved = chirp(TIME)
    return selected(CASES[name](moved) + 2e-4 * np.random.default_rng(1).standard_normal(SAMPLES), moved)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.study if name.count("+") > 1 else ()) for name in CASES]
)
def test_the_terms_that_are_there_are_taken_and_no_others(name: str) -> None:
    found = case(name)
    assert found.model.name == name
    top = [step for step in found.steps if step.included][-1]
    assert top.Kc == pytest.approx(KC, rel=1e-2)
    assert top.Bc == pytest.approx(BC, rel=3e-2)


def test_each_rung_says_what_its_term_gains_and_does_to_stiffness_and_damping() -> None:
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


def as_if_white(blocks: Iterable[tuple[Array, Array]]) -> ResidualSpectrum:
    ((columns, _),) = blocks
    products = (columns.T @ columns)[None]
    return ResidualSpectrum(np.ones(1), np.ones(1), products, np.zeros(1), products)


@pytest.mark.study
def test_noise_that_follows_itself_is_less_often_taken_for_a_term_than_its_samples_would_have_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Counted a sample at a time, noise over a tenth of a second looks like news; by its spectrum, less so."""
    moved = chirp(TIME)

    def taken() -> int:
        count = 0
        for seed in range(3):
            white = np.random.default_rng(seed).standard_normal(SAMPLES + 12)
            torque = linear(moved) + 2e-4 * np.convolve(white, np.full(13, 0.28), mode="valid")
            count += len(selected(torque, moved).model.terms) - 1
        return count

    allowing = taken()
    monkeypatch.setattr(criterion, "measure", as_if_white)
    assert allowing < taken()


def test_a_skew_is_not_told_from_damping_where_the_joint_moves_slowly() -> None:
    moved = chirp(TIME, 0.02, 0.3)
    late = chirp(TIME - 5e-3, 0.02, 0.3)
    torque = linear(late) + 2e-4 * np.random.default_rng(0).standard_normal(SAMPLES)
    assert "skew" not in selected(torque, moved, highest=0.3).model.name


def test_what_is_explained_to_the_accuracy_of_the_rate_needs_no_further_term() -> None:
    """Without noise every error of the rate is significant, and none of them is the stand's."""
    moved = chirp(TIME)
    assert selected(linear(moved) * (1.0 + 1e-5 * np.sin(moved.time)), moved).model.name == "linear"


def test_the_model_chosen_is_anchored_to_the_recording() -> None:
    moved = chirp(TIME + 5.0)
    model = selected(linear(moved), moved).model
    assert model.origin == 5.0
    assert model.smoothing is not None


RARE: dict[str, tuple[Callable[[Moved], Array], str]] = {
    "linear+quadratic": (lambda moved: linear(moved) + 2e-5 * moved.rate * np.abs(moved.rate), "quadratic"),
    "linear+maxwell": (relaxing, "maxwell"),
    "linear+softening": (lambda moved: linear(moved) - 3e-4 * (moved.time - 8.0) * moved.dtheta, "softening"),
}


@pytest.mark.study
@pytest.mark.parametrize("expected", RARE)
def test_a_rarer_term_is_included_where_the_usual_ones_do_not_describe_the_recording(expected: str) -> None:
    moved, (torque, term) = chirp(TIME), RARE[expected]
    motion = Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    noisy = torque(moved) + 5e-5 * np.random.default_rng(4).standard_normal(SAMPLES)
    rarer = ("quadratic", "maxwell", "softening", "lag")
    found = select(motion, noisy, HIGHEST, rarer=rarer, describes=lambda *_: False)
    assert found.model.name == expected
    assert found.values[:2] == pytest.approx([KC, BC], rel=0.03)
    kept = select(motion, noisy, HIGHEST, rarer=rarer, describes=lambda *_: True)
    assert term not in kept.model.name
    # a model is selected again from the samples in which friction does not hold the joint
    held = select(motion, noisy, HIGHEST, rarer=rarer, describes=lambda *_: False, sticks=lambda _: True)
    assert not set(rarer).intersection(one.term for one in held.steps)


@pytest.mark.parametrize(
    ("law", "likely", "considered"),
    [
        ("toe", "quintic", True),
        ("exponential", "hardening", True),
        ("gear", "boucwen", True),
        ("toe", "maxwell", False),
    ],
)
def test_richer_laws_of_an_effect_are_considered_where_another_law_of_it_is_likely(
    monkeypatch: pytest.MonkeyPatch, law: str, likely: str, considered: bool
) -> None:
    moved = chirp(TIME)
    fits = Fits(Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES)), linear(moved), HIGHEST)
    monkeypatch.setattr(Fits, "fitness", lambda _self, terms: 0.0 if terms[-1] == likely else 1.0)
    monkeypatch.setattr(Fits, "is_rejected", lambda _self, terms: terms[-1] != likely)
    found = stepwise._likeliest(fits, RARER, (("linear", "offset"),))
    assert bool(law in found) is considered


@pytest.mark.study
def test_exponential_tendons_are_no_powers_with_a_gap() -> None:
    """Powers and flanks lower the fitness as well, of which the smaller model holds more."""
    moved = chirp(TIME)
    motion = Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    exponent = 1.5 / float(np.abs(moved.dtheta).max())
    torque = np.sign(moved.dtheta) * np.expm1(exponent * np.abs(moved.dtheta)) * KC / exponent + BC * moved.rate
    noisy = torque + 1e-5 * np.random.default_rng(4).standard_normal(SAMPLES)
    expected = "linear+exponential"
    found = select(motion, noisy, HIGHEST, rarer=RARER, describes=lambda one, _: one.model.name == expected)
    assert found.model.name == expected
    assert found.values[:2] == pytest.approx([KC, BC], rel=0.02)


@pytest.mark.study
def test_the_steps_end_at_a_rarer_model_that_describes_the_recording_but_for_errors_of_the_deflection() -> None:
    """A skew that errors of 10 mrad may make and errors of 0.1 mrad cannot, beside damping that rises with the rate."""
    moved, late = chirp(TIME), chirp(TIME - 5e-4)
    motion = Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    torque = CASES["linear+coulomb"](late) + 2e-5 * late.rate * np.abs(late.rate)
    noisy = torque + 5e-5 * np.random.default_rng(4).standard_normal(SAMPLES)
    found = [
        select(
            motion,
            noisy,
            HIGHEST,
            rarer=("quadratic",),
            describes=lambda one, _: "coulomb+quadratic" in one.model.name,
            window=with_error(error),
        ).model.name
        for error in (1e-4, 1e-2)
    ]
    assert found == ["linear+coulomb+quadratic+skew", "linear+coulomb+quadratic"]


@pytest.mark.study
def test_a_lag_that_a_skew_hides_is_an_alternative() -> None:
    moved = chirp(TIME - 1e-3)
    motion = Motion(TIME, chirp(TIME).dtheta, chirp(TIME).rate, chirp(TIME).acceleration, np.zeros(SAMPLES))
    noisy = linear(moved) + 5e-5 * np.random.default_rng(4).standard_normal(SAMPLES)
    found = select(motion, noisy, HIGHEST, rarer=("lag",), accounts=LATE)
    assert "skew" in found.model.name
    alternatives = {one.model.name: one.criterion for one in found.alternatives}
    assert alternatives[found.model.name.replace("skew", "lag")] > 0.0  # the skew is there


@pytest.mark.study
@pytest.mark.parametrize("known", [True, False])
def test_errors_of_the_acceleration_are_no_evidence_against_an_inertia(known: bool) -> None:
    """A torque that is read early has none of them, so that it fits better where there is an inertia."""
    moved, rng = chirp(TIME, high=6.0), np.random.default_rng(4)
    error = 0.15 * float(np.std(moved.acceleration))
    read = moved.acceleration + error * rng.standard_normal(SAMPLES)
    motion = Motion(TIME, moved.dtheta, moved.rate, read, np.zeros(SAMPLES))
    torque = linear(moved) + 4e-7 * moved.acceleration + 5e-5 * rng.standard_normal(SAMPLES)
    window = replace(with_error(0.0), of_acceleration=error) if known else None
    found = select(motion, torque, 6.0, ("offset", "skew"), accounts=EARLIER, window=window)
    assert found.model.name == "linear+skew"
    alternatives = {one.model.name: one.criterion for one in found.alternatives}
    assert bool(alternatives["linear+inertia"] < 10.0) is known


def test_a_skew_that_is_too_large_for_set_points_that_are_held_is_none() -> None:
    moved = chirp(TIME - 1e-3)
    motion = Motion(TIME, chirp(TIME).dtheta, chirp(TIME).rate, chirp(TIME).acceleration, np.zeros(SAMPLES))
    noisy = linear(moved) + 5e-5 * np.random.default_rng(4).standard_normal(SAMPLES)
    found = select(motion, noisy, HIGHEST, accounts=("skew",))
    assert found.model.name == "linear+skew"
    assert found.late is not None
    assert list(found.late._instead_of_the_skew(found.chosen)) == []


@pytest.mark.parametrize(("high", "times", "drives"), [(0.4, 17, 5), (HIGHEST, 0, 0)])
def test_each_likely_time_by_which_a_reading_is_late_moves_bc_by_kc_times_it(
    high: float, times: int, drives: int
) -> None:
    """All 6 delays, 11 lags and 5 drives are possible in slow motion, and none in fast motion."""
    moved = chirp(TIME, high=high)
    motion = Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    torque = KC * moved.dtheta + 4.0 * BC * moved.rate + 2e-4 * np.random.default_rng(4).standard_normal(SAMPLES)
    found = select(motion, torque, high, rarer=("lag",), accounts=LATE)
    assert found.model.name == "linear"
    assert len(found.lateness) == times + drives
    ticks, octaves = np.array([0.5, 1.0, 1.5, -0.5, -1.0, -1.5]), 2.0 ** (0.5 * np.arange(11))
    expected = KC * np.concatenate([ticks / RATE, octaves / (2.0 * np.pi * 480.0)])
    assert [one.Bc - found.values[1] for one in found.lateness[:times]] == pytest.approx(expected[:times], rel=0.05)


def test_a_late_torque_with_an_inertia_is_as_likely_as_one_in_three_and_not_in_ten() -> None:
    """In slow motion the data say nothing of a delay, so that only the odds differ."""
    moved, motion = slow()
    torque = KC * moved.dtheta + 4.0 * BC * moved.rate + 2e-4 * np.random.default_rng(4).standard_normal(len(motion))
    fits = Fits(motion, torque, 0.5)
    late = LateReading(fits, criterion.criterion_of(fits, ("skew",), ("linear",)), LATE)
    plain, with_inertia = (late.lateness(fits.candidate(one))[0] for one in (("linear",), ("linear", "inertia")))
    assert plain.criterion - with_inertia.criterion == pytest.approx(2.0 * math.log(10.0 / 3.0), abs=0.5)


def test_a_branch_beside_a_mean_is_not_replaced_by_a_lag_which_excludes_it() -> None:
    motion = Motion(TIME, chirp(TIME).dtheta, chirp(TIME).rate, chirp(TIME).acceleration, np.zeros(SAMPLES))
    fits = Fits(motion, linear(chirp(TIME)), HIGHEST)
    late = LateReading(fits, criterion.criterion_of(fits, ("skew",), ("linear",)), LATE)
    chosen = fits.candidate(("linear", "maxwell", "mean"))
    assert late.instead_of_branch(chosen) is chosen
    assert late.alternatives(chosen) == ()


def sheathed(moved: Moved, reach: float) -> Array:
    """Friction that builds up over `reach` rad, N m, integrated step by step."""
    states, state = np.empty(len(moved.time)), 0.0
    for at, step in enumerate(np.diff(moved.dtheta, prepend=moved.dtheta[0]).tolist()):
        state = np.sign(step) + (state - np.sign(step)) * np.exp(-abs(step) / reach)
        states[at] = state
    return 2e-3 * states


def slow() -> tuple[Moved, Motion]:
    """The joint moved so slowly that damping is next to nothing."""
    moved = Moved(*(part[::4] for part in chirp(TIME, 0.05, 0.5)))
    return moved, Motion(moved.time, moved.dtheta, moved.rate, moved.acceleration, np.zeros(len(moved.time)))


@pytest.mark.study
def test_friction_that_builds_up_takes_the_place_of_dry_friction_beside_a_gap() -> None:
    """Without damping nothing decides between the two kinds of gap, and the usual one is taken."""
    moved, motion = slow()
    torque = KC * np.sign(moved.dtheta) * np.maximum(np.abs(moved.dtheta) - 0.1, 0.0) + sheathed(moved, 0.02)
    torque += 1e-3 + 5e-5 * np.random.default_rng(1).standard_normal(len(torque))
    found = select(motion, torque, 0.5, rarer=("deadband", "dahl"), describes=lambda _found, _averaged: False)
    assert found.model.name == "linear+offset+dahl+backlash"
    assert found.values[0] == pytest.approx(KC, rel=0.02)


@pytest.mark.study
@pytest.mark.parametrize(("rise", "expected"), [(0.0, "dahl"), (0.6, "lugre")])
def test_friction_that_builds_up_falls_with_the_rate_only_where_it_does(rise: float, expected: str) -> None:
    moved, motion = slow()
    torque = KC * moved.dtheta + BC * moved.rate + 2e-3 * motion.bristles(0.02, rise, 0.3)
    torque += 2e-5 * np.random.default_rng(2).standard_normal(len(torque))
    found = select(motion, torque, 0.5, ("skew",), rarer=("dahl", "lugre"), describes=lambda *_: False)
    assert found.model.name == f"linear+{expected}"
    assert found.values[0] == pytest.approx(KC, rel=0.01)


def test_a_richer_law_is_held_against_the_model_in_the_place_of_the_law_that_it_contains() -> None:
    """`lugre` with no rise is `dahl`: it fits no worse, and does not pay for its two parameters more."""
    moved, motion = slow()
    torque = KC * moved.dtheta + BC * moved.rate + sheathed(moved, 0.02)
    torque += 2e-5 * np.random.default_rng(2).standard_normal(len(torque))
    found = select(motion, torque, 0.5, (), rarer=("dahl", "lugre"), describes=lambda *_: False)
    chosen, rejected = found.steps[-2:]
    assert (chosen.model, rejected.model) == ("linear+dahl", "linear+lugre")
    assert not rejected.included
    assert rejected.fitness <= 1.0001 * chosen.fitness
    assert rejected.gain < 0.0


@pytest.mark.study
def test_a_small_linear_term_is_held_against_the_model_whatever_hid_it_before() -> None:
    """Beside a dead band no step comes to damping that grows with the rate: other terms lower the fitness more."""
    moved = chirp(TIME)
    pushed = np.sign(moved.dtheta) * np.maximum(np.abs(moved.dtheta) - 0.05, 0.0)
    torque = KC * pushed + BC * moved.rate + 3e-7 * moved.rate * np.abs(moved.rate)
    torque += 2e-4 * np.random.default_rng(1).standard_normal(SAMPLES)
    motion = Motion(moved.time, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES), rate_noise=0.02)
    rarer = ("deadband", "asymmetric", "dahl", "progressive", "quadratic", "softening")
    found = select(motion, torque, HIGHEST, rarer=rarer, describes=lambda *_: False)
    assert found.model.name == "linear+offset+deadband"
    rejected = {step.term: step for step in found.steps if not step.included}
    assert "quadratic" in rejected
    assert rejected["quadratic"].Bc < found.values[1]


@pytest.mark.study
def test_a_term_that_makes_an_earlier_one_idle_is_still_judged_by_its_own_column() -> None:
    """With friction in proportion to the load, friction that falls with the rate is zero, and so is a column of it."""
    moved = chirp(TIME)
    torque = linear(moved) + (1e-3 + 0.1 * np.abs(linear(moved))) * np.sign(moved.rate)
    torque += 5e-5 * np.random.default_rng(1).standard_normal(SAMPLES)
    motion = Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    fits, terms = Fits(motion, torque, HIGHEST), ("coulomb", "stribeck", "capstan")
    smaller = fits.candidate(("linear", "offset", "coulomb", "stribeck"))
    larger = fits.candidate(("linear", "offset", "coulomb", "stribeck", "capstan"))
    assert larger.values["Fs"] == 0.0
    doubted = criterion.criterion_of(fits, terms, ("linear", "offset"), doubted=True)
    assert math.isfinite(doubted.correlation(larger, "capstan"))
    assert doubted.pays(smaller, larger, "capstan")
    assert not doubted.pays(fits.candidate(("linear", "offset", "coulomb", "capstan")), larger, "stribeck")
    assert doubted.correlation(fits.candidate(("linear",)), "linear") >= 1.0  # where there is no other term


@pytest.mark.study
def test_another_effect_is_looked_for_beside_the_one_found() -> None:
    """Friction in proportion to the load hides an inertia: three other terms lower the fitness more than it."""
    moved = chirp(TIME)
    carried = linear(moved)
    torque = carried + 0.15 * np.abs(carried) * np.sign(moved.rate) + 2e-7 * moved.acceleration
    torque += 2e-5 * np.random.default_rng(1).standard_normal(SAMPLES)
    motion = Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    rarer = ("stribeck", "dahl", "quintic", "softening", "maxwell", "capstan", "inertia")

    def describes(found: Selection, _averaged: bool) -> bool:
        return {"capstan", "inertia"} <= set(found.chosen.terms)

    found = select(motion, torque, HIGHEST, rarer=rarer, describes=describes)
    assert found.model.name == "linear+offset+inertia+capstan"


def test_friction_that_falls_with_speed_pays_with_the_damping_at_its_bound() -> None:
    moved, motion = slow()
    torque = KC * moved.dtheta + sheathed(moved, 0.02) - BC * moved.rate
    fits = Fits(motion, torque + 1e-4 * np.random.default_rng(1).standard_normal(len(torque)), 0.5)
    smaller, larger = fits.candidate(("linear",)), fits.candidate(("linear", "dahl"))
    assert larger.damping == 0.0 < smaller.damping
    assert larger.fit.fitness < 0.5 * smaller.fit.fitness
    assert criterion.criterion_of(fits, ("dahl",), ("linear",)).pays(smaller, larger, "dahl")


def test_where_something_is_not_described_a_term_is_judged_by_as_few_samples_as_any_other() -> None:
    """A swing of 0.1 Hz that no term has: the residuals are white at the skew's column, and slow at the offset's."""
    moved = chirp(TIME)
    swing = 5e-4 * np.sin(0.2 * np.pi * TIME)
    motion = Motion(TIME, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    fits = Fits(motion, linear(moved) + swing + 1e-4 * np.random.default_rng(1).standard_normal(SAMPLES), HIGHEST)
    fitted = fits.candidate(("linear", "offset", "skew"))
    usual, doubted = (
        criterion.criterion_of(fits, ("offset", "skew"), ("linear",), doubted=doubted) for doubted in (False, True)
    )
    assert usual.correlation(fitted, "skew") < 0.1 * usual.correlation(fitted, "offset")
    assert doubted.correlation(fitted, "skew") == usual.correlation(fitted, "offset")


def test_a_rarer_term_brings_what_it_needs_where_no_usual_model_has_it() -> None:
    moved, motion = slow()
    fits = Fits(motion, with_play(moved) + 5e-5 * np.random.default_rng(1).standard_normal(len(motion)), 0.5)
    assert stepwise._likeliest(fits, ("deadband",), (("linear",), ("linear", "cubic"))) == ("deadband",)


def test_two_laws_of_one_kind_and_what_rounds_friction_off_take_the_place_of_no_other_kind() -> None:
    order = ("capstan", "pulley", "smooth", "dahl", "quadratic", "softening", "inertia")
    fits = SimpleNamespace(fitness=lambda terms: 1.0 + order.index(terms[-1]), is_rejected=lambda _terms: False)
    found = stepwise._likeliest(cast("Fits", fits), order, (("linear", "offset", "coulomb"),))
    assert set(found) == {"capstan", "pulley", "smooth", "dahl", "quadratic"}


def test_a_law_pays_for_the_parameters_that_it_has_more_than_the_one_in_its_place() -> None:
    moved, motion = slow()
    torque = KC * moved.dtheta + sheathed(moved, 0.05) + 1e-3
    fits = Fits(motion, torque + 5e-5 * np.random.default_rng(1).standard_normal(len(torque)), 0.5)
    noise = criterion.criterion_of(fits, ("dahl",), ("linear", "offset"))
    plain, dahl, lugre = (fits.candidate(("linear", "offset", *one)) for one in ((), ("dahl",), ("lugre",)))
    costs = [noise.weighed(less, lugre, "lugre")[1] - math.log(noise.choices) for less in (plain, dahl)]
    assert costs[0] == pytest.approx(2.0 * costs[1])  # four parameters, or two


def stiffening() -> tuple[criterion.Criterion, Candidate, Candidate, Candidate]:
    """A criterion for which no likelihood ranks two models, and fits without a stiffening, with a cubic and a gap."""
    moved, motion = slow()
    torque = KC * np.sign(moved.dtheta) * np.maximum(np.abs(moved.dtheta) - 0.1, 0.0)
    fits = Fits(motion, torque + 1e-4 * np.random.default_rng(1).standard_normal(len(torque)), 0.5)
    noise = replace(criterion.criterion_of(fits, ("cubic", "backlash"), ("linear", "offset")), density=1e-3)
    names = (), ("cubic",), ("backlash",)
    plain, cubic, gap = (fits.candidate(("linear", "offset", *one)) for one in names)
    return noise, plain, cubic, gap


@pytest.mark.parametrize(("scatter", "expected"), [(0.1, "backlash"), (3.0, "cubic")])
def test_of_usual_terms_that_the_likelihood_cannot_rank_one_is_taken_that_clearly_predicts_better(
    scatter: float, expected: str
) -> None:
    noise, plain, cubic, gap = stiffening()
    ahead = 1e-4 * (1.0 + scatter * np.resize([1.0, -1.0], len(gap.held_out)))
    gap = replace(gap, held_out=cubic.held_out - ahead)
    assert noise.likeliest(plain, [gap, cubic]).terms[-1] == expected


@pytest.mark.parametrize(("ratio", "pays"), [(1.0, False), (5.0, True)])
def test_held_out_blocks_include_no_term_that_akaikes_criterion_is_against(ratio: float, pays: bool) -> None:
    noise, plain, cubic, _ = stiffening()
    cubic = replace(cubic, held_out=0.99 * plain.held_out)
    found = noise.ratio(plain, cubic) / noise.correlation(cubic, "cubic")
    noise = replace(noise, density=ratio * noise.density / found)
    assert not noise.pays(plain, cubic, "cubic")
    assert noise.pays(plain, cubic, "cubic", nearly=True) == pays


def test_a_joint_at_rest_whose_reading_repeats_one_count_is_not_without_noise() -> None:
    moved, count = chirp(TIME), 5e-3
    still = np.heaviside(TIME - 0.5 * TIME[-1], 1.0)
    dtheta, rate, acceleration = still * np.stack([moved.dtheta, moved.rate, moved.acceleration])
    motion = Motion(TIME, dtheta, rate, acceleration, np.zeros(SAMPLES))
    fits = Fits(motion, count * np.round(still * linear(moved) / count), HIGHEST)
    assert criterion.criterion_of(fits, (), ("linear",)).density <= 1.0 / count


def test_the_noise_is_that_of_models_fitted_once_whatever_the_order_of_their_terms(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fitted: list[str] = []

    def counted(problem: Problem, near: Mapping[str, float]) -> Fit:
        fitted.append(cast("CouplingModel", problem.model).name)
        return best_start(problem, near)

    monkeypatch.setattr(fits_module, "best_start", counted)
    moved = chirp(TIME)
    motion = Motion(*moved, np.zeros(SAMPLES))
    fits = Fits(motion, linear(moved) + 1e-4 * np.random.default_rng(1).standard_normal(SAMPLES), HIGHEST)
    usual = ("offset", "coulomb", "cubic")
    richest = criterion.criterion_of(fits, usual, ("linear", "offset")).richest
    assert len(richest) > 2
    criterion.criterion_of(fits, (*usual, "quadratic"), richest, doubted=True)
    assert len(fitted) == len(set(fitted)) > len(richest)


@pytest.mark.parametrize(("times", "stops"), [(3.0, False), (300.0, True)])
def test_a_spring_that_is_hundreds_of_times_as_stiff_in_one_direction_is_a_stop(times: float, stops: bool) -> None:
    """With such a spring as the richest model, its few samples beyond the stop would say how quiet all are."""
    moved = chirp(TIME)
    beyond = np.maximum(moved.dtheta - 0.25, 0.0)
    torque = linear(moved) + (times - 1.0) * KC * beyond + 1e-5 * np.random.default_rng(0).standard_normal(SAMPLES)
    motion = Motion(moved.time, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    assert Fits(motion, torque, HIGHEST).is_rejected(("linear", "offset", "asymmetric")) is stops


@pytest.mark.parametrize(
    ("beyond", "error", "expected"),
    [(0.0, 2e-3, "linear+offset"), (0.0, 5e-3, "linear+offset"), (0.02, 2e-3, "linear+offset+slack")],
)
def test_a_joint_that_rests_at_two_angles_is_slack_by_more_than_errors_of_these(
    beyond: float, error: float, expected: str
) -> None:
    """Where it rests, the errors of the readings are in no torque, and a tendon that is slack there takes them out."""
    generator = np.random.default_rng(0)
    starts = np.arange(0.25, SAMPLES / RATE, 0.5)
    turn = np.pi * np.clip((TIME[:, None] - starts) / 0.1, 0.0, 1.0)
    signs = np.where(np.arange(len(starts)) % 2 == 0, 1.0, -1.0)
    angle = 0.35 * ((1.0 - np.cos(turn)) @ signs - 1.0)
    rate, acceleration = 3.5 * np.pi * np.sin(turn) @ signs, 35.0 * np.pi**2 * np.cos(turn) * (np.sin(turn) > 0) @ signs
    pulled = np.maximum(angle + 0.35 - beyond, 0.0)
    torque = (KC * pulled + BC * rate) * (pulled > 0.0) + 2e-5 * generator.standard_normal(SAMPLES)
    read = angle + error * generator.standard_normal(SAMPLES)
    motion = Motion(TIME, read, rate, acceleration, np.zeros(SAMPLES))
    chosen = select(motion, torque, HIGHEST, ("offset", "slack"), window=with_error(error))
    assert chosen.model.name == expected


@pytest.mark.parametrize(
    ("gap", "centre", "is_error"), [(4e-3, -0.39, True), (4e-3, 0.39, True), (4e-3, 0.0, False), (0.1, -0.36, False)]
)
def test_a_gap_as_wide_as_the_errors_at_an_end_of_the_motion_is_none(gap: float, centre: float, is_error: bool) -> None:
    moved = chirp(TIME)
    angle = moved.dtheta * (0.39 / np.abs(moved.dtheta).max())
    motion = Motion(moved.time, angle, moved.rate, moved.acceleration, np.zeros(SAMPLES))
    terms = ("linear", "offset", "backlash")
    model = parse("+".join(terms)).anchored(motion)
    problem = Problem(model, motion, linear(moved), *model.bounds(motion, HIGHEST))
    found = Candidate(terms, model, problem, problem.solve(np.array([gap, centre])), np.empty(0), error=1e-3)
    assert found.is_impossible("backlash") is is_error


@pytest.mark.parametrize(("noise", "delay"), [(2e-4, 6e-4), (2e-4, 0.0), (2e-6, 1e-4)])
def test_the_skew_of_a_recorder_makes_a_model_likelier_by_the_integral_over_all_of_them(
    noise: float, delay: float
) -> None:
    """A tenth of a tick, one standard deviation, also where the data know the skew to a small part of that."""
    moved, tick = chirp(TIME), 1.0 / RATE
    torque = linear(chirp(TIME - delay)) + noise * np.random.default_rng(0).standard_normal(SAMPLES)
    fits = Fits(Motion(moved.time, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES)), torque, HIGHEST)
    late = LateReading(fits, criterion.criterion_of(fits, ("offset", "skew"), ("linear",)), LATE)
    chosen = fits.candidate(("linear",))
    skews = delay + 3e-5 * noise / 2e-4 * np.arange(-60.0, 61.0)
    tried = [fits.with_value(("linear", "skew"), chosen, skew) for skew in skews.tolist()]
    blurred = late.criterion.blurred(tried[0], "skew")
    likelier = np.exp(0.5 * np.array([late.criterion.ratio(chosen, one) for one in tried]) / blurred - 200.0)
    usual = 0.1 * tick
    density = np.exp(-0.5 * (skews / usual) ** 2) / (usual * math.sqrt(2.0 * math.pi))
    expected = 2.0 * (200.0 + math.log(float((likelier * density).sum() * (skews[1] - skews[0]))))
    assert late._with_usual_skew(chosen) == pytest.approx(expected, abs=1.5, rel=0.1)


@pytest.mark.parametrize("seed", [3, 5])
def test_noise_that_lasts_is_no_branch_in_place_of_a_skew(seed: int) -> None:
    """A branch that relaxes slowly follows a random walk, whose samples are no independent evidence."""
    moved = chirp(TIME)
    walk = np.cumsum(np.random.default_rng(seed).standard_normal(SAMPLES))
    torque = linear(chirp(TIME - 1e-3)) + 3e-4 * (walk - walk.mean()) / walk.std()
    fits = Fits(Motion(moved.time, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES)), torque, HIGHEST)
    late = LateReading(fits, criterion.criterion_of(fits, ("offset", "skew"), ("linear",)), LATE)
    branches = list(late._relaxing(fits.candidate(("linear", "skew"))))
    assert all(one.criterion > -10.0 for one in branches)
    assert branches


def test_a_branch_in_place_of_a_late_reading_is_any_of_those_that_stiffen_fast_motion_as_much() -> None:
    """In slow motion K1 (w tau1)^2 of K' and Bc + K1 tau1 of B' show, and not of which time constant they are."""
    moved, stiffening, seen = chirp(TIME), 0.5 * KC * 3e-3**2, BC + 0.5 * KC * 3e-3
    relaxing = KC * moved.dtheta + seen * moved.rate - stiffening * moved.acceleration
    torque = relaxing + 1e-5 * np.random.default_rng(1).standard_normal(SAMPLES)
    fits = Fits(Motion(moved.time, moved.dtheta, moved.rate, moved.acceleration, np.zeros(SAMPLES)), torque, HIGHEST)
    late = LateReading(fits, criterion.criterion_of(fits, ("offset", "skew"), ("linear",)), LATE)
    found = list(late._relaxing(fits.candidate(("linear", "skew"))))
    constants = np.geomspace(0.02, 1.0, 12)[1:4] / HIGHEST
    assert [one.Bc for one in found] == pytest.approx(seen - stiffening / constants, rel=0.01)
    assert [one.Kc for one in found] == pytest.approx([KC] * 3, rel=1e-3)


@pytest.mark.study
def test_beside_a_branch_a_second_one_stands_in_place_of_a_late_reading() -> None:
    """Of branches of 30 and of 3 ms the latter looks like a late reading. No model has the second without the first."""
    moved, noise = chirp(TIME), 1e-5 * np.random.default_rng(1).standard_normal(SAMPLES)
    angle = moved.dtheta
    relaxing = sum(part * (angle - lagged(TIME, angle, constant)) for part, constant in ((0.4, 0.03), (0.5, 3e-3)))
    torque = KC * angle + BC * moved.rate + KC * relaxing + noise
    fits = Fits(Motion(moved.time, angle, moved.rate, moved.acceleration, np.zeros(SAMPLES)), torque, HIGHEST)
    late = LateReading(fits, criterion.criterion_of(fits, ("offset", "skew"), ("linear",)), LATE)
    chosen = fits.candidate(("linear", "maxwell", "skew"))
    found = list(late._relaxing(chosen))
    assert chosen.damping > 1.1 * BC
    assert any(one.Bc == pytest.approx(BC, rel=0.1) for one in found)
    two = fits.candidate(("linear", "maxwell", "maxwell2"))
    others = [one.model.name.split("+") for one in late.alternatives(two)]
    assert any("maxwell" in one for one in others)
    assert all("maxwell" in one for one in others if "maxwell2" in one)


def test_a_second_branch_is_likely_only_beside_a_first_one() -> None:
    assert with_another(("linear",), "maxwell2", complete=True) == ("linear", "maxwell2")
    assert with_another(("linear",), "maxwell", complete=True) == ("linear", "maxwell")
    assert not is_addable("maxwell2", ("linear",))
