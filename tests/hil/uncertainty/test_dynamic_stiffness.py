from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.uncertainty.dynamic_stiffness import DynamicStiffness, dynamic_stiffness
from hil.uncertainty.effects import Recorded

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


def measured(torque: Array, deflection: Array, rate: Array, command: Array | None = None) -> DynamicStiffness:
    found = dynamic_stiffness(Recorded(TIME, torque, deflection, rate), BAND, command)
    assert found is not None
    return found


def spring_and_damper(seed: int) -> tuple[Array, Array, Array]:
    parts, speeds = waves(seed)
    deflection, rate = parts.real.sum(axis=1), -(parts.imag @ speeds)
    return KC * deflection + BC * rate + noise(seed, 1e-3), deflection, rate


def test_a_spring_and_damper_have_the_same_stiffness_in_every_band() -> None:
    torque, deflection, rate = spring_and_damper(0)

    bands = measured(torque - noise(0, 1e-3), deflection, rate).bands

    assert len(bands.frequency) >= 5
    np.testing.assert_allclose(bands.stiffness, KC, rtol=1e-9)
    np.testing.assert_allclose(bands.damping, BC, rtol=1e-7)
    assert (bands.coherence > 0.999999).all()


@pytest.mark.study
def test_the_intervals_hold_the_truth_as_often_as_they_say() -> None:
    inside = []
    for seed in range(12):
        bands = measured(*spring_and_damper(seed)).bands
        inside += (np.abs(bands.stiffness - KC) < bands.stiffness_half_width).tolist()
        inside += (np.abs(bands.damping - BC) < bands.damping_half_width).tolist()

    assert 0.9 < np.mean(inside) < 0.99


def test_a_standard_linear_solid_has_the_stiffness_of_its_closed_form() -> None:
    share, constant = 0.3, 0.02
    parts, speeds = waves()
    branch = share * KC * 1j * speeds * constant / (1.0 + 1j * speeds * constant)
    torque = (parts @ (KC + 1j * speeds * BC + branch)).real
    rate = -(parts.imag @ speeds)

    bands = measured(torque, parts.real.sum(axis=1), rate).bands

    turned = 2.0 * np.pi * bands.frequency * constant
    stiffness = KC * (1.0 + share * turned**2 / (1.0 + turned**2))
    damping = BC + share * KC * constant / (1.0 + turned**2)
    np.testing.assert_allclose(bands.stiffness, stiffness, rtol=0.02)
    np.testing.assert_allclose(bands.damping, damping, rtol=0.05)


def test_noise_in_the_deflection_does_not_lower_the_stiffness_where_the_command_is_known() -> None:
    torque, deflection, rate = spring_and_damper(0)
    noisy = deflection + noise(7, 0.3)

    alone = measured(torque, noisy, rate).bands
    commanded = measured(torque, noisy, rate, command=deflection)

    assert commanded.instrument == "command"
    assert np.mean(alone.stiffness) < 0.97 * KC
    error = np.abs(commanded.bands.stiffness - KC)
    assert (error < 1.5 * commanded.bands.stiffness_half_width).all()


@pytest.mark.parametrize("command", [np.zeros(len(TIME)), np.full(len(TIME), np.nan), noise(9, 1.0)])
def test_a_command_that_says_nothing_is_not_used(command: Array) -> None:
    assert measured(*spring_and_damper(0), command=command).instrument == "deflection"


def test_a_stiffness_that_rises_with_the_deflection_differs_between_amplitudes() -> None:
    _, deflection, rate = spring_and_damper(0)
    envelope = np.repeat([0.3, 1.0], len(TIME) // 2)
    deflection, rate = envelope * deflection, envelope * rate

    small, large = measured(KC * deflection + 5.0 * deflection**3 + BC * rate, deflection, rate).by_amplitude

    assert small.deflection < large.deflection
    assert np.mean(large.stiffness) > 1.05 * np.mean(small.stiffness)


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
    for _, bands in found.groups:
        assert bands.frequency.size
        np.testing.assert_allclose(bands.stiffness, KC, rtol=0.1)


def test_noise_of_the_deflection_is_no_motion_where_the_joint_rests() -> None:
    torque, deflection, rate = resting_first(0.6)

    found = measured(torque, deflection + noise(3, 1e-4), rate)

    for _, bands in found.groups:
        assert (bands.coherence > 0.9).all()
        np.testing.assert_allclose(bands.stiffness, KC, rtol=0.1)


def test_a_torque_that_is_zero_at_all_times_gives_no_dynamic_stiffness() -> None:
    _, deflection, rate = spring_and_damper(0)

    assert dynamic_stiffness(Recorded(TIME, np.zeros(len(TIME)), deflection, rate), BAND) is None


def test_a_rate_that_goes_with_the_deflection_gives_no_dynamic_stiffness() -> None:
    torque, deflection, _ = spring_and_damper(0)

    assert dynamic_stiffness(Recorded(TIME, torque, deflection, deflection), BAND) is None


def test_distortion_is_that_of_the_harmonics_of_a_cubic_spring() -> None:
    angle = 0.2 * np.sin(2.0 * np.pi * TIME)
    rate = 0.4 * np.pi * np.cos(2.0 * np.pi * TIME)
    torque = KC * angle + 2.0 * angle**3 + noise(0, 1e-5)

    found = dynamic_stiffness(Recorded(TIME, torque, angle, rate), (0.9, 1.1))

    assert found is not None
    assert found.distortion is not None
    assert found.distortion.period == pytest.approx(1.0, rel=1e-3)
    third = 2.0 * 0.2**3 / 4.0  # sin^3 = (3 sin - sin of three times the angle)/4
    assert found.distortion.level == pytest.approx(third / (KC * 0.2 + 3.0 * third), rel=0.02)
    assert found.distortion.noise < 1e-3


def test_a_spring_and_damper_do_not_distort() -> None:
    distortion = measured(*spring_and_damper(0)).distortion

    assert distortion is not None
    assert distortion.period == pytest.approx(5.0, rel=1e-3)
    assert distortion.level < distortion.noise


def cubic(envelope: Array) -> DynamicStiffness:
    """Of a cubic spring and a damper moved by a multisine with an envelope (n,)."""
    _, deflection, _ = spring_and_damper(0)
    deflection = envelope * deflection
    rate = np.gradient(deflection, TIME)
    return measured(KC * deflection + 5.0 * deflection**3 + BC * rate + noise(0, 1e-3), deflection, rate)


def test_a_motion_that_grows_from_period_to_period_has_no_distortion_to_measure() -> None:
    assert cubic(np.linspace(0.2, 1.0, len(TIME))).distortion is None


def test_distortion_is_none_where_each_frequency_up_to_the_third_harmonic_is_excited() -> None:
    speeds = 2.0 * np.pi * np.arange(1, 76)
    waves = 0.01 * np.exp(1j * (np.outer(TIME, speeds) + np.random.default_rng(0).uniform(0.0, 6.0, 75)))
    deflection, rate = waves.real.sum(axis=1), -(waves.imag @ speeds)

    found = dynamic_stiffness(Recorded(TIME, KC * deflection + BC * rate, deflection, rate), (1.0, 25.0))

    assert found is not None
    assert found.distortion is None


def test_periods_that_fade_in_and_out_have_no_part_in_the_distortion() -> None:
    fading = np.minimum(1.0, np.minimum(TIME, TIME[-1] - TIME) / 1.5)

    steady, faded = cubic(np.ones(len(TIME))).distortion, cubic(fading).distortion

    assert steady is not None
    assert faded is not None
    assert faded.level > 0.01
    assert faded.level == pytest.approx(steady.level, rel=0.05)


def test_a_motion_whose_amplitude_changes_slowly_has_the_period_in_which_that_repeats() -> None:
    angle = (0.2 + 0.05 * np.sin(0.2 * np.pi * TIME)) * np.sin(4.0 * np.pi * TIME)
    rate = np.gradient(angle, TIME)

    found = dynamic_stiffness(Recorded(TIME, KC * angle + BC * rate + noise(0, 1e-5), angle, rate), (1.5, 2.5))

    assert found is not None
    assert found.distortion is not None
    assert found.distortion.period == pytest.approx(10.0, rel=1e-3)


def test_a_recording_shorter_than_a_segment_has_no_dynamic_stiffness() -> None:
    few = slice(0, 100)
    torque, deflection, rate = (values[few] for values in spring_and_damper(0))

    assert dynamic_stiffness(Recorded(TIME[few], torque, deflection, rate), BAND) is None
