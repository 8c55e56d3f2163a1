"""The local polynomial against polynomials, sines and its own stated gain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil.signals.constants import DEGREE
from hil.signals.rate.savitzky_golay import gain, kernel, local_polynomial, widest

Array = NDArray[np.float64]


@settings(max_examples=10)
@given(st.integers(6, 30), st.integers(0, 2**32 - 1))
def test_it_gives_back_any_polynomial_of_its_degree_on_any_stamps(half: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.7, 1.3, 90)) / 90.0
    polynomial = np.polynomial.Polynomial(rng.uniform(-1.0, 1.0, DEGREE + 1))
    value, slope, curvature = (local_polynomial(time, polynomial(time), half, order) for order in range(3))
    np.testing.assert_allclose(value, polynomial(time), atol=1e-8)
    np.testing.assert_allclose(slope, polynomial.deriv()(time), atol=1e-5)
    np.testing.assert_allclose(curvature, polynomial.deriv(2)(time), atol=1e-2)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_sine_has_the_stated_gain_and_no_phase(order: int) -> None:
    time, omega = np.arange(4000) / 500.0, 2.0 * np.pi * 20.0
    found = local_polynomial(time, np.sin(omega * time), 14, order)[100:-100] / omega**order
    inner = omega * time[100:-100]
    wave, quadrature = (np.cos(inner), np.sin(inner)) if order == 1 else (np.sin(inner), np.cos(inner))
    sign = -1.0 if order == 2 else 1.0
    fit = np.linalg.lstsq(np.column_stack([sign * wave, quadrature]), found, rcond=None)[0]
    assert fit[0] == pytest.approx(gain(14, order, 20.0 / 500.0), rel=1e-9)
    assert abs(fit[0] - 1.0) > 1e-4  # or the gain would not be tested
    assert fit[1] == pytest.approx(0.0, abs=1e-9)


def test_the_kernel_is_what_the_fit_does_to_a_single_reading() -> None:
    time, impulse = np.arange(41, dtype=np.float64), np.zeros(41)
    impulse[20] = 1.0
    for order in range(3):
        weights = local_polynomial(time, impulse, 8, order)[12:29]
        np.testing.assert_allclose(weights, kernel(8, order)[::-1], atol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_the_window_is_the_widest_within_the_tolerance(order: int) -> None:
    half = widest(order, 15.0 / 500.0, most=250, tolerance=3e-4)
    assert abs(gain(half, order, 15.0 / 500.0) - 1.0) <= 3e-4 < abs(gain(half + 1, order, 15.0 / 500.0) - 1.0)
    assert widest(order, 15.0 / 500.0, most=6, tolerance=3e-4) == 6


def by_least_squares(time: Array, values: Array, half: int) -> Array:
    """Value, slope and curvature (3, n) by the definition: a polynomial fitted to each window on its own."""
    found, width = [], 2 * half + 1
    for at in range(len(time)):
        start = min(max(at - half, 0), len(time) - width)
        window = slice(start, start + width)
        fit = np.polynomial.Chebyshev.fit(time[window], values[window] - values[at], DEGREE)
        found.append([fit(time[at]) + values[at], *(fit.deriv(order)(time[at]) for order in (1, 2))])
    return np.array(found).T


@pytest.mark.parametrize(("half", "jitter"), [(40, 0.0), (40, 1e-4), (4, 0.5)], ids=["even", "nearly even", "uneven"])
def test_sums_and_kernels_shared_by_many_windows_give_what_each_window_gives(half: int, jitter: float) -> None:
    rng = np.random.default_rng(half)
    time = (np.arange(300) + rng.uniform(0.0, jitter, 300)) / 500.0
    values = 6.0 + np.sin(40.0 * time) + 1e-3 * rng.standard_normal(300)
    for order, expected in enumerate(by_least_squares(time, values, half)):
        found = local_polynomial(time, values, half, order)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=3e-12 * np.abs(expected).max())


@pytest.mark.parametrize("gap", [1.0, 100.0])
def test_across_a_gap_the_slope_is_no_number_or_none_that_the_readings_do_not_have(gap: float) -> None:
    time = np.arange(60) / 500.0
    time[30:] += gap
    slope = local_polynomial(time, np.full(60, -0.2) + 1e-12 * np.arange(60), 6, 1)
    known = np.isfinite(slope)
    assert known[:20].all()
    assert known[-20:].all()
    assert np.abs(slope[known]).max() < 1e-6


def test_a_gap_in_time_costs_only_the_windows_that_span_it() -> None:
    time = np.arange(400) / 500.0
    time[200:] += 30.0
    values, half = np.sin(time), 40
    before, after = slice(0, 200 - half), slice(200 + half, 400)
    found = local_polynomial(time, values, half, 1)
    for part in (before, after):
        np.testing.assert_allclose(found[part], np.cos(time[part]), atol=1e-6)


@pytest.mark.parametrize("jitter", [0.0, 0.5], ids=["even stamps", "uneven"])
def test_a_long_recording_in_threads_gives_what_its_parts_give(jitter: float) -> None:
    rng = np.random.default_rng(0)
    time = (np.arange(80_000) + rng.uniform(0.0, jitter, 80_000)) / 500.0
    values = np.sin(time)
    whole = local_polynomial(time, values, 20, 1)
    for begin in range(0, 80_000, 15_000):
        part = slice(begin, begin + 15_000)
        inner = local_polynomial(time[part], values[part], 20, 1)[40:-40]
        np.testing.assert_allclose(whole[part][40:-40], inner, rtol=0.0, atol=1e-10)
