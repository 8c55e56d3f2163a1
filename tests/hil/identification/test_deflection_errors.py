"""Kc and Bc from a noisy deflection: by instruments and by a simulation, against a closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import parse
from ga.model.trajectory import Motion
from hil.identification.deflection import correction
from hil.identification.deflection import fitted as fitted_module
from hil.identification.deflection.correction import deflection_errors
from hil.identification.deflection.fitted import Change, Fitted
from hil.identification.deflection.simulation import noisier
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import confidence_intervals
from hil.recording.reader import Array
from hil.signals.rate.windows import window_for

TRUE = np.array([0.3, 3e-3])
RATE = 60.0  # Hz: so near the band that a low-pass cannot take the noise away
TIME = np.arange(6000) / RATE


def multisine(time: Array, order: int = 0) -> Array:
    rng = np.random.default_rng(7)
    speeds = 2.0 * np.pi * np.geomspace(0.3, 12.0, 30)
    waves = np.exp(1j * (np.outer(time, speeds) + rng.uniform(0.0, 2.0 * np.pi, 30)))
    return np.asarray(0.02 * (waves * (1j * speeds) ** order).real.sum(axis=1))


def fitted(noise: float, *, command: Array | None = None, seed: int = 0, zero: float = 0.0, name: str = "") -> Fitted:
    """The least absolute deviations of a recording with noise, rad, in its deflection."""
    rng = np.random.default_rng(seed)
    torque = np.stack([multisine(TIME), multisine(TIME, 1)], axis=1) @ TRUE + 1e-4 * rng.standard_normal(len(TIME))
    read = multisine(TIME) + noise * rng.standard_normal(len(TIME)) + zero
    window = window_for(TIME, read, torque)
    sound = window.sound(TIME)
    motion = Motion(TIME, *window.moved(TIME, read), np.zeros(len(TIME)))
    model = parse("linear+offset" + name).anchored(motion)
    nonlinear = np.zeros(len(model.nonlinear))
    columns = model.columns(motion, nonlinear)
    genes = least_absolute_deviations(columns[sound], torque[sound]).genes
    half = confidence_intervals(Blocks.of(columns[sound], torque[sound]), genes).half_width
    half = np.concatenate([half, np.full(len(nonlinear), np.inf)])
    return Fitted(model, motion, torque, sound, genes, nonlinear, half, (0, 1), window, command)


def relative(fit: Fitted, change: Array) -> Array:
    return np.asarray((fit.genes[:2] + change[:2]) / TRUE - 1.0)


COMMANDS = {
    "as driven": multisine(TIME),
    "50 ms early": multisine(TIME + 0.05),
    "clipped": np.clip(multisine(TIME), -0.05, 0.05),
    "a torque, upside down": -4.0 * multisine(TIME) - 0.02 * multisine(TIME, 1),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_goes_with_the_motion_takes_the_noise_off_kc_and_bc(name: str) -> None:
    fit = fitted(0.02, command=COMMANDS[name])
    found = deflection_errors(fit)
    assert found.method == "instruments"
    assert relative(fit, np.zeros(2))[1] < -0.05  # Bc, without
    assert np.all(np.abs(relative(fit, found.change)) * TRUE < 1.5 * np.hypot(fit.half_width, found.half_width)[:2])
    assert abs(relative(fit, found.change)[0]) < 0.01


def test_without_a_command_a_simulation_takes_most_of_the_noise_off() -> None:
    fit = fitted(0.02)
    found = deflection_errors(fit)
    before, after = relative(fit, np.zeros(2)), relative(fit, found.change)
    assert (found.method, found.strength) == ("simulation", None)
    assert np.all(np.abs(after) < 0.35 * np.abs(before))
    total = np.hypot(fit.half_width, found.half_width)[:2]
    assert np.all(np.abs(after) * TRUE < 1.5 * total)


@pytest.mark.parametrize(("first", "last", "found"), [(0, 6000, 2500), (4900, 5900, 5000), (100, 900, 0)])
def test_the_errors_are_tried_out_where_the_joint_moves(
    monkeypatch: pytest.MonkeyPatch, first: int, last: int, found: int
) -> None:
    monkeypatch.setattr(fitted_module, "TESTED", 1000)
    fit = fitted(1e-4)
    moves = (np.arange(len(TIME)) >= first) & (np.arange(len(TIME)) < last)
    motion = replace(fit.motion, dtheta=np.where(moves, fit.motion.dtheta, 0.0))
    assert replace(fit, motion=motion).part().motion.time[0] == TIME[found]


def test_a_command_that_has_nothing_to_do_with_the_motion_is_weak_and_not_used() -> None:
    noise = np.random.default_rng(3).standard_normal(len(TIME))
    found = deflection_errors(fitted(0.01, command=noise))
    assert found.is_weak
    assert found.method == "simulation"


def test_coloured_noise_which_has_no_floor_is_shown_by_the_command() -> None:
    rng = np.random.default_rng(4)
    fit = fitted(0.004, command=multisine(TIME))
    slow = 0.03 * np.array(lfilter([0.3], [1.0, -0.95], rng.standard_normal(len(TIME))))
    value, slope, curvature = fit.window.moved(TIME, slow)
    motion = fit.motion
    motion = Motion(
        TIME, motion.dtheta + value, motion.dtheta_dot + slope, motion.dtheta_ddot + curvature, motion.known
    )
    columns = fit.model.columns(motion)
    genes = least_absolute_deviations(columns[fit.used], fit.torque[fit.used]).genes
    fit = replace(fit, motion=motion, genes=genes)
    found = deflection_errors(fit)
    assert found.method == "instruments"
    before, after = (abs(relative(fit, change)[0]) for change in (np.zeros(2), found.change))
    assert before > 0.04
    assert after < 0.4 * before


def test_noise_that_is_small_beside_the_intervals_changes_nothing() -> None:
    found = deflection_errors(fitted(1e-5, command=multisine(TIME)))
    assert found.method == "none"
    assert not found.change.any()
    assert not found.half_width.any()


def test_what_the_command_takes_off_beyond_the_size_of_the_noise_is_uncertain(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a joint with dry friction and 260 counts it was 27 % of Bc, which was 6 % off before."""
    fit = fitted(0.02, command=multisine(TIME))
    plain = deflection_errors(fit)
    far = plain.predicted - 0.3 * np.append(TRUE, 0.0)
    monkeypatch.setattr(correction, "by_command", lambda *_: (Change(far, plain.half_width), 1.0))
    found = deflection_errors(fit)
    np.testing.assert_array_equal(found.change, far)
    assert (found.half_width[:2] >= 0.3 * TRUE).all()
    assert (plain.half_width[:2] < 0.1 * TRUE).all()


def test_a_skew_of_the_model_is_corrected_with_the_other_parameters() -> None:
    fit = fitted(0.01, command=multisine(TIME), name="+skew")
    found = deflection_errors(fit)
    assert found.method == "instruments"
    assert abs(relative(fit, found.change)[0]) < 0.015
    assert abs(fit.nonlinear[0] + found.change[-1]) < 2e-3  # s, of 16.7 between two readings; there is none


@pytest.mark.study
def test_where_the_encoder_has_its_zero_changes_nothing() -> None:
    near, far = (deflection_errors(fitted(0.02, command=multisine(TIME), zero=zero)) for zero in (0.0, 5.0))
    np.testing.assert_allclose(near.change[:2], far.change[:2], rtol=0.02, atol=1e-6)


def test_few_counts_widen_the_intervals_by_where_the_motion_turns_within_one() -> None:
    """A sine over eight counts: its rounding goes with it, by as much as 2.5 % of Kc either way."""
    time, count = np.arange(10_000) / 500.0, 0.05
    wave = np.exp(2j * np.pi * 3.0 * time)
    rng = np.random.default_rng(0)
    torque = 0.3 * 0.2 * wave.imag + 1e-3 * rng.standard_normal(len(time))
    read = count * np.round(0.2 * wave.imag / count)
    fit = fitted(0.01)
    window = window_for(time, read, torque)
    motion = Motion(time, *window.moved(time, read), np.zeros(len(time)))
    model = parse("linear+offset").anchored(motion)
    genes = least_absolute_deviations(model.columns(motion), torque).genes
    fit = replace(fit, model=model, motion=motion, torque=torque, used=window.sound(time), genes=genes, window=window)
    found = deflection_errors(fit)
    assert found.counts == pytest.approx(8.0, abs=1.0)
    assert 0.01 * 0.3 < found.half_width[0] < 0.2 * 0.3
    assert abs(genes[0] + found.change[0] - 0.3) < found.half_width[0] + fit.half_width[0]


def binary(time: Array, settled: float) -> tuple[Array, Array]:
    """Random steps between -0.2 and 0.2 rad every 0.2 s or so, and their rate: each settles by a raised cosine."""
    places = np.random.default_rng(2).choice([-0.2, 0.2], int(time[-1] / 0.2) + 2)
    step, since = np.divmod(time, 0.2013)  # s: no two transitions have the same readings
    part = np.clip(since / settled, 0.0, 1.0)
    before, after = places[step.astype(int)], places[step.astype(int) + 1]
    rate = (after - before) * np.sin(np.pi * part) * 0.5 * np.pi / settled * (part < 1.0)
    return before + (after - before) * 0.5 * (1.0 - np.cos(np.pi * part)), rate


@pytest.mark.study
def test_a_torque_in_counts_widens_the_interval_of_kc_where_the_joint_rests() -> None:
    """The least sum of absolute errors is at a count of the torque at rest, however much noise there is."""
    angle, rate = binary(np.arange(10_000) / 500.0, settled=0.06)
    time, count, noise = np.arange(10_000) / 500.0, 1e-3, np.random.default_rng(0).standard_normal(10_000)
    off, half, narrow = [], [], []
    for stiffness in 0.3 * (1.0 + 1e-3 * np.arange(12)):
        torque = count * np.round((stiffness * angle + 3e-3 * rate + 0.7e-3 * noise) / count)
        window = window_for(time, angle, torque)
        motion, sound = Motion(time, *window.moved(time, angle), np.zeros(len(time))), window.sound(time)
        model = parse("linear").anchored(motion)
        columns = model.columns(motion)[sound]
        genes = least_absolute_deviations(columns, torque[sound]).genes
        narrow.append(confidence_intervals(Blocks.of(columns, torque[sound]), genes).half_width)
        fit = Fitted(
            model, motion, torque, sound, genes, np.zeros(0), narrow[-1], (0, 1), window, None, torque_count=count
        )
        half.append(deflection_errors(fit).half_width)
        off.append(genes - [stiffness, 3e-3])
    kc, sampled, widened = (np.array(values)[:, 0] for values in (off, narrow, half))
    assert np.count_nonzero(np.abs(kc) > sampled) >= 4
    assert np.count_nonzero(np.abs(kc) > np.hypot(sampled, widened)) <= 1
    assert np.all(widened < 3.0 * np.sqrt(np.mean(kc**2)) * 1.96)
    assert np.all(np.array(half)[:, 1] < 0.02 * 3e-3)


def test_a_torque_in_counts_widens_no_interval_of_a_joint_that_does_not_rest() -> None:
    fit = fitted(0.0)
    count = 1e-4
    counted = replace(fit, torque=count * np.round(fit.torque / count), torque_count=count)
    assert np.all(deflection_errors(counted).half_width < 0.1 * fit.half_width)


def rounded(angle: Array, rate: Array, count: float, noise: float) -> Fitted:
    """The fit to a spring and a damper at 500 Hz, read in counts, rad; noise: N m, of the torque."""
    time, read = np.arange(len(angle)) / 500.0, count * np.round(angle / count)
    torque = np.stack([angle, rate], axis=1) @ TRUE + noise * np.random.default_rng(0).standard_normal(len(time))
    window = window_for(time, read, torque)
    motion, sound = Motion(time, *window.moved(time, read), np.zeros(len(time))), window.sound(time)
    model, torque = parse("linear+offset").anchored(motion), window.alike(time, torque)
    columns = model.columns(motion)[sound]
    genes = least_absolute_deviations(columns, torque[sound]).genes
    half = confidence_intervals(Blocks.of(columns, torque[sound]), genes).half_width
    return Fitted(model, motion, torque, sound, genes, np.zeros(0), half, (0, 1), window, angle)


@pytest.mark.parametrize(
    ("middle", "counts"), [(0.0, 1.0), (0.05, 1.959964 / np.sqrt(6.0))], ids=["opposite", "any two"]
)
def test_a_joint_that_rests_at_two_angles_has_the_rounding_of_both_in_its_interval(
    middle: float, counts: float
) -> None:
    """Two angles 2 x apart, each wrong by up to half a count: opposite ones by opposite amounts, others by chance."""
    count, at = 2.0 * np.pi / 2**14, 0.2
    angle, rate = binary(np.arange(10_000) / 500.0, 0.06)
    found = deflection_errors(rounded(angle + middle, rate, count, 1e-3))
    assert found.half_width[0] == pytest.approx(TRUE[0] * counts * count / (2.0 * at), rel=0.1)


def test_a_joint_that_never_rests_has_no_rounding_at_rest() -> None:
    time = np.arange(10_000) / 500.0
    speeds = 2.0 * np.pi * np.geomspace(0.3, 12.0, 30)
    waves = 0.02 * np.exp(1j * (np.outer(time, speeds) + np.arange(30) ** 2))
    of_waves = rounded(waves.real.sum(axis=1), -(waves.imag @ speeds), 2.0 * np.pi / 2**16, 1e-3)
    assert np.all(deflection_errors(of_waves).half_width[:2] < 0.1 * of_waves.half_width[:2])


@pytest.mark.study
def test_transitions_that_are_rounded_alike_each_time_widen_the_interval_of_bc() -> None:
    """Where the counts lie decides: from one place of them to another Bc differs, whatever the noise."""
    count = 2.0 * np.pi / 2**11
    angle, rate = binary(np.arange(10_000) / 500.0, 0.06)
    fits = [rounded(angle + place, rate, count, 1e-5) for place in count * np.random.default_rng(3).random(6)]
    scatter = 1.96 * float(np.std([one.genes[1] for one in fits]))
    stated = float(np.median([deflection_errors(one).half_width[1] for one in fits]))
    assert 0.5 * scatter < stated < 2.0 * scatter


def test_samples_between_two_gaps_that_are_too_few_for_the_window_get_no_more_noise() -> None:
    read = multisine(TIME) + 1e-3 * np.random.default_rng(0).standard_normal(len(TIME))
    window = window_for(TIME, read, np.stack([multisine(TIME), multisine(TIME, 1)], axis=1) @ TRUE)
    assert window.low_pass is not None
    few = 1000 + np.arange(2 * window.low_pass.near)
    time = TIME + 0.1 / RATE * np.random.default_rng(1).uniform(size=len(TIME)) + 3.0 * (np.arange(len(TIME)) >= few[0])
    time[few[-1] + 1 :] += 3.0

    before = Motion(time, read, multisine(TIME, 1), multisine(TIME, 2), np.zeros(len(time)))
    more = next(noisier(before, window))[0].dtheta - before.dtheta

    assert np.isfinite(more).all()
    assert (more[few] == 0.0).all()
    assert np.std(more) > 0.0


def test_what_the_window_takes_off_the_rate_counts_as_an_error_of_it() -> None:
    """Motion beyond the band, of which no window knows all: its size is found, its course only roughly."""
    time = TIME / 5.0
    read, rate = multisine(time), multisine(time, 1)
    window = replace(
        window_for(time, read, 0.3 * read + 3e-3 * rate), slope=20, noise=0.0, of_deflection=0.0, count=0.0
    )
    seen = window.moved(time, read)[1]
    motion = Motion(time, read, seen, multisine(time, 2), np.zeros(len(time)))
    inner = slice(200, -200)

    more, less = next(noisier(motion, window))

    assert window.low_pass is None
    assert np.allclose(more.dtheta_dot + less.dtheta_dot, 2.0 * seen)
    found, true = (np.std((one.dtheta_dot - two)[inner]) for one, two in ((more, seen), (motion, rate)))
    assert 0.5 * true < found < 2.0 * true
