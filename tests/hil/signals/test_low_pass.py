"""The low-pass that deflection, rate and acceleration come from where the readings are noisy, against closed forms."""

from __future__ import annotations

import pickle
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from ga.model.trajectory import Motion
from hil.recording.reader import Array
from hil.signals import constants
from hil.signals.rate.low_pass import LowPass, is_sound, low_pass_for, passed, passing
from hil.signals.rate.savitzky_golay import kernel, local_polynomial
from hil.signals.rate.spectrum import Spectrum
from hil.signals.rate.windows import window_for, windows

TIME = np.arange(5000) / 500.0
SPEED = 2.0 * np.pi * 12.0


def low_pass(time: Array = TIME) -> LowPass:
    found = low_pass_for(time, 12.0, 6)
    assert found is not None
    return found


def of_sine(time: Array) -> tuple[Array, Array, Array]:
    wave = np.exp(1j * SPEED * time)
    return wave.imag, SPEED * wave.real, -(SPEED**2) * wave.imag


def test_a_sine_at_the_end_of_the_band_passes_with_its_slope_and_curvature() -> None:
    found, sound = passed(TIME, of_sine(TIME)[0], low_pass()), is_sound(TIME, low_pass())
    assert np.mean(sound) > 0.9
    for order, (one, true) in enumerate(zip(found, of_sine(TIME), strict=True)):
        np.testing.assert_allclose(one[sound], true[sound], atol=1e-3 * SPEED**order)


@pytest.mark.parametrize("highest", [12.0, 60.0, 120.0])
def test_slope_and_curvature_are_those_of_the_value_however_short_the_low_pass_is(highest: float) -> None:
    found = low_pass_for(TIME, highest, 6)
    assert found is not None
    for speed in 2.0 * np.pi * highest * np.array([0.02, 0.1, 0.5, 1.0]):
        wave = np.exp(1j * speed * found.step * np.arange(found.half, -found.half - 1, -1))
        value, slope, curvature = (found.kernels() @ wave).tolist()
        assert slope / (1j * speed * value) == pytest.approx(1.0, abs=2e-4)
        assert -curvature / (speed**2 * value) == pytest.approx(1.0, abs=2e-4)


def test_uneven_stamps_and_lost_samples_change_nothing_that_matters() -> None:
    rng = np.random.default_rng(0)
    time = (TIME + 2e-4 * rng.uniform(-1.0, 1.0, len(TIME)))[rng.random(len(TIME)) > 0.05]
    found, sound = passed(time, of_sine(time)[0], low_pass(time)), is_sound(time, low_pass(time))
    assert np.mean(sound) > 0.9
    for order, (one, true) in enumerate(zip(found, of_sine(time), strict=True)):
        np.testing.assert_allclose(one[sound], true[sound], atol=1e-2 * SPEED**order)


def test_samples_within_reach_of_a_gap_or_an_end_are_not_sound() -> None:
    time = np.concatenate([TIME[:2000], TIME[2000:] + 0.1])
    sound, half = is_sound(time, low_pass()), low_pass().half
    assert not sound[:half].any()
    assert not sound[2000 - half : 2000 + half].any()
    assert sound[half : 2000 - half].all()


def test_white_noise_is_amplified_as_predicted_and_less_than_by_a_local_polynomial() -> None:
    noise = np.random.default_rng(1).standard_normal(len(TIME))
    found = np.std(np.array(passed(TIME, noise, low_pass()))[:, 500:-500], axis=1)
    np.testing.assert_allclose(found, low_pass().amplification(), rtol=0.1)
    slope, _ = windows(TIME, 12.0)
    of_polynomial = float(np.linalg.norm(kernel(slope, 1))) * 500.0
    assert low_pass().amplification()[1] ** 2 < of_polynomial**2 / 10.0


def test_samples_that_are_too_far_apart_or_too_few_have_no_low_pass() -> None:
    assert low_pass_for(TIME[::16], 12.0, 6) is None
    assert low_pass_for(TIME[:600], 12.0, 6) is None


@pytest.mark.parametrize(("noise", "passes"), [(0.0, False), (2e-6, False), (2e-3, True)])
def test_only_noise_that_would_change_kc_or_bc_is_passed_through_it(noise: float, passes: bool) -> None:
    rng = np.random.default_rng(2)
    x = 0.1 * np.sin(8.0 * TIME) + 0.05 * np.sin(50.0 * TIME)
    v = 0.8 * np.cos(8.0 * TIME) + 2.5 * np.cos(50.0 * TIME)
    torque = 0.3 * x + 3e-3 * v + 1e-3 * rng.standard_normal(len(TIME))
    window = window_for(TIME, x + noise * rng.standard_normal(len(TIME)), torque)
    assert (window.low_pass is not None) is passes


def test_noise_of_the_rate_stays_below_that_of_the_torque() -> None:
    """18 bits a turn at 3 kHz: a rate with noise of 1 % of it would be 7 times the noise of the torque."""
    time, count = np.arange(9000) / 3000.0, 2.0 * np.pi / 2.0**18
    phase, rng = 2.0 * np.pi * (0.7 * time + 1.4 * time**2), np.random.default_rng(0)
    x, v = 0.035 * np.sin(phase), 0.035 * np.cos(phase) * 2.0 * np.pi * (0.7 + 2.8 * time)
    damping, noise = 0.035, 1e-3 * float(np.std(x + 0.035 * v))
    torque = x + damping * v + noise * rng.standard_normal(len(time))
    window = window_for(time, count * np.round(x / count), torque)
    _, rate, _ = window.moved(time, count * np.round(x / count))
    sound = window.sound(time)
    assert damping * float(np.std((rate - v)[sound])) < 0.5 * noise


def test_the_low_pass_leaves_the_motion_beyond_the_band_that_is_above_the_noise() -> None:
    """A random walk has 1 % of its rate beyond the excited band, which is far more than the noise of its angle."""
    rng, count = np.random.default_rng(1), 2e-4
    walk = sosfilt(
        butter(2, 4.0, fs=700.0, output="sos"),
        sosfilt(butter(1, 0.2, fs=700.0, output="sos"), rng.standard_normal(8000)),
    )
    time, x = np.arange(8000) / 700.0, walk / np.abs(walk).max()
    v = np.gradient(x, time)
    read = count * np.round(x / count)
    window = window_for(time, read, x + 0.01 * v + 1e-3 * rng.standard_normal(len(time)))
    assert window.low_pass is not None
    found, _, _ = window.moved(time, read)
    assert float(np.std((found - x)[window.sound(time)])) < count / np.sqrt(12.0)


def test_torque_and_deflection_have_the_same_band_where_the_joint_moves_faster_than_any_window_follows() -> None:
    """Noise behind three poles: its rate goes on beyond what 13 samples follow, and the torque shows it."""
    rng = np.random.default_rng(3)
    fine = sosfilt(butter(3, 6.0, fs=10000.0, output="sos"), rng.standard_normal(20 * len(TIME)))
    angle = 0.2 * fine / np.abs(fine).max()
    x, v = angle[::20], (np.gradient(angle) * 10000.0)[::20]
    torque = 0.3 * x + 6e-3 * v
    noise = 3e-3 * float(np.std(torque))
    window = window_for(TIME, x, torque := torque + noise * rng.standard_normal(len(x)))
    assert window.low_pass is not None
    assert not window.noisy

    def left(deflection: Array, rate: Array, torque: Array) -> float:
        columns = np.stack([deflection, rate], axis=1)[window.sound(TIME)]
        return float(
            np.std(torque[window.sound(TIME)] - columns @ np.linalg.lstsq(columns, torque[window.sound(TIME)])[0])
        )

    assert left(x, local_polynomial(TIME, x, 6, 1), torque) > 1.5 * noise
    value, rate, _ = window.moved(TIME, x)
    assert left(value, rate, window.alike(TIME, torque)) < noise


@pytest.mark.parametrize("kept", [constants.KEPT_WEIGHTS, 1000])
def test_readings_at_stamps_asked_for_again_pass_as_the_first_ones_do(
    monkeypatch: pytest.MonkeyPatch, kept: int
) -> None:
    """kept: the number of stamps from which the weights of one would take too much memory."""
    monkeypatch.setattr(constants, "KEPT_WEIGHTS", kept)
    rng = np.random.default_rng(0)
    time = (TIME + 2e-4 * rng.uniform(-1.0, 1.0, len(TIME)))[rng.random(len(TIME)) > 0.05]
    found = low_pass(time)
    again = passing(time, found)
    for values in (np.sin(40.0 * time) + 3.0, np.sign(np.sin(9.0 * time)), rng.standard_normal(len(time))):
        assert again(values) == pytest.approx(passed(time, values, found)[0], abs=1e-12)


def test_what_a_recording_with_many_losses_needs_again_is_computed_once() -> None:
    """Five stretches with uneven stamps, one with even ones, and one that is too short for a local polynomial."""
    rng = np.random.default_rng(0)
    stretches = [TIME[:300] + 2e-4 * rng.uniform(-1.0, 1.0, 300) for _ in range(5)] + [TIME[:300], TIME[:3] ** 1.01]
    time = np.concatenate([part + (TIME[300] + 0.1) * at for at, part in enumerate(stretches)])
    found, values = low_pass(TIME), np.sin(40.0 * time)
    behind = Mock(passing=Mock(side_effect=lambda stamps: passing(stamps, found)))
    motion = Motion(time, values, values, values, values, behind=behind)
    whole = passed(time, values, found)[0]
    for part in (motion, motion.of(slice(None, None, 9)), motion.of(time > 1.0), motion):
        assert part.whole[0].filtered(values) == pytest.approx(whole, abs=1e-12, nan_ok=True)
    assert behind.passing.call_count == 1


@pytest.mark.parametrize("left", [slice(0, 1), slice(0, 600, 2)])
def test_a_stretch_of_which_little_is_left_passes_the_same_filter_as_the_others(left: slice) -> None:
    readings = np.sin(40.0 * TIME) + 0.02 * np.random.default_rng(0).standard_normal(len(TIME))
    window = window_for(TIME, readings, np.sin(40.0 * TIME))
    assert window.low_pass is not None
    time, values = TIME[left], readings[left]
    expected = passed(time, values, window.low_pass)[0]
    assert window.passing(time)(values) == pytest.approx(np.where(np.isfinite(expected), expected, values), abs=1e-12)


def test_a_motion_whose_torque_was_filtered_goes_to_another_process() -> None:
    readings = np.sin(40.0 * TIME) + 0.02 * np.random.default_rng(0).standard_normal(len(TIME))
    window = window_for(TIME, readings, np.sin(40.0 * TIME))
    assert window.low_pass is not None
    motion = Motion(TIME, readings, readings, readings, readings, behind=window)
    here = motion.filtered(readings)
    there = pickle.loads(pickle.dumps(motion.of(slice(10, 90)))).whole[0]  # noqa: S301 - our own
    assert there.filtered(readings) == pytest.approx(here, abs=0.0)


def test_the_counts_of_a_steady_motion_are_no_motion() -> None:
    """A triangle runs over the counts at one speed, which makes lines of them, above the floor of white noise."""
    time, count = np.arange(5400) / 391.3, 2.0 * np.pi / 4096.0
    corners = 0.6 * (np.abs(2.0 * np.mod(2.4117 * time + 0.25, 1.0) - 1.0) - 0.5)
    x = sosfilt(butter(2, 24.6, fs=391.3, output="sos"), corners)
    found = Spectrum.of(time, count * np.round(x / count))
    assert found.above(count / np.sqrt(12.0)) < 0.6 * found.above(0.0)


def test_a_window_that_lies_across_a_long_gap_does_not_hide_the_noise_of_the_others() -> None:
    time = np.arange(4000) / 1000.0 + 0.3 * (np.arange(4000) >= 2000)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(4000)

    found = window_for(time, np.sin(2.0 * np.pi * 3.0 * time) + noise, np.sin(2.0 * np.pi * 3.0 * time))

    assert 5e-4 < found.of_deflection < 1.1e-3
