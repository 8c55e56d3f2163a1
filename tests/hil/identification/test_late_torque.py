"""What is said of Bc where a filter stands before the torque: its shape and a viscoelastic coupling look alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import parse
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.reader import Array

from ..conftest import Maker
from .conftest import SEARCH

Response = NDArray[np.complexfloating[Any, Any]]
KC, BC = 0.3, 3e-3
OMEGA = 2.0 * np.pi * np.arange(1.0, 13.0)


def identified(
    make_recording: Maker,
    response: Response,
    model: str | None = None,
    damping: float = BC,
    omega: Array = OMEGA,
    *,
    wrong: float = -1.0,
    samples: int = 2000,
) -> Identification:
    """The result of a sum of sines, of 1 to 12 Hz unless said, with the torque behind a filter of that response.

    wrong: s, when one reading of the torque is 0.1 N m off.
    """

    def change(channels: dict[str, Array]) -> None:
        rng = np.random.default_rng(4)
        waves = 0.05 * np.exp(1j * (np.outer(channels["time"], omega) + rng.uniform(0.0, 2.0 * np.pi, len(omega))))
        channels["dtheta"] = waves.sum(axis=1).imag
        torque = (waves * (KC + 1j * omega * damping) * response).sum(axis=1).imag
        channels["torque"] = (
            torque + 5e-4 * rng.standard_normal(len(torque)) + 0.1 * np.isclose(channels["time"], wrong)
        )

    path = make_recording(change=change, samples=samples)
    return identify([path], None if model is None else parse(model), SEARCH)


@pytest.mark.study
def test_no_damping_is_trusted_behind_a_filter_whose_shape_nobody_named(make_recording: Maker) -> None:
    """A second order of 30 Hz in closed form, which is no mean and no single pole."""
    s = 1j * OMEGA / (2.0 * np.pi * 30.0)
    found = identified(make_recording, 1.0 / (1.0 + np.sqrt(2.0) * s + s * s))
    assert (found.trusted("Kc"), found.trusted("Bc")) == (True, False)
    assert found["Kc"].value == pytest.approx(KC, rel=5e-3)


@pytest.mark.study
def test_a_mean_that_is_named_is_a_warning(make_recording: Maker) -> None:
    mean = np.exp(-1j * np.outer(OMEGA, 2e-3 * np.arange(10))).mean(axis=1)
    found = identified(make_recording, mean, "linear+skew+mean")
    assert found["Bc"].value == pytest.approx(BC, rel=0.03)
    (said,) = [one for one in found.diagnostics if one.code == "torque-reading"]
    assert not said.is_error
    assert found["window"].value == pytest.approx(20e-3, rel=0.03)
    assert f"it is {1e3 * found['skew'].value:.3g} ms late and looks like a mean over" in said.message
    assert "--model" not in said.message


@pytest.mark.study
def test_a_damping_that_another_model_doubts_is_said_with_the_model_that_would_decide(make_recording: Maker) -> None:
    found = identified(make_recording, 1.0 / (1.0 + 12e-3j * OMEGA), damping=1e-3)
    assert found.model.name == "linear+lag"
    said = [one.message for one in found.diagnostics if one.code == "not-identifiable" and one.parameter == "Bc"]
    assert said
    assert "name --model linear+lag" in said[0]
    assert "looks like a viscoelastic coupling that relaxes fast" in said[0]


@pytest.mark.study
def test_a_lag_in_slow_motion_takes_the_trust_from_bc_and_not_from_kc(make_recording: Maker) -> None:
    """It lowers Bc by Kc times the lag, and shows in nothing else."""
    omega = 2.0 * np.pi * np.arange(0.25, 1.3, 0.25)
    found = identified(make_recording, 1.0 / (1.0 + 4e-3j * omega), omega=omega)
    assert found["Kc"].ci95[0] < KC < found["Kc"].ci95[1]
    assert found.trusted("Kc")
    assert not found.trusted("Bc")
    assert found["Bc"].ci95[0] < BC < found["Bc"].ci95[1]


@pytest.mark.study
@pytest.mark.parametrize("late", ["lag", "delay"])
def test_a_late_reading_that_does_not_show_is_in_the_interval_of_bc(make_recording: Maker, late: str) -> None:
    """A lag of 2 ms leaves a fifth of Bc out, a delay of 0.8 ticks a sixth."""
    omega = 2.0 * np.pi * np.arange(0.25, 1.6, 0.25)
    response = 1.0 / (1.0 + 2e-3j * omega) if late == "lag" else np.exp(-1.6e-3j * omega)
    found = identified(make_recording, response, omega=omega)
    bc = found["Bc"]
    assert found.model.name == "linear"
    assert bc.conditional is not None
    assert bc.conditional.ci95[1] < BC
    assert bc.ci95[0] < BC < bc.ci95[1]
    assert found["Kc"].ci95[0] < KC < found["Kc"].ci95[1]


@pytest.mark.study
def test_a_fast_motion_decides_on_a_late_reading_and_its_chance_costs_nothing(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.identification.mixture.average.hidden", lambda *_: [])  # their chance costs something
    found = identified(make_recording, np.ones(len(OMEGA), dtype=complex), damping=8e-3)
    assert found.model.name == "linear"
    named = identified(make_recording, np.ones(len(OMEGA), dtype=complex), "linear", damping=8e-3)["Bc"]
    assert np.diff(found["Bc"].ci95) < 2.0 * np.diff(named.ci95)


@pytest.mark.study
def test_a_branch_that_relaxes_more_slowly_than_the_joint_moved_leaves_bc_and_asks_for_a_load(
    make_recording: Maker,
) -> None:
    omega = 2.0 * np.pi * np.arange(3.0, 12.5, 1.0)
    relaxing = 0.35 * KC * 2.0j * omega / (1.0 + 2.0j * omega)
    found = identified(make_recording, 1.0 + relaxing / (KC + 1j * omega * BC), omega=omega)
    assert found.model.name == "linear+maxwell"
    assert (found.trusted("Kc"), found.trusted("Bc")) == (False, True)
    assert found["Bc"].ci95[0] < BC < found["Bc"].ci95[1]
    (said,) = [one.message for one in found.diagnostics if one.is_error and one.parameter == "Kc"]
    assert "Hold a load for at least" in said


@pytest.mark.study
def test_a_wrong_first_reading_is_no_sign_of_a_late_one(make_recording: Maker) -> None:
    """The state in which a lag began is not known, and takes all of one residual."""
    omega = 0.2 * OMEGA
    unfiltered = np.ones(len(omega), dtype=np.complex128)
    right = identified(make_recording, unfiltered, omega=omega)
    first = float(right.signals.motion.time[0])
    wrong = identified(make_recording, unfiltered, omega=omega, wrong=first)
    assert float(wrong.signals.motion.time[0]) == pytest.approx(first, abs=3e-3)  # or the row after the wrong one
    for name in ("Kc", "Bc"):
        assert wrong[name].value == pytest.approx(right[name].value, abs=0.2 * right[name].half_width)
        assert wrong[name].half_width == pytest.approx(right[name].half_width, rel=0.2)


def branches(omega: Array, *parts: tuple[float, float]) -> Response:
    """What Maxwell branches add to spring and damper, as a response: parts of Kc, and the times, s, they relax in."""
    added = sum(KC * part * 1j * omega * time / (1.0 + 1j * omega * time) for part, time in parts)
    return np.asarray(1.0 + added / (KC + 1j * omega * BC))


@pytest.mark.study
def test_a_tendon_that_relaxes_at_two_speeds_has_two_branches(make_recording: Maker) -> None:
    """K'(w) and B'(w) in closed form. One branch leaves Kc and Bc to a friction, a delay or a filter."""
    omega = 2.0 * np.pi * np.geomspace(0.25, 10.0, 14)
    found = identified(make_recording, branches(omega, (0.4, 0.02), (0.3, 0.25)), omega=omega, samples=6000)
    assert found.model.name == "linear+maxwell+maxwell2"
    for name, truth in (("Kc", KC), ("Bc", BC)):
        assert found.trusted(name)
        assert found[name].ci95[0] < truth < found[name].ci95[1]
    (said,) = [one for one in found.diagnostics if one.code == "two-stiffnesses"]
    assert "it is 0.3 N m/rad in slow motion, and 0.5" in said.message
    faster = min(("tau1", "tau2"), key=lambda name: found[name].value)
    assert found[faster].value == pytest.approx(0.02, rel=0.1)
    assert f"({faster})" in said.message


@pytest.mark.study
def test_a_branch_is_not_given_another_one_that_is_not_there(make_recording: Maker) -> None:
    omega = 2.0 * np.pi * np.geomspace(0.25, 10.0, 14)
    found = identified(make_recording, branches(omega, (0.4, 0.03)), omega=omega, samples=4000)
    assert found.model.name == "linear+maxwell"
