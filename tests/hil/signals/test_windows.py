"""The windows of the rate: where the rate that they give is sure."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from ga.model.trajectory import Motion
from hil.recording.reader import Array, Recording
from hil.signals.prepare import prepare
from hil.signals.rate.savitzky_golay import local_polynomial
from hil.signals.rate.spectrum import Spectrum
from hil.signals.rate.windows import Window, is_smooth, window_for
from hil.signals.slow_channel import Readings

from ..conftest import Maker


def _moving(time: Array, angle: Array, rate: Array) -> Motion:
    return Motion(time, angle, rate, np.zeros_like(rate), np.zeros_like(rate))


def _window(half: int, unseen: float = 0.0) -> Window:
    return Window(half, half, 2e-3, (0.0, 10.0), 0.0, 0.0, 0.0, unseen)


@pytest.mark.parametrize("half", [6, 9, 12])
def test_the_rate_is_sure_but_for_the_samples_beside_a_jerk_whatever_the_noise(half: int) -> None:
    """An acceleration that changes sign every 0.1 s; the noise is that of which the window was made for."""
    time = np.arange(2000) / 500.0
    phase = np.mod(time, 0.2)
    rate = np.where(phase < 0.1, phase - 0.05, 0.15 - phase) * 10.0
    angle = np.cumsum(rate) / 500.0
    seen = local_polynomial(time, angle, half, 1)
    beside = np.abs(np.mod(time + 0.05, 0.1) - 0.05)  # s from the nearest change
    sure = is_smooth(_moving(time, angle, seen), _window(half))
    assert np.mean(sure[30:-30][beside[30:-30] < 0.005]) < 0.6
    assert sure[30:-30][beside[30:-30] > 0.03].all()
    smooth = np.sin(8.0 * time) + 1e-3 * np.random.default_rng(0).standard_normal(2000)
    assert np.mean(is_smooth(_moving(time, smooth, local_polynomial(time, smooth, half, 1)), _window(half))) > 0.999


def test_a_narrow_window_leaves_out_no_more_samples_beside_a_jerk_than_it_reaches_over() -> None:
    """A wide one differs from it where it is right, too: of steps at 250 Hz all but the rests would be left out."""
    time = np.arange(2000) / 250.0
    phase = np.mod(time, 0.2)
    rate = np.where(phase < 0.1, phase - 0.05, 0.15 - phase) * 10.0
    angle = np.cumsum(rate) / 250.0
    beside = np.abs(np.mod(time + 0.05, 0.1) - 0.05)
    sure = is_smooth(_moving(time, angle, local_polynomial(time, angle, 4, 1)), _window(4))
    assert sure[30:-30][beside[30:-30] > 0.03].all()
    assert np.mean(sure[30:-30][beside[30:-30] < 0.01]) < 0.5


def test_errors_of_the_rate_that_the_torques_noise_hides_leave_no_sample_out() -> None:
    time = np.arange(2000) / 500.0
    phase = np.mod(time, 0.2)
    angle = np.cumsum(np.where(phase < 0.1, phase - 0.05, 0.15 - phase) * 10.0) / 500.0
    motion = _moving(time, angle, local_polynomial(time, angle, 6, 1))
    assert not is_smooth(motion, _window(6, 1e-4)).all()
    assert is_smooth(motion, _window(6, 0.1))[30:-30].all()


def test_the_rate_has_as_little_error_as_any_window_gives_where_motion_goes_on_beyond_the_band() -> None:
    """The last hundredth of its power is spread over a decade above the rest, and noise hides the end of it."""
    time, rng = np.arange(6000) / 1000.0, np.random.default_rng(0)
    speeds = 2.0 * np.pi * np.geomspace(0.5, 80.0, 60)
    waves = np.exp(1j * (np.outer(time, speeds) + rng.uniform(0.0, 6.3, 60))) / (1.0 + (speeds / 30.0) ** 3)
    angle, rate = 0.05 * waves.real.sum(axis=1), -0.05 * waves.imag @ speeds
    read = angle + 1e-5 * rng.standard_normal(len(time))
    window = window_for(time, read, angle + 0.1 * rate)
    own, *others = (
        float(np.std((local_polynomial(time, read, half, 1) - rate)[300:-300]))
        for half in (window.slope, 6, 9, 13, 20, 30, 45)
    )
    assert window.low_pass is None
    assert own < 1.5 * min(others) < 0.1 * max(others)


def test_the_counts_of_a_motion_that_is_sampled_often_are_no_motion_beyond_its_band() -> None:
    time = np.arange(12_000) / 1000.0
    frequency = np.arange(4, 181) / 12.0  # up to 15 Hz
    motion = np.sin(
        np.outer(time, 2.0 * np.pi * frequency) + np.random.default_rng(1).uniform(0.0, 6.28, len(frequency))
    ) @ (1.0 / frequency)
    motion *= 0.05 / np.abs(motion).max()
    count = 2.0 * np.pi / 4096
    found = window_for(time, count * np.round(motion / count), 0.3 * motion)
    assert found.band[1] < 17.0
    assert found.low_pass is not None
    assert found.low_pass.cut < 30.0


def test_the_lines_that_counts_make_of_a_steady_motion_are_no_motion_beyond_its_band() -> None:
    """A triangle of half a period a second, its corners rounded over 40 ms."""
    time = np.arange(12_000) / 1000.0
    wave = np.exp(-((2.0 * np.pi * 0.02 * 0.5 * np.arange(1, 80, 2)) ** 2)) / np.arange(1, 80, 2) ** 2
    motion = np.sin(np.pi * np.outer(time, np.arange(1, 80, 2))) @ (wave * (-1.0) ** np.arange(40))
    motion *= 0.05 / np.abs(motion).max()
    highest = window_for(time, motion, 0.3 * motion).band[1]
    for count in 0.1 / np.array([150, 700]):
        found = window_for(time, count * np.round(motion / count), 0.3 * motion)
        assert found.band[1] < 20.0
        assert found.band[1] == pytest.approx(highest, rel=0.2)


@pytest.mark.study
def test_fast_motion_that_the_torque_shows_too_is_no_noise_of_the_deflection() -> None:
    """Its spectrum falls as that of noise behind a low-pass of second order at 30 Hz, nearly to half the rate."""
    time, rng = np.arange(6000) / 500.0, np.random.default_rng(2)
    speeds = 2.0 * np.pi * np.arange(1.0, 240.0, 0.5)
    waves = np.exp(1j * (np.outer(time, speeds) + rng.uniform(0.0, 6.3, len(speeds)))) / (1.0 + (speeds / 190.0) ** 2)
    angle, rate = waves.real.sum(axis=1), -waves.imag @ speeds
    torque = angle + 0.005 * rate
    torque += 0.002 * np.std(torque) * rng.standard_normal(len(time))
    noise = 0.03 * np.std(angle)
    found = window_for(time, angle, torque)
    assert found.of_deflection < 0.1 * noise
    assert found.low_pass is not None
    noisy = window_for(time, angle + noise * rng.standard_normal(len(time)), torque)
    assert noisy.of_deflection == pytest.approx(noise, rel=0.1)


def stepping(every: int) -> tuple[Array, Array, Readings]:
    """Stamps, s, and angles, rad, at 500 Hz behind steps, and readings of a slow cell of a joint with play, N m."""
    fine, omega = np.arange(99_000) / 10_000.0, 2.0 * np.pi * 12.0
    command = np.where(np.arange(len(fine)) // every * 7 % 5 < 2, 0.2, -0.2)
    (ahead,), back, _ = cont2discrete(([omega**2], [1.0, 1.6 * omega, omega**2]), 1e-4)
    angle = lfilter(ahead, back, command)
    at = np.arange(0.05, 9.8, 1.0 / 95.8)
    x, v = np.interp(at, fine, angle), np.interp(at, fine, np.gradient(angle, fine))
    noise = 3e-4 * np.random.default_rng(8).standard_normal(len(at))
    values = 0.3 * (x - np.clip(x, -0.02, 0.02)) + 3e-3 * v + noise
    return fine[::20], angle[::20], Readings(np.arange(len(at)), at, values)


def test_steps_between_the_readings_of_a_slow_cell_are_no_noise_that_would_hide_jumps() -> None:
    """Rates beside a jump are wrong by up to 1 rad/s. Before they were left out, Kc was 1.6 % too high."""
    time, angle, cell = stepping(1000)
    torque = np.interp(time, cell.time, cell.value)
    found = window_for(time, angle, torque, cell)
    assert np.isfinite(found.jerk)
    jerked = found.jerked(time, *found.moved(time, angle))
    assert 0.02 < np.mean(jerked) < 0.3


@pytest.mark.study
def test_jumps_are_seen_in_a_recording_whose_torque_is_that_of_a_slow_cell(make_recording: Maker) -> None:
    time, angle, cell = stepping(1000)

    def change(channels: dict[str, Array]) -> None:
        channels["dtheta"] = angle
        channels["torque"] = cell.value[np.maximum(np.searchsorted(cell.time, time, side="right") - 1, 0)]

    with Recording(make_recording(samples=len(time), change=change)) as recording:
        signals = prepare(recording, None)
    assert [one.channel for one in signals.slower] == ["torque"]
    assert 0.02 < signals.defects.jerked / len(signals) < 0.3
    exact = window_for(time, angle, np.interp(time, cell.time, cell.value), cell)
    assert signals.window is not None
    assert signals.window.unseen == pytest.approx(exact.unseen, rel=0.2)


def test_before_a_slow_cell_a_motion_that_jumps_all_the_time_passes_no_low_pass() -> None:
    """Torque readings so far apart cannot pass the low-pass that the deflection would."""
    time, angle, cell = stepping(200)
    torque = np.interp(time, cell.time, cell.value)
    assert window_for(time, angle, torque).low_pass is not None
    assert window_for(time, angle, torque, cell).low_pass is None


def _behind_drive(command: Array, hertz: float) -> tuple[Array, Array]:
    """Times and angles at 1000 Hz of a command at 10 kHz behind a drive of second order that hardly overshoots."""
    pole = 1.0 - 2.0 * np.pi * hertz / 1e4
    angle = lfilter([(1.0 - pole) ** 2], np.poly([pole, pole]), command)
    return np.arange(len(command))[::10] / 1e4, angle[::10]


def _chirp() -> Array:
    """Up to 8 Hz, at 10 kHz for 10 s."""
    time, growth = np.arange(100_000) / 1e4, np.log(8.0 / 0.3) / 10.0
    return np.asarray(0.2 * np.sin(2.0 * np.pi * 0.3 * np.expm1(growth * time) / growth))


@pytest.mark.parametrize("ticks", [4, 16])
def test_the_ripple_of_set_points_that_are_held_is_no_part_of_the_excited_band(ticks: int) -> None:
    """At 16 ticks it has 3 % of the rate's power, and the band reached to 72 Hz."""
    held = np.repeat(_chirp()[:: 10 * ticks], 10 * ticks)[:100_000]
    time, angle = _behind_drive(held, 30.0)
    spectrum = Spectrum.of(time, angle)
    assert 20.0 < spectrum.ripple_begins < 1000.0 / ticks - 4.0
    assert 6.0 < spectrum.band[1] < 12.0
    window = window_for(time, angle, 0.3 * angle + 3e-3 * np.gradient(angle, time))
    assert window.low_pass is not None
    assert 10.0 < window.low_pass.cut < spectrum.ripple_begins


def test_readings_of_a_slow_cell_pass_no_low_pass_for_their_steps_or_a_ripple() -> None:
    held = np.repeat(_chirp()[::80], 80)
    time, angle = _behind_drive(held, 30.0)
    torque = (0.3 * angle + 3e-3 * np.gradient(angle, time))[::12]
    cell = Readings(12 * np.arange(len(torque)), time[::12], torque)
    assert window_for(time, angle, np.repeat(torque, 12)[: len(time)], cell).low_pass is None


def _sequence(hold: int, levels: tuple[float, ...]) -> Array:
    return np.repeat(np.random.default_rng(3).choice(levels, 100_000 // hold + 1), hold)[:100_000]


NO_RIPPLE = {
    "chirp": (_chirp(), 30.0),
    "binary sequence of 40 ms": (_sequence(400, (-0.2, 0.2)), 20.0),
    "binary sequence of 150 ms": (_sequence(1500, (-0.2, 0.2)), 10.0),
    "steps": (_sequence(3000, (-0.2, -0.1, 0.0, 0.1, 0.2)), 15.0),
    "triangles": (0.2 * np.abs(np.mod(np.arange(100_000) / 1e4, 1.0) - 0.5), 20.0),
    "two sines": (0.2 * np.sin(np.arange(100_000) / 3e3) + 0.05 * np.sin(np.arange(100_000) / 2e2), 30.0),
}


@pytest.mark.parametrize("noise", [0.0, 1e-4, 2e-3])
@pytest.mark.parametrize("name", NO_RIPPLE)
def test_motion_that_fades_beyond_its_band_has_no_ripple(name: str, noise: float) -> None:
    time, angle = _behind_drive(*NO_RIPPLE[name])
    read = angle + noise * np.random.default_rng(4).standard_normal(len(angle))
    assert np.isinf(Spectrum.of(time, read).ripple_begins)
