"""What an interval consists of: each source once, and together the interval that is reported."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.identification.identify import identify
from hil.identification.mixture.width import Width, beyond, combined
from hil.report.identification import identification_lines
from hil.report.identification_json import as_json

from ..conftest import Maker, edited
from .conftest import SEARCH
from .test_averaging import sweep

ARRAY = np.array


def test_independent_errors_combine_as_squares_and_ranges_are_added() -> None:
    noise, choice = Width("noise", ARRAY([3.0, np.inf])), Width("choice of the model", ARRAY([4.0, 1.0]))
    span = Width("range of Kc", ARRAY([2.0, 0.0]), is_range=True)
    assert combined([noise, choice, span]).tolist() == [7.0, np.inf]


def test_what_widens_combines_with_the_narrow_width_to_the_wide_one() -> None:
    assert beyond(ARRAY([5.0, 2.0, np.inf]), ARRAY([3.0, 3.0, np.inf])).tolist() == [4.0, 0.0, 0.0]


def test_the_sources_of_an_interval_make_the_whole_of_it_and_are_printed_the_largest_first(
    make_recording: Maker,
) -> None:
    path = make_recording(samples=1200, change=lambda channels: sweep(channels, 1e-4, 0))
    with edited(path) as file:
        file.attrs.update(torque_uncertainty=0.02, torque_scale="the MX-64")
    found = identify([path], None, SEARCH)
    for name in ("Kc", "Bc"):
        estimate, parts = found[name], dict(found[name].widths)
        assert {"noise", "choice of the model", "torque's scale"} <= set(parts)
        scale, misfit = parts.pop("torque's scale"), parts.pop("misfit of the model", 0.0)
        assert math.hypot(misfit + math.hypot(*parts.values()), scale) == pytest.approx(estimate.half_width, rel=1e-6)
        assert as_json(found)["parameters"][name]["widths"] == pytest.approx(estimate.widths)
        line = next(one for one in identification_lines(found) if one.startswith(f"half the interval of {name} is "))
        said = [float(part.split()[-2]) for part in line.split(": ")[1].split(", ")]
        assert said == sorted(said, reverse=True)
        assert said[0] == pytest.approx(100.0 * max(estimate.widths.values()) / estimate.value, rel=0.06)
