"""Each effect has its column, also for stretches of a few samples."""

from __future__ import annotations

import numpy as np
import pytest

from hil.uncertainty.effects import EFFECTS, Effect, Recorded, reading_noise


def _in_stretches(*lengths: int) -> Recorded:
    time = np.arange(sum(lengths)) / 500.0
    deflection = 0.2 * np.sin(2.0 * np.pi * 1.3 * time) + 1e-4 * np.random.default_rng(5).standard_normal(len(time))
    starts = (0, *np.cumsum(lengths)[:-1].tolist())
    return Recorded(time, 0.3 * deflection, deflection, np.gradient(deflection, time), starts)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.code)
def test_an_effect_has_a_finite_column_where_stretches_are_short(effect: Effect) -> None:
    recorded = _in_stretches(400, 1, 2, 3, 6, 7, 381)
    for columns in effect.signature(recorded, recorded.torque):
        assert columns.shape[0] == 800
        assert np.isfinite(columns).all()


def test_the_noise_of_readings_is_taken_within_a_stretch_and_not_at_its_ends() -> None:
    recorded = _in_stretches(100, 4, 9)
    noise, value = reading_noise(recorded), recorded.deflection
    # the sixth difference of binomial weights, scaled to 1 at the middle
    expected = sum(w * value[50 + k] for k, w in enumerate((-1, 6, -15, 20, -15, 6, -1), start=-3)) / 20.0
    assert noise[50] == pytest.approx(expected, abs=1e-15)
    assert np.flatnonzero(noise).tolist() == [*range(3, 97), *range(107, 110)]
