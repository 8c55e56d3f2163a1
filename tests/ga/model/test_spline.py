"""The spline that a motion is delayed by, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ga.model.spline import Spline


@pytest.mark.parametrize("count", [2, 3, 4, 5, 300])
def test_values_and_rates_are_those_of_scipy_between_uneven_knots_and_outside(count: int) -> None:
    rng = np.random.default_rng(count)
    knots, values = np.cumsum(rng.uniform(0.5, 1.5, count)), rng.standard_normal((4, count))
    times = np.sort(np.concatenate([rng.uniform(knots[0] - 1.0, knots[-1] + 1.0, 100), knots]))
    found, expected = Spline.through(knots, values), CubicSpline(knots, values.T)
    for one, other in ((found, expected), (found.changing(), expected.derivative())):
        np.testing.assert_allclose(one(times), other(times).T, atol=1e-9)


def test_one_knot_has_no_curve_through_it() -> None:
    with pytest.raises(ValueError, match="two knots"):
        Spline.through(np.zeros(1), np.zeros((4, 1)))
