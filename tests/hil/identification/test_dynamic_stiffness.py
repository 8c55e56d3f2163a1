from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.trajectory import Motion
from hil.identification.misfit.dynamic_stiffness import DynamicStiffness, dynamic_stiffness

Array = NDArray[np.float64]

KC, BC, RATE, BAND = 0.3, 3e-3, 500.0, (0.3, 12.0)
TIME = np.arange(10_000) / RATE
LINES = np.unique(np.round(np.geomspace(*BAND, 40) * 5.0)) / 5.0  # Hz, of a period of 5 s


def waves(seed: int = 0) -> tuple[Array, Array]:
    """Complex waves (n, l), rad, of a multisine whose real parts add up to the deflection, and their speeds (l,)."""
    speeds = 2.0 * np.pi * LINES
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(LINES))
    return np.asarray(0.03 * np.exp(1j * (np.outer(TIME, speeds) + phases))), speeds


def noise(seed: int, size: float) -> Array:
    return size * np.random.default_rng([seed, 1]).standard_normal(len(TIME))


def motion(deflection: Array, rate: Array) -> Motion:
    return Motion(TIME[: len(rate)], deflection, rate, np.zeros(len(rate)), np.zeros(len(rate)))


def measured(torque: Array, deflection: Array, rate: Array, command: Array | None = None) -> DynamicStiffness:
    found = dynamic_stiffness(motion(deflection, rate), torque, BAND, command)
    assert found is not None
    return found


def spring_and_damper(seed: int) -> tuple[Array, Array, Array]:
    parts, speeds = waves(seed)
    deflection, rate = parts.real.sum(axis=1), -(parts.imag @ speeds)
    return KC * deflection + BC * rate + noise(seed, 1e-3), deflection, rate


def test_a_spring_and_damper_have_the_same_stiffness_in_every_band() -> None:
    torque, deflection, rate = spring_and_damper(0)

    bands = measured(torque - noise(0, 1e-3), deflection, rate)

    assert len(bands.frequency) >= 5
    np.testing.assert_allclose(bands.stiffness, KC, rtol=1e-9)
    np.testing.assert_allclose(bands.damping, BC, rtol=1e-7)
    assert (bands.coherence > 0.999999).all()


@pytest.mark.study
def test_the_intervals_hold_the_truth_as_often_as_they_say() -> None:
    inside = []
    for seed in range(12):
        bands = measured(*spring_and_damper(seed))
        inside += (np.abs(bands.stiffness - KC) < bands.stiffness_half_width).tolist()
        inside += (np.abs(bands.damping - BC) < bands.damping_half_width).tolist()

    assert 0.9 < np.mean(inside) < 0.99


def test_a_standard_linear_solid_has_the_stiffness_of_its_closed_form() -> None:
    share, constant = 0.3, 0.02
    parts, speeds = waves()
    branch = share * KC * 1j * speeds * constant / (1.0 + 1j * speeds * constant)
    torque = (parts @ (KC + 1j * speeds * BC + branch)).real
    rate = -(parts.imag @ speeds)

    bands = measured(torque, parts.real.sum(axis=1), rate)

    turned = 2.0 * np.pi * bands.frequency * constant
    stiffness = KC * (1.0 + share * turned**2 / (1.0 + turned**2))
    damping = BC + share * KC * constant / (1.0 + turned**2)
    np.testing.assert_allclose(bands.stiffness, stiffness, rtol=0.02)
    np.testing.assert_allclose(bands.damping, damping, rtol=0.05)


def test_noise_in_the_deflection_does_not_lower_the_stiffness_where_the_command_is_known() -> None:
    torque, deflection, rate = spring_and_damper(0)
    noisy = deflection + noise(7, 0.3)

    alone = measured(torque, noisy, rate)
    commanded = measured(torque, noisy, rate, command=deflection)

    assert commanded.instrument == "command"
    assert np.mean(alone.stiffness) < 0.97 * KC
    error = np.abs(commanded.stiffness - KC)
    assert (error < 1.5 * commanded.stiffness_half_width).all()


@pytest.mark.parametrize("command", [np.zeros(len(TIME)), np.full(len(TIME), np.nan), noise(9, 1.0)])
def test_a_command_that_says_nothing_is_not_used(command: Array) -> None:
    assert measured(*spring_and_damper(0), command=command).instrument == "deflection"


def resting_first(share: float) -> tuple[Array, Array, Array]:
    """Torque without noise, deflection and rate of a joint that rests in the first part of the recording."""
    _, deflection, rate = spring_and_damper(0)
    moves = share * TIME[-1] <= TIME
    deflection, rate = moves * deflection, moves * rate
    return KC * deflection + BC * rate, deflection, rate


def test_a_command_that_rests_through_most_of_the_recording_is_an_instrument_where_it_moves() -> None:
    torque, deflection, rate = resting_first(0.6)

    found = measured(torque + noise(0, 1e-3), deflection + noise(3, 1e-4), rate, command=deflection)

    assert found.instrument == "command"
    np.testing.assert_allclose(found.stiffness, KC, rtol=0.1)


def test_noise_of_the_deflection_is_no_motion_where_the_joint_rests() -> None:
    torque, deflection, rate = resting_first(0.6)

    found = measured(torque, deflection + noise(3, 1e-4), rate)

    assert (found.coherence > 0.9).all()
    np.testing.assert_allclose(found.stiffness, KC, rtol=0.1)


def test_a_torque_that_is_zero_at_all_times_gives_no_dynamic_stiffness() -> None:
    _, deflection, rate = spring_and_damper(0)

    assert dynamic_stiffness(motion(deflection, rate), np.zeros(len(TIME)), BAND) is None


def test_a_rate_that_goes_with_the_deflection_gives_no_dynamic_stiffness() -> None:
    torque, deflection, _ = spring_and_damper(0)

    assert dynamic_stiffness(motion(deflection, deflection), torque, BAND) is None


def test_a_recording_shorter_than_a_segment_has_no_dynamic_stiffness() -> None:
    few = slice(0, 100)
    torque, deflection, rate = (values[few] for values in spring_and_damper(0))

    assert dynamic_stiffness(motion(deflection, rate), torque, BAND) is None
