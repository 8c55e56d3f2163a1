"""The uncertainty of the torque's scale, in the intervals of what is proportional to the torque."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import pytest

import hil as api
from hil.campaign.results import Measured, Value, _line
from hil.identification.result import with_scale
from hil.report.identification import summary_lines

from ..conftest import Maker, edited
from .test_identifiability import estimate

CASES = ((0.25, "", 0.25), (0.5, "", 0.5), (0.25, "0.02", 0.02), (0.25, "0.0", 0.0), (math.nan, "", 0.0))
"""The drive's uncertainty, the stand file's, and what the intervals include."""


def test_every_interval_of_what_the_torque_scales_includes_its_scale_and_no_other_does(
    make_recording: Maker,
) -> None:
    path = make_recording(noise=2e-5, samples=1200)
    before = api.identify(path, "linear+skew", trials=1).as_json()["parameters"]
    for drive, stand, included in CASES:
        with edited(path) as file:
            file.attrs.update(torque_uncertainty=drive, torque_scale="the MX-64")
            file.attrs["stand_toml"] = f"[stand]\ntorque_uncertainty = {stand}" if stand else ""
        found = api.identify(path, "linear+skew", trials=1)
        for name, one in found.as_json()["parameters"].items():
            scale = 1.959964 * included * one["value"] * (name != "skew")
            half = math.hypot(before[name]["ci95"][1] - before[name]["value"], scale)
            assert half == pytest.approx(one["ci95"][1] - one["value"], rel=1e-6)
            assert one["ci95_without_torque_scale"] == before[name]["ci95"]
        assert found.trustworthy  # the recording identifies both, and the intervals are true
        assert [one.code for one in found.diagnostics].count("wide-interval") == (included > 0.05)
        line = "torque scale: neither" if math.isnan(drive) else f"{100 * included:g} % (standard uncertainty); if it"
        said = "\n".join(summary_lines(found.identification))  # which the command prints
        assert (line in said) == (included != 0.0 or math.isnan(drive))


def test_each_end_of_a_range_of_values_moves_by_its_own_uncertainty() -> None:
    one = with_scale(replace(estimate("Kc", 15.0, 5.0), depends_on="amplitude"), 0.1)
    assert one.ci95 == pytest.approx((10.0 - 1.959964, 20.0 + 2.0 * 1.959964))


def test_runs_of_a_campaign_do_not_average_the_scale_that_they_share() -> None:
    halves = []
    for scale in (0.0, 0.25):
        pairs = [(value, with_scale(estimate("Kc", value, 0.1), scale)) for value in (20.0, 20.1, 19.9)]
        values = [Value(value, one.ci95, "", scale, one.without_scale.ci95[1]) for value, one in pairs]
        kc = _line(("", "", ""), [Measured(cast(Any, None), {"Kc": one}) for one in values]).values["Kc"]
        halves.append(kc.ci95[1] - kc.value)
    assert halves[1] == pytest.approx(math.hypot(halves[0], 1.959964 * 0.25 * 20.0), rel=1e-3)
