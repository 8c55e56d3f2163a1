from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from ga.model.trajectory import Motion
from hil.signals.slow_channel import Readings, kind_of, noise_beside_any_shape, readings, stamped

Array = NDArray[np.float64]
TICKS = np.arange(5000) / 500.0
OMEGA = 2.0 * np.pi * 5.0


def torque(time: Array) -> Array:
    return np.asarray(0.1 * np.sin(OMEGA * time) + 0.02 * np.sin(1.7 * OMEGA * time))


def noisy(time: Array) -> Array:
    return torque(time) + 1e-3 * np.random.default_rng(1).standard_normal(len(time))


def conversions(hertz: float, jitter: float = 0.0) -> Array:
    steps = (1.0 + jitter * np.random.default_rng(2).uniform(-1.0, 1.0, 3000)) / hertz
    return np.cumsum(steps) - 0.0123


def held(at: Array, values: Array) -> Array:
    return np.asarray(values[np.searchsorted(at, TICKS, side="right") - 1])


@pytest.mark.parametrize("hertz", [30.0, 80.3, 217.0])
def test_a_held_cell_is_read_when_it_converted(hertz: float) -> None:
    at = conversions(hertz)
    logged = held(at, noisy(at))
    assert kind_of(TICKS, logged) == "held"
    found = readings(TICKS, logged, "held")
    nearest = at[np.abs(at[:, None] - found.time).argmin(axis=0)]
    assert np.abs(found.time - nearest).max() < max(2e-4, found.unsure)
    assert found.unsure < 7e-4
    np.testing.assert_array_equal(found.value, logged[found.row])


def test_the_age_of_readings_at_a_multiple_of_the_ticks_is_unsure_by_a_tick() -> None:
    at = conversions(100.0)
    found = readings(TICKS, held(at, noisy(at)), "held")
    assert found.unsure == pytest.approx(2e-3, rel=0.05)
    assert np.abs(found.time - np.round((found.time - at[0]) * 100.0) / 100.0 - at[0]).max() <= 1e-3


@pytest.mark.study
def test_an_uneven_cell_was_read_between_two_ticks() -> None:
    at = conversions(80.0, jitter=0.5)
    found = readings(TICKS, held(at, noisy(at)), "held")
    nearest = at[np.abs(at[:, None] - found.time).argmin(axis=0)]
    assert np.abs(found.time - nearest).max() <= 1.01e-3
    assert abs(float(np.mean(found.time - nearest))) < 1e-4


@pytest.mark.parametrize(("hertz", "decimals"), [(30.0, 12), (80.3, 12), (80.3, 5), (217.0, 12)])
def test_the_corners_of_joined_readings_are_the_readings(hertz: float, decimals: int) -> None:
    at = conversions(hertz)
    values = noisy(at)
    logged = np.round(np.interp(TICKS, at, values), decimals)
    assert kind_of(TICKS, logged) == "joined"
    found = readings(TICKS, logged, "joined")
    place = np.abs(at[:, None] - found.time).argmin(axis=0)
    assert len(found.time) > 0.9 * 10.0 * hertz
    tolerance = 1e-6 if decimals == 12 else 4e-4
    assert np.quantile(np.abs(found.time - at[place]), 0.98) < tolerance
    assert np.abs(found.value - np.interp(found.time, at, values)).max() < 1e-8 + 3.0 * 10.0**-decimals


def test_lines_of_ten_samples_written_in_seven_digits_are_lines() -> None:
    """Digits that count from the first that is not zero round larger values more."""
    time, at = np.arange(20_000) / 1000.0, np.arange(2001) / 100.0
    logged = np.array([float(f"{value:.7g}") for value in np.interp(time, at, noisy(at))])
    assert kind_of(time, logged) == "joined"
    found = readings(time, logged, "joined")
    assert len(found.time) > 0.95 * len(at)
    assert np.quantile(np.abs(found.time - np.round(found.time, 2)), 0.98) < 1e-5


@pytest.mark.parametrize("digits", [7, 17])
def test_a_smooth_sweep_is_no_line_where_it_is_slow(digits: int) -> None:
    time = np.arange(20_000) / 1000.0
    growth = np.log(150.0) / 20.0
    angle = 0.2 * np.sin(2.0 * np.pi * 0.1 * np.expm1(growth * time) / growth)
    assert kind_of(time, np.array([float(f"{value:.{digits}g}") for value in angle])) is None


def coarse(values: Array, count: float) -> Array:
    return np.asarray(count * np.round(values / count))


@pytest.mark.parametrize(
    "values",
    [
        noisy(TICKS),
        torque(TICKS),
        coarse(noisy(TICKS), 1e-3),
        coarse(torque(TICKS), 5e-3),
        coarse(torque(TICKS), 0.04),
        coarse(torque(TICKS / 50.0), 1e-3),
        np.abs((TICKS % 2.0) - 1.0),
        coarse(np.abs((TICKS % 2.0) - 1.0), 0.01),
        np.where(TICKS % 1.0 < 0.5, 0.1, -0.1),
        np.where(TICKS < 5.0, 0.0, noisy(TICKS)),
    ],
    ids=["noisy", "exact", "counts", "coarse", "few counts", "slow", "ramp", "coarse ramp", "square", "rest"],
)
def test_a_sensor_that_is_read_at_every_tick_is_not_slow(values: Array) -> None:
    assert kind_of(TICKS, values) is None


@pytest.mark.parametrize("count", [1e-12, 1e-7, 2.4e-5, 3e-4, 3e-3])
@pytest.mark.parametrize("top", [1.0, 12.0, 60.0])
def test_a_smooth_motion_in_counts_is_not_slow(count: float, top: float) -> None:
    chirp = 0.25 * np.sin(2.0 * np.pi * (0.3 * TICKS + 0.05 * (top - 0.3) * TICKS**2))
    frequency = 0.1 * np.arange(1.0, 10.0 * top, top / 1.2)
    phases = np.random.default_rng(7).uniform(0.0, 2.0 * np.pi, len(frequency))
    sines = 0.03 * np.sin(2.0 * np.pi * np.outer(TICKS, frequency) + phases).sum(axis=1)
    for motion in (chirp, sines):
        assert kind_of(TICKS, coarse(motion, count)) is None


def test_readings_beside_a_lost_reply_have_no_known_age() -> None:
    at = conversions(80.0)
    there = np.random.default_rng(3).uniform(size=len(TICKS)) > 0.05
    time, logged = TICKS[there], held(at, noisy(at))[there]
    found = readings(time, logged, "held")
    assert kind_of(time, logged) == "held"
    assert (np.diff(time)[found.row - 1] < 3e-3).all()
    assert len(found.time) > 600


def with_play(angle: Array, rate: Array) -> Array:
    return np.asarray(0.3 * (angle - np.clip(angle, -0.1, 0.1)) + 3e-3 * rate)


def test_a_pace_that_crosses_the_ticks_once_is_sure_where_it_does_and_may_drift() -> None:
    """One reading in three ticks, 150 ppm late: its phase is known in the middle, and off by 0.5 ms at the ends."""
    at = 5.0001 + (np.arange(1664, dtype=np.float64) - 832.0) * 6e-3 * (1.0 + 1.5e-4)
    found = readings(TICKS, held(at, noisy(at)), "held")
    own = at[np.searchsorted(0.5 * (at[1:] + at[:-1]), found.time)]
    off = np.abs(found.time - own)
    assert off.max() > 2e-4
    assert found.unsure < 1e-3
    assert off.max() < found.drifts
    assert found.drifts < 4e-3


def test_stamped_readings_are_those_with_a_new_stamp() -> None:
    found = stamped(np.array([np.nan, 0.1, 0.1, 0.3, np.nan, 0.4]), np.arange(6.0))
    np.testing.assert_array_equal(found.row, [1, 3, 5])
    np.testing.assert_array_equal(found.value, [1.0, 3.0, 5.0])


def test_a_channel_without_motion_is_not_slow() -> None:
    assert kind_of(TICKS, np.full(5000, 0.3)) is None


@pytest.mark.parametrize(("dwell", "damping", "omega"), [(0.11, 0.6, 95.0), (0.11, 0.8, 95.0), (0.2, 0.7, 95.0)])
def test_a_motion_that_comes_to_rest_between_two_places_is_not_slow(dwell: float, damping: float, omega: float) -> None:
    """Where it is slow, or turns the other way, a few readings lie on a line to their counts."""
    phase, faster = omega * np.mod(TICKS, dwell), np.sqrt(1.0 - damping**2)
    wave = np.cos(faster * phase) + damping / faster * np.sin(faster * phase)
    settled = 1.0 - np.exp(-damping * phase) * wave
    place = 0.02 * np.where(np.mod(TICKS, 2.0 * dwell) < dwell, 1.0 - 2.0 * settled, 2.0 * settled - 1.0)
    assert kind_of(TICKS, coarse(place, 1e-6)) is None


def test_a_few_readings_say_nothing_of_their_noise() -> None:
    still = np.zeros(5000)
    motion = Motion(TICKS, np.sin(OMEGA * TICKS), OMEGA * np.cos(OMEGA * TICKS), still, still)
    few = np.linspace(1.0, 2.0, 20)
    assert noise_beside_any_shape(Readings(np.arange(20), few, torque(few)), motion) == 0.0
    late = few + 100.0
    assert noise_beside_any_shape(Readings(np.arange(20), late, torque(late)), motion) == 0.0


def test_the_noise_of_a_slow_cell_is_what_no_torque_of_the_motion_explains() -> None:
    """Between two readings the joint moves by up to its range: a line through three shows three times that noise."""
    fine = np.arange(99_000) / 10_000.0
    omega = 2.0 * np.pi * 12.0
    command = np.where((fine / 0.1).astype(int) * 7 % 5 < 2, 0.2, -0.2)
    drive = [omega**2], [1.0, 1.6 * omega, omega**2]
    system = cont2discrete(drive, 1e-4)
    angle = lfilter(system[0].ravel(), system[1], command)
    rate = np.gradient(angle, fine)
    at = np.arange(0.05, 9.8, 1.0 / 95.8)
    noise = 3e-4 * np.random.default_rng(8).standard_normal(len(at))
    values = with_play(np.interp(at, fine, angle), np.interp(at, fine, rate)) + noise
    ticks = slice(None, None, 20)
    motion = Motion(fine[ticks], angle[ticks], rate[ticks], np.gradient(rate, fine)[ticks], np.zeros(4950))
    found = noise_beside_any_shape(Readings(np.arange(len(at)), at, values), motion)
    assert found == pytest.approx(3e-4, rel=0.25)
    steps = np.abs(values[2:] - 2.0 * values[1:-1] + values[:-2]) / np.sqrt(6.0)
    assert 1.4826 * np.median(steps) > 3.0 * found
