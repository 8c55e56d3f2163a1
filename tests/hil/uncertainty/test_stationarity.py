"""Pooled recordings: the interval includes the variance between them, which is separate from that within."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse
from hil.errors import WrongUse
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.uncertainty.blocks import Blocks
from hil.uncertainty.confidence import confidence_intervals
from hil.uncertainty.stationarity import VarianceComponents, disagreement, pooled_intervals

from ..conftest import Maker

Array = NDArray[np.float64]

STIFFNESSES = (0.0196, 0.0204, 0.0199, 0.0203, 0.0198)


def identified(paths: list[Path]) -> Identification:
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    return identify(paths, parse("linear"), search)


def test_what_lies_between_recordings_is_told_and_is_in_the_interval(make_recording: Maker) -> None:
    paths = [
        make_recording(f"{seed}.h5", kc=stiffness, noise=1e-4, seed=seed) for seed, stiffness in enumerate(STIFFNESSES)
    ]
    apart = identified(paths)["Kc"]
    assert apart.components is not None
    assert apart.components.between == pytest.approx(np.std(STIFFNESSES, ddof=1), rel=0.1)
    assert apart.components.within < 0.1 * apart.components.between
    half = 0.5 * (apart.ci95[1] - apart.ci95[0])
    # Student's quantile for five recordings, times the standard error of their mean
    assert half == pytest.approx(2.776 * np.std(STIFFNESSES, ddof=1) / np.sqrt(5.0), rel=0.15)


def test_recordings_that_are_alike_have_nothing_between_them(make_recording: Maker) -> None:
    paths = [make_recording(f"{seed}.h5", noise=1e-4, seed=seed) for seed in range(4)]
    alike = identified(paths)["Kc"]
    assert alike.components is not None
    assert alike.components.between < 2.0 * alike.components.within
    assert alike.ci95[0] < 0.02 < alike.ci95[1]


def test_one_recording_has_no_variance_components(make_recording: Maker) -> None:
    assert identified([make_recording(noise=1e-4)])["Kc"].components is None


def test_the_same_run_is_not_pooled_with_itself(make_recording: Maker) -> None:
    path = make_recording(noise=1e-4)
    with pytest.raises(WrongUse, match="the same run"):
        identified([path, path])


def test_a_recording_that_differs_from_one_without_stiffness_is_named_by_its_value() -> None:
    components = VarianceComponents(within=1e-3, between=1.0, values=(2.0, 0.0), p_alike=0.0)
    (found,) = disagreement(["Kc"], [components], [Path("a.h5"), Path("loose.h5")])
    assert "Kc of a.h5 is 2 (SI), and that of the other one is zero" in found.message


@pytest.mark.parametrize("other", [0.002, 3.5e-5])
def test_a_recording_with_another_zero_of_the_torque_is_named(make_recording: Maker, other: float) -> None:
    """The misfit said that no known effect explains what one offset leaves; a third of the noise leaves nothing."""

    def taken(name: str, seed: int, zero: float) -> Path:
        def change(channels: dict[str, Array]) -> None:
            channels["torque"] += zero

        return make_recording(name, noise=1e-4, seed=seed, change=change)

    paths = [taken(f"{seed}.h5", seed, zero) for seed, zero in enumerate((1e-3, 1e-3, 1e-3 + other))]
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    found = [one for one in identify(paths, parse("linear+offset"), search).diagnostics if one.parameter == "tau0"]
    assert [one.code for one in found] == ["recordings-differ"] * (other > 1e-3)
    for one in found:
        assert f"the torque at rest of {paths[2]} differs by +0.002 N m from the others" in one.message
        assert not one.is_error


def test_a_recording_of_which_no_sample_is_fitted_has_no_share_in_the_pooled_interval() -> None:
    """Friction may hold the joint in all of it."""
    columns = np.random.default_rng(0).standard_normal((400, 2))
    blocks = Blocks.of(columns, columns @ [1.0, 2.0] + 0.1 * np.random.default_rng(1).standard_normal(400))
    alone = confidence_intervals(blocks, np.array([1.0, 2.0]))
    pooled, components = pooled_intervals(blocks, (0, 400), alone)
    np.testing.assert_array_equal(pooled.half_width, alone.half_width)
    assert components == (None, None)
