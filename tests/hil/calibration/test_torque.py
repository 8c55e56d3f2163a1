"""The scale of a torque cell from known loads: its interval, its hysteresis, and loads that cannot be right."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.calibration.torque import GRAVITY, Point, fit, implausible
from hil.errors import Untrustworthy, WrongUse

SCALE, OFFSET, ARM = 1.03e-7, 400.0, 0.05
BOTH_WAYS = (0.0, 0.02, 0.05, 0.1, 0.05, 0.02, 0.0, -0.05, -0.1, -0.05, 0.0)


def points(
    masses: tuple[float, ...], noise: float = 0.0, seed: int = 0, typed: dict[int, float] | None = None
) -> list[Point]:
    """Points of masses, kg, on a cell of `SCALE`; typed: the masses that were typed instead, by their place."""
    rng = np.random.default_rng(seed)
    hung = [mass * GRAVITY * ARM for mass in masses]
    said = [(typed or {}).get(place, mass) for place, mass in enumerate(masses)]
    return [
        Point(mass * GRAVITY * ARM, torque / SCALE + OFFSET + noise * rng.standard_normal(), f"the weight {mass:g} kg")
        for torque, mass in zip(hung, said, strict=True)
    ]


def test_a_line_without_noise_is_found_exactly() -> None:
    found = fit(points(BOTH_WAYS))
    assert found.scale == pytest.approx(SCALE, rel=1e-9)
    assert found.offset == pytest.approx(OFFSET, rel=1e-6)
    assert found.uncertainty < 1e-9
    assert not found.one_sided


def test_five_weights_reproduce_a_known_scale_within_the_stated_interval_in_95_of_100_runs() -> None:
    """Student's t with 3 degrees of freedom; a normal interval would hold 86 of 100."""
    runs = 200
    inside = 0
    for seed in range(runs):
        low, high = fit(points((0.02, 0.05, 0.1, 0.05, -0.1), noise=2000.0, seed=seed)).ci95
        inside += low <= SCALE <= high
    assert inside / runs == pytest.approx(0.95, abs=3.0 * math.sqrt(0.95 * 0.05 / runs))


def test_the_error_of_the_lever_is_part_of_the_interval() -> None:
    rng = np.random.default_rng(1)
    runs, inside = 200, 0
    for seed in range(runs):
        error = 1.0 + 0.01 * rng.standard_normal()
        read = [Point(p.torque / error, p.value, p.name) for p in points((0.02, 0.05, 0.1), noise=200.0, seed=seed)]
        low, high = fit(read, 0.01).ci95
        inside += low <= SCALE <= high
    assert inside / runs > 0.9


def test_hysteresis_is_the_difference_between_loading_and_unloading() -> None:
    way = points(BOTH_WAYS)
    came = np.sign(np.diff([p.torque for p in way], prepend=0.0))
    lagging = [Point(p.torque, p.value - 500.0 * c, p.name) for p, c in zip(way, came, strict=True)]
    assert fit(lagging).hysteresis == pytest.approx(1000.0 * SCALE, rel=0.02)
    assert math.isnan(fit(points((0.0, 0.05, 0.1))).hysteresis)


@pytest.mark.parametrize("place", [2, 3, 9])
def test_one_weight_typed_in_grams_is_recognised_by_the_others(place: int) -> None:
    wrong = points(BOTH_WAYS, typed={place: 1e3 * BOTH_WAYS[place]})
    assert "grams" in implausible(wrong, None)
    assert wrong[place].name in implausible(wrong, None)


def test_weights_all_typed_in_grams_are_recognised_by_the_stands_limit() -> None:
    wrong = points(BOTH_WAYS, typed={place: 1e3 * mass for place, mass in enumerate(BOTH_WAYS)})
    assert not implausible(wrong, None)
    assert "49 N m, 1634 times limits.torque" in implausible(wrong, 0.03)
    assert not implausible(points(BOTH_WAYS), 0.03)


def test_a_cell_wired_the_wrong_way_round_is_refused_with_the_remedy() -> None:
    turned = [Point(-p.torque, p.value, p.name) for p in points(BOTH_WAYS)]
    with pytest.raises(Untrustworthy, match=r"wired the wrong way round.*sign"):
        fit(turned)


def test_a_cell_that_does_not_answer_to_the_load_is_refused() -> None:
    rng = np.random.default_rng(0)
    for noise in (0.0, 100.0):
        with pytest.raises(Untrustworthy, match="does not follow the load"):
            fit([Point(p.torque, 7.0 + noise * rng.standard_normal(), p.name) for p in points(BOTH_WAYS)])


def test_points_that_are_not_on_a_line_are_refused_and_the_worst_is_named() -> None:
    bent = points(BOTH_WAYS)
    bent[3] = Point(0.5 * bent[3].torque, bent[3].value, "the wrong one")
    with pytest.raises(Untrustworthy, match=r"not on a line.*the wrong one"):
        fit(bent)


@pytest.mark.parametrize("masses", [(), (0.1,), (0.1, 0.2), (0.1, 0.1, 0.1)])
def test_too_few_different_loads_are_refused(masses: tuple[float, ...]) -> None:
    with pytest.raises(WrongUse, match="three points or more"):
        fit(points(masses))
