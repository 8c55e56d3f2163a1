"""Pooled recordings: the interval includes the variance between them, which is separate from that within."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.evolution.evolution import PRESETS
from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import parse
from hil.errors import WrongUse
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import ConfidenceIntervals, confidence_intervals
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import VarianceComponents
from hil.identification.verdict.stationarity import (
    disagreement,
    other_zeros,
    pooled_intervals,
)

from ..conftest import Maker

Array = NDArray[np.float64]

STIFFNESSES = (0.0196, 0.0204, 0.0199, 0.0203, 0.0198)
SEARCH = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
PATHS = [Path(f"{name}.h5") for name in "abcd"]


def problem(*stiffnesses: float, noise: float = 1e-3) -> tuple[Array, Array]:
    """Columns (400 k, 2) and torque (400 k,) of k joints that differ in the first parameter; the other is 0.5."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((400 * len(stiffnesses), 2))
    torque = np.repeat(stiffnesses, 400) * columns[:, 0] + 0.5 * columns[:, 1]
    return columns, torque + noise * rng.standard_normal(len(torque))


def pooled(*stiffnesses: float) -> tuple[ConfidenceIntervals, ConfidenceIntervals, VarianceComponents | None]:
    """The intervals without and with what lies between the joints, and the components of the first parameter."""
    columns, torque = problem(*stiffnesses)
    blocks, edges = Blocks.of(columns, torque), tuple(400 * (k + 1) for k in range(len(stiffnesses)))
    alone = confidence_intervals(blocks, least_absolute_deviations(columns, torque).genes)
    widened, components = pooled_intervals(blocks, edges, alone)
    return alone, widened, components[0]


def test_what_lies_between_recordings_is_told_and_is_in_the_interval() -> None:
    _, widened, components = pooled(*STIFFNESSES)
    spread = float(np.std(STIFFNESSES, ddof=1))
    assert components is not None
    assert components.between == pytest.approx(spread, rel=0.1)
    assert components.within < 0.3 * components.between
    assert components.values == pytest.approx(STIFFNESSES, rel=0.01)
    # Student's quantile for five recordings, times the standard error of their mean
    assert widened.half_width[0] == pytest.approx(2.776 * spread / np.sqrt(5.0), rel=0.15)


def test_recordings_that_are_alike_have_nothing_between_them() -> None:
    alone, widened, components = pooled(0.02, 0.02, 0.02, 0.02)
    assert components is not None
    assert components.between < 2.0 * components.within
    assert np.all(widened.half_width >= alone.half_width)
    assert components.p_alike > 0.01


def test_one_recording_has_no_variance_components() -> None:
    alone, widened, components = pooled(0.02)
    assert components is None
    assert widened is alone


def test_the_same_run_is_not_pooled_with_itself(make_recording: Maker) -> None:
    path = make_recording(noise=1e-4)
    with pytest.raises(WrongUse, match="the same run"):
        identify([path, path], parse("linear"), SEARCH)


@pytest.mark.parametrize(
    ("values", "within", "p", "said", "is_error"),
    [
        ((1.0, 1.0, 1.3), 1e-3, 0.0, "differs by +30.0% from the others", True),
        ((1.0, 1.3), 1e-3, 0.0, "differs by -23.1% from the other one", False),
        ((1.0, 1.3, 1.6, 1.9), 1e-3, 0.0, "from the others", False),
        ((2.0, 0.0), 1e-3, 0.0, "Kc of a.h5 is 2 (SI), and that of the other one is zero", False),
        ((1.0, 1.0, 1.3), 1e-3, 0.01, None, False),  # as chance would have it
        ((1.0, 1.0, 1.004), 1e-5, 0.0, None, False),  # too little to matter
        ((1.0, 1.0, 1.3), 1.0, 0.0, None, False),  # no more than the values are uncertain by
    ],
)
def test_a_recording_that_differs_is_named_with_its_difference(
    values: tuple[float, ...], within: float, p: float, said: str | None, *, is_error: bool
) -> None:
    components = VarianceComponents(within, float(np.std(values, ddof=1)), values, p)
    found = disagreement(["J", "Kc"], [components, components], PATHS)
    assert [(said or "") in one.message for one in found] == [True] * (said is not None)
    assert [(one.code, one.parameter, one.is_error) for one in found] == [("recordings-differ", "Kc", is_error)] * len(
        found
    )


@pytest.mark.parametrize(("error", "named"), [(1e-3, True), (5e-3, False)])
def test_another_zero_of_the_torque_matters_beside_the_error_of_the_fit(error: float, *, named: bool) -> None:
    components = VarianceComponents(1e-5, 1e-3, (1e-3, 1e-3, 3e-3), 0.0)
    found = other_zeros(["Kc", "tau0"], [None, components], PATHS, error)
    assert [one.parameter for one in found] == ["tau0"] * named
    assert other_zeros(["Kc"], [components], PATHS, error) == []


@pytest.mark.study
def test_a_recording_with_another_zero_of_the_torque_is_named(make_recording: Maker) -> None:
    """The misfit said that no known effect explains what one offset leaves."""

    def taken(name: str, seed: int, zero: float) -> Path:
        def change(channels: dict[str, Array]) -> None:
            channels["torque"] += zero

        return make_recording(name, samples=1000, noise=1e-4, seed=seed, change=change)

    paths = [taken(f"{seed}.h5", seed, zero) for seed, zero in enumerate((1e-3, 1e-3, 3e-3))]
    result = identify(paths, parse("linear+offset"), SEARCH)
    (one,) = [one for one in result.diagnostics if one.parameter == "tau0"]
    assert f"the torque at rest of {paths[2]} differs by +0.00201 N m from the others" in one.message
    assert not one.is_error
    assert result["Kc"].components is not None


def test_a_recording_of_which_no_sample_is_fitted_has_no_share_in_the_pooled_interval() -> None:
    """Friction may hold the joint in all of it."""
    columns = np.random.default_rng(0).standard_normal((400, 2))
    blocks = Blocks.of(columns, columns @ [1.0, 2.0] + 0.1 * np.random.default_rng(1).standard_normal(400))
    alone = confidence_intervals(blocks, np.array([1.0, 2.0]))
    pooled, components = pooled_intervals(blocks, (0, 400), alone)
    np.testing.assert_array_equal(pooled.half_width, alone.half_width)
    assert components == (None, None)
