"""What may make a torque late is weighed: a skew, a lag, an inertia, a branch that relaxes fast, or a drive."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.memory import lagged
from hil.identification.candidates.criterion import criterion_of
from hil.identification.candidates.fits import LATE, Candidate, Fits
from hil.identification.candidates.late import EARLIER, LateReading

from .chirps import BC, HIGHEST, KC, RATE, TIME, Moved, chirp, linear, noise, selected, signals, with_error

Array = NDArray[np.float64]


def late_reading(
    torque: Array, *terms: str, moved: Moved | None = None, highest: float = HIGHEST, accounts: tuple[str, ...] = LATE
) -> tuple[LateReading, Candidate]:
    """Return the causes of delay that are considered beside the model of these terms, and that model."""
    fits = Fits((moved or chirp()).motion, torque, highest)
    chosen = fits.candidate(("linear", *terms), {})
    return LateReading(fits, criterion_of(fits, chosen, 2), accounts), chosen


def test_a_lag_that_a_skew_hides_is_an_alternative() -> None:
    late, chosen = late_reading(linear(chirp(TIME - 1e-3)) + noise(5e-5), "skew")
    alternatives = {one.model.name: one.criterion for one in late.alternatives(chosen)}
    assert alternatives["linear+lag"] > 0.0  # the skew is there


@pytest.mark.study
@pytest.mark.parametrize("known", [True, False])
def test_errors_of_the_acceleration_are_no_evidence_against_an_inertia(known: bool) -> None:
    """A torque that is read early has none of them, so that it fits better where there is an inertia."""
    moved = chirp(high=6.0)
    error = 0.15 * float(np.std(moved.acceleration))
    read = moved._replace(acceleration=moved.acceleration + noise(error, 4))
    torque = linear(moved) + 4e-7 * moved.acceleration + noise(5e-5)
    window = replace(with_error(0.0), of_acceleration=error if known else 0.0)
    given = replace(signals(read.motion, torque, 6.0), window=window)
    found = selected(given, ("offset", "skew"), EARLIER)
    assert "skew" in found.chosen.terms
    (criterion,) = (one.criterion for one in found.alternatives if one.model.name.endswith("inertia"))
    assert bool(criterion < 10.0) is known


def test_a_skew_that_is_too_large_for_set_points_that_are_held_is_none() -> None:
    late, chosen = late_reading(linear(chirp(TIME - 1e-3)) + noise(5e-5), "skew", accounts=("skew",))
    assert list(late._instead_of_the_skew(chosen)) == []


@pytest.mark.parametrize(("high", "times", "drives"), [(0.4, 17, 5), (HIGHEST, 0, 0)])
def test_each_likely_time_by_which_a_reading_is_late_moves_bc_by_kc_times_it(
    high: float, times: int, drives: int
) -> None:
    """All 6 delays, 11 lags and 5 drives are possible in slow motion, and none in fast motion."""
    moved = chirp(high=high)
    torque = KC * moved.dtheta + 4.0 * BC * moved.rate + noise(2e-4, 4)
    late, chosen = late_reading(torque, moved=moved, highest=high)
    found = late.lateness(chosen)
    assert len(found) == times + drives
    ticks, octaves = np.array([0.5, 1.0, 1.5, -0.5, -1.0, -1.5]), 2.0 ** (0.5 * np.arange(11))
    expected = KC * np.concatenate([ticks / RATE, octaves / (2.0 * np.pi * 480.0)])
    assert [one.Bc - chosen.damping for one in found[:times]] == pytest.approx(expected[:times], rel=0.05)


def test_a_late_torque_with_an_inertia_is_as_likely_as_one_in_three_and_not_in_ten() -> None:
    """In slow motion the data say nothing of a delay, so that only the odds differ."""
    moved = chirp(high=0.4)
    late, plain = late_reading(KC * moved.dtheta + 4.0 * BC * moved.rate + noise(2e-4, 4), moved=moved, highest=0.4)
    with_inertia = late.fits.candidate(("linear", "inertia"), {})
    first, other = (late.lateness(one)[0].criterion for one in (plain, with_inertia))
    assert first - other == pytest.approx(2.0 * math.log(10.0 / 3.0), abs=0.5)


def test_a_branch_beside_a_mean_is_not_replaced_by_a_lag_which_excludes_it() -> None:
    late, chosen = late_reading(linear(chirp()), "maxwell", "mean")
    assert late.alternatives(chosen) == ()


@pytest.mark.parametrize(("size", "delay"), [(2e-4, 6e-4), (2e-4, 0.0), (2e-6, 1e-4)])
def test_the_skew_of_a_recorder_makes_a_model_likelier_by_the_integral_over_all_of_them(
    size: float, delay: float
) -> None:
    """A tenth of a tick, one standard deviation, also where the data know the skew to a small part of that."""
    late, _ = late_reading(linear(chirp(TIME - delay)) + noise(size, 0), "skew")
    chosen = late.fits.candidate(("linear",), {})
    skews = delay + 3e-5 * size / 2e-4 * np.arange(-60.0, 61.0)
    tried = [late.fits.with_value(("linear", "skew"), chosen, skew) for skew in skews.tolist()]
    blurred = late.criterion.blurred(tried[0], "skew")
    likelier = np.exp(0.5 * np.array([late.criterion.ratio(chosen, one) for one in tried]) / blurred - 200.0)
    usual = 0.1 / RATE
    density = np.exp(-0.5 * (skews / usual) ** 2) / (usual * math.sqrt(2.0 * math.pi))
    expected = 2.0 * (200.0 + math.log(float((likelier * density).sum() * (skews[1] - skews[0]))))
    assert late._with_usual_skew(chosen) == pytest.approx(expected, abs=1.5, rel=0.1)


@pytest.mark.parametrize("seed", [3, 5])
def test_noise_that_lasts_is_no_branch_in_place_of_a_skew(seed: int) -> None:
    """A branch that relaxes slowly follows a random walk, whose samples are no independent evidence."""
    walk = np.cumsum(noise(1.0, seed))
    torque = linear(chirp(TIME - 1e-3)) + 3e-4 * (walk - walk.mean()) / walk.std()
    late, chosen = late_reading(torque, "skew")
    branches = list(late._relaxing(chosen))
    assert all(one.criterion > -10.0 for one in branches)
    assert branches


def test_a_branch_in_place_of_a_late_reading_is_any_of_those_that_stiffen_fast_motion_as_much() -> None:
    """In slow motion K1 (w tau1)^2 of K' and Bc + K1 tau1 of B' show, and not of which time constant they are."""
    moved, stiffening, seen = chirp(), 0.5 * KC * 3e-3**2, BC + 0.5 * KC * 3e-3
    torque = KC * moved.dtheta + seen * moved.rate - stiffening * moved.acceleration + noise(1e-5)
    late, chosen = late_reading(torque, "skew")
    found = list(late._relaxing(chosen))
    constants = np.geomspace(0.02, 1.0, 12)[1:4] / HIGHEST
    assert [one.Bc for one in found] == pytest.approx(seen - stiffening / constants, rel=0.01)
    assert [one.Kc for one in found] == pytest.approx([KC] * 3, rel=1e-3)


@pytest.mark.study
def test_beside_a_branch_a_second_one_stands_in_place_of_a_late_reading() -> None:
    """Of branches of 30 and of 3 ms the latter looks like a late reading. No model has the second without the first."""
    angle = chirp().dtheta
    relaxing = sum(part * (angle - lagged(TIME, angle, constant)) for part, constant in ((0.4, 0.03), (0.5, 3e-3)))
    late, chosen = late_reading(linear(chirp()) + KC * relaxing + noise(1e-5), "maxwell", "skew")
    found = list(late._relaxing(chosen))
    assert chosen.damping > 1.1 * BC
    assert any(one.Bc == pytest.approx(BC, rel=0.1) for one in found)
    two = late.fits.candidate(("linear", "maxwell", "maxwell2"), {})
    others = [one.model.name.split("+") for one in late.alternatives(two)]
    assert any("maxwell" in one for one in others)
    assert all("maxwell" in one for one in others if "maxwell2" in one)
