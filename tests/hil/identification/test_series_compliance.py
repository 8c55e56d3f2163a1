"""The fixture's compliance removed: against the closed forms of slow motion and a two-spring joint in time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from ga.lad.exact import least_absolute_deviations
from hil.errors import Untrustworthy
from hil.identification.series_compliance import Element, Excitation, corrected
from hil.recording.reader import Array

KC, BC = 17.75e-3, 0.19e-3  # the paper's joint
SLOW = Excitation.flat((0.001, 0.01))


def held_by(stiffness: float, damping: float, band: tuple[float, float], length: float = 20.3) -> tuple[Array, Array]:
    """Columns (n, 2) and torque (n,) of a chirp on the joint and a fixture in series, integrated in time."""
    low, high = band
    step = 2.5e-4
    time = np.arange(0.0, length, step)
    phase = 2.0 * math.pi * (low * time + (high - low) * time**2 / (2.0 * length))
    angle = 0.35 * np.sin(phase)
    rate = 0.35 * np.cos(phase) * 2.0 * math.pi * (low + (high - low) * time / length)
    # both carry KC*x + BC*x' = stiffness*(angle - x) + damping*(angle' - x'), whose drive is a line between two steps
    drive, pole = (stiffness * angle + damping * rate) / (BC + damping), (stiffness + KC) / (BC + damping)
    keep = math.exp(-pole * step)
    late = (1.0 - keep) / (pole * step)
    coupling = lfilter([(1.0 - late) / pole, (late - keep) / pole], [1.0, -keep], drive)
    torque = KC * coupling + BC * (drive - pole * coupling)
    return np.column_stack([angle, rate])[::16], torque[::16]


def test_slowly_the_compliances_add() -> None:
    fixture = Element(0.2, 1e-3)
    together = 1.0 / (1.0 / KC + 1.0 / 0.2)
    damping = together**2 * (BC / KC**2 + 1e-3 / 0.2**2)
    found = corrected(Element(together, damping), fixture, SLOW)
    assert found.stiffness == pytest.approx(KC, rel=1e-6)
    assert found.damping == pytest.approx(BC, rel=1e-6)


def test_a_rigid_fixture_changes_nothing() -> None:
    found = corrected(Element(KC, BC, 1e-5, 1e-6), Element(1e9, 0.0), Excitation.flat((0.1, 15.0)))
    assert (found.stiffness, found.damping) == pytest.approx((KC, BC), rel=1e-7)
    assert (found.stiffness_error, found.damping_error) == pytest.approx((1e-5, 1e-6), rel=1e-6)


@pytest.mark.parametrize(
    ("ratio", "lag", "band"), [(20.0, 1e-4, (0.1, 15.0)), (5.0, 2e-3, (0.1, 15.0)), (3.0, 5e-3, (0.1, 2.0))]
)
def test_the_joint_is_found_behind_a_fixture_that_gives(ratio: float, lag: float, band: tuple[float, float]) -> None:
    """The uncorrected fit is 3 to 25 % off in Kc and 9 to 35 % in Bc."""
    fixture = Element(ratio * KC, ratio * KC * lag)
    columns, torque = held_by(fixture.stiffness, fixture.damping, band)
    fit = np.linalg.lstsq(columns, torque, rcond=None)[0]
    assert fit[0] < 0.97 * KC
    assert fit[1] < 0.92 * BC
    time: Array = 0.004 * np.arange(len(torque), dtype=np.float64)
    for excitation in (Excitation.of(time, columns[:, 0]), Excitation.flat(band)):
        found = corrected(Element(*fit), fixture, excitation)
        assert found.stiffness == pytest.approx(KC, rel=2e-3)
        assert found.damping == pytest.approx(BC, rel=2e-3)


def test_it_holds_for_the_fit_that_hil_makes_where_noise_is_the_papers() -> None:
    """Least absolute deviations weigh a fit's own errors otherwise than least squares, except under noise."""
    fixture = Element(5.0 * KC, 5.0 * KC * 2e-3)
    columns, torque = held_by(fixture.stiffness, fixture.damping, (0.1, 15.0))
    noisy = torque + 2e-4 * np.random.default_rng(0).standard_normal(len(torque))
    found = corrected(Element(*least_absolute_deviations(columns, noisy).genes), fixture, Excitation.flat((0.1, 15.0)))
    assert found.stiffness == pytest.approx(KC, rel=5e-3)
    assert found.damping == pytest.approx(BC, rel=1e-2)


def test_the_errors_of_both_recordings_are_carried_in() -> None:
    """Against draws from both."""
    rng = np.random.default_rng(2)
    band = Excitation.flat((0.1, 15.0))
    measured = Element(16e-3, 0.16e-3, 5e-5, 1e-6)
    fixture = Element(0.15, 3e-4, 2e-3, 5e-5)
    found = corrected(measured, fixture, band)
    draws = np.array(
        [
            (one.stiffness, one.damping)
            for m, f in zip(rng.standard_normal((400, 2)), rng.standard_normal((400, 2)), strict=True)
            for one in [
                corrected(
                    Element(measured.stiffness + m[0] * 5e-5, measured.damping + m[1] * 1e-6),
                    Element(fixture.stiffness + f[0] * 2e-3, fixture.damping + f[1] * 5e-5),
                    band,
                )
            ]
        ]
    )
    np.testing.assert_allclose(draws.std(axis=0), [found.stiffness_error, found.damping_error], rtol=0.12)
    np.testing.assert_allclose(draws.mean(axis=0), [found.stiffness, found.damping], rtol=4e-3)


def test_slowly_the_errors_are_those_of_the_closed_form() -> None:
    """d(1/Kc) = -d(1/K_fixture): the derivatives are (Kc/K_measured)^2 and (Kc/K_fixture)^2."""
    found = corrected(Element(0.015, 1e-4, 1e-5), Element(0.1, 1e-4, 1e-3), SLOW)
    expected = math.hypot((found.stiffness / 0.015) ** 2 * 1e-5, (found.stiffness / 0.1) ** 2 * 1e-3)
    assert found.stiffness_error == pytest.approx(expected, rel=1e-6)


def test_a_damping_that_cannot_be_told_leaves_the_stiffness_told() -> None:
    found = corrected(Element(KC, BC, 1e-5, 1e-6), Element(0.2, 1e-3, 1e-3, math.inf), Excitation.flat((0.1, 15.0)))
    assert math.isfinite(found.stiffness_error)
    assert found.damping_error == math.inf


@pytest.mark.parametrize("stiffness", [0.001, 0.0177, 0.035, -0.1, 0.0])
def test_a_fixture_softer_than_the_joint_is_refused(stiffness: float) -> None:
    with pytest.raises(Untrustworthy, match=r"softer than the joint.*Stiffen the fixture and record both again"):
        corrected(Element(17.75e-3, BC), Element(stiffness, 1e-4), SLOW)


@pytest.mark.parametrize("stiffness", [0.0, -0.01])
def test_joint_and_fixture_without_stiffness_are_refused(stiffness: float) -> None:
    with pytest.raises(Untrustworthy, match=f"together is {stiffness:.4g} N m/rad"):
        corrected(Element(stiffness, BC), Element(0.1, 1e-4), SLOW)


def test_a_deflections_excitation_is_where_it_moved() -> None:
    time = np.sort(np.random.default_rng(1).uniform(0.0, 10.0, 5000))
    found = Excitation.of(time, 0.1 + 0.3 * np.sin(2.0 * math.pi * 4.0 * time))
    assert found.frequency[np.argmax(found.power)] == pytest.approx(4.0, abs=0.11)
    near = np.abs(found.frequency - 4.0) < 0.5
    assert found.power[near].sum() > 0.95 * found.power.sum()


def test_pauses_add_no_motion_to_the_excitation() -> None:
    time = np.linspace(0.0, 8.0, 4001)
    angle = 0.3 * np.sin(2.0 * math.pi * 4.0 * time)
    late = time + 3.0 * (time > 2.0) + 7.0 * (time > 5.0)
    found = Excitation.of(late, angle + 0.5 * (time > 5.0))
    near = np.abs(found.frequency - 4.0) < 1.0
    assert found.power[near].sum() > 0.95 * found.power.sum()
