"""The windows of the rate: where the rate that they give is sure."""

from __future__ import annotations

import numpy as np

from hil.signals.savitzky_golay import local_polynomial
from hil.signals.windows import is_smooth


def test_the_rate_is_sure_but_for_the_samples_beside_a_jerk_whatever_the_noise() -> None:
    """An acceleration that changes sign every 0.1 s; the noise is that of which the window was made for."""
    time = np.arange(2000) / 500.0
    phase = np.mod(time, 0.2)
    rate = np.where(phase < 0.1, phase - 0.05, 0.15 - phase) * 10.0
    angle = np.cumsum(rate) / 500.0
    seen = local_polynomial(time, angle, 6, 1)
    beside = np.abs(np.mod(time + 0.05, 0.1) - 0.05)  # s from the nearest change
    sure = is_smooth(time, angle, seen)
    assert np.mean(sure[30:-30][beside[30:-30] < 0.005]) < 0.6
    assert sure[30:-30][beside[30:-30] > 0.03].all()
    smooth = np.sin(8.0 * time) + 1e-3 * np.random.default_rng(0).standard_normal(2000)
    assert np.mean(is_smooth(time, smooth, local_polynomial(time, smooth, 6, 1))) > 0.999
