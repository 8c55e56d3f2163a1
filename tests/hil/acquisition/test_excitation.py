"""Excitations, checked against closed forms and against what each record promises: band, peak, faded ends."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from drivers.servo import Quantity
from hil.acquisition import excitation
from hil.acquisition.excitation import EXCITATIONS, Array, Profile
from hil.errors import WrongUse

RATE = 500.0
GENERATED = [kind for kind, record in EXCITATIONS.items() if record.sampler is not None]


@cache
def make(kind: str, **changes: object) -> Profile:
    settings: dict[str, object] = {
        "amplitude": 0.006,
        "default_amplitude": 0.001,
        "duration": 20.0,
        "band": None,
        "rate": RATE,
        "fade": 0.1,
    }
    return excitation.make(kind, Quantity.TORQUE, **(settings | changes))  # type: ignore[arg-type]


def sampled(profile: Profile) -> tuple[Array, Array]:
    time = np.arange(0.0, profile.duration, 1.0 / RATE)
    return time, profile.at(time)


@pytest.mark.parametrize("kind", GENERATED)
def test_a_profile_starts_and_ends_at_zero_and_never_passes_its_amplitude(kind: str) -> None:
    profile = make(kind)
    _, values = sampled(profile)
    assert profile.at(np.array([0.0, profile.duration])) == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.abs(values).max() <= profile.amplitude * (1 + 1e-12)
    assert np.abs(values).max() >= 0.9 * profile.amplitude


@pytest.mark.parametrize("kind", GENERATED)
def test_nothing_is_commanded_outside_the_profile(kind: str) -> None:
    assert make(kind).at(np.array([-1.0, -1e-9, 20.1, 1e6])).tolist() == [0.0] * 4


@pytest.mark.parametrize("kind", GENERATED)
def test_a_profile_made_block_by_block_is_the_one_made_at_once(kind: str) -> None:
    profile = make(kind, seed=3)
    time, whole = sampled(profile)
    parts = np.concatenate([profile.at(part) for part in np.array_split(time, 37)])
    np.testing.assert_array_equal(parts, whole)


@pytest.mark.parametrize("kind", GENERATED)
def test_no_step_of_a_profile_jumps(kind: str) -> None:
    """A cable whips on a jump; the eased edges of steps and PRBS take 20 ms, or half a bit."""
    time = np.arange(0.0, 4.0, 1e-4)
    values = make(kind, duration=4.0).at(time)
    assert np.abs(np.diff(values)).max() < 0.03 * 0.006


@pytest.mark.parametrize("kind", ["chirp", "multisine"])
def test_the_power_lies_in_the_band(kind: str) -> None:
    _, values = sampled(make(kind, band=(1.0, 10.0)))
    frequency = np.fft.rfftfreq(len(values), 1 / RATE)
    power = np.abs(np.fft.rfft(values)) ** 2
    inside = (frequency >= 0.8) & (frequency <= 11.0)
    assert power[inside].sum() > 0.99 * power.sum()


def test_a_chirp_spends_the_same_time_in_every_octave() -> None:
    """Zero crossings of an exponential sweep: N(t) = 2 f0 / g (e^(g t) - 1), with g = ln(f1/f0)/T."""
    time, values = sampled(make("chirp", band=(0.5, 8.0)))
    growth = np.log(16.0) / 20.0
    for until in (5.0, 10.0, 15.0, 19.8):
        crossings = np.count_nonzero(np.diff(np.sign(values[time < until])) != 0)
        assert crossings == pytest.approx(2 * 0.5 / growth * np.expm1(growth * until), abs=1.01)


def test_a_chirp_over_one_frequency_is_a_sine() -> None:
    time, values = sampled(make("chirp", band=(2.0, 2.0)))
    middle = (time > 0.2) & (time < 19.8)
    np.testing.assert_allclose(values[middle], 0.006 * np.sin(4 * np.pi * time[middle]), atol=1e-12)


def test_a_multisine_has_a_low_peak() -> None:
    """Schroeder's phases hold the crest factor near 1.7; all cosines in phase would have 24."""
    _, values = sampled(make("multisine", fade=0.1))
    assert np.abs(values).max() / np.sqrt(np.mean(values**2)) < 2.0


def test_a_multisine_of_many_lines_keeps_to_its_amplitude() -> None:
    """4 to 375 Hz over 2 s has some 740 lines."""
    profile = make("multisine", band=(4.0, 375.0), rate=1500.0, duration=2.0)
    largest = np.abs(profile.at(np.arange(3000) / 1500.0)).max()
    assert 0.8 * profile.amplitude < largest <= profile.amplitude


def test_a_ramp_is_a_triangle_of_constant_slope() -> None:
    time, values = sampled(make("ramp"))
    slope = np.abs(np.gradient(values, time))[(time > 0.5) & (time < 19.5)]
    assert np.median(slope) == pytest.approx(4 * 0.006 * 0.05, rel=1e-6)
    assert np.mean(np.abs(slope - np.median(slope)) < 1e-9) > 0.99


def test_steps_visit_each_level_for_the_same_time() -> None:
    _, values = sampled(make("steps", fade=0.1, duration=40.0))
    levels, counts = np.unique(np.round(values / 0.006, 6), return_counts=True)
    plateaus = dict(zip(levels.tolist(), counts.tolist(), strict=True))
    assert {level for level, count in plateaus.items() if count > 500} == {-1.0, -0.5, 0.0, 0.5, 1.0}
    assert plateaus[0.5] == pytest.approx(2 * plateaus[1.0], rel=0.05)


def test_a_prbs_repeats_only_after_its_full_length() -> None:
    profile = make("prbs", band=(1.0, 100.0), duration=400.0)
    bits = np.sign(profile.at(np.asarray((np.arange(2 * 32767) + 0.75) / 250.0, dtype=np.float64)))
    np.testing.assert_array_equal(bits[100:32767], bits[32867:65534])
    assert abs(bits[1000 : 1000 + 32767].sum()) == 1.0  # a maximum-length sequence has one bit more of one kind
    for shorter in (7, 31, 151, 217, 1057, 4681):  # the divisors of 32767
        assert not np.array_equal(bits[100 : 10000 - shorter], bits[100 + shorter : 10000])


def test_a_prbs_follows_its_polynomial() -> None:
    """x^15 + x^14 + 1: every bit is the exclusive or of the bits 14 and 15 before it."""
    profile = make("prbs", band=(1.0, 100.0), duration=140.0, seed=12)
    bits = np.sign(profile.at(np.asarray((np.arange(2000) + 1000.75) / 250.0, dtype=np.float64)))
    np.testing.assert_array_equal(bits[15:], -bits[1:-14] * bits[:-15])


@pytest.mark.parametrize("kind", [kind for kind in GENERATED if EXCITATIONS[kind].smooth])
def test_a_smooth_excitation_has_derivatives_that_its_band_bounds(kind: str) -> None:
    profile = make(kind, duration=5.0)
    time = np.arange(1.0, 4.0, 1e-4)
    rate = np.gradient(profile.at(time), time)
    acceleration = np.gradient(rate, time)[3:-3]
    assert np.abs(acceleration).max() <= 1.01 * (2 * np.pi * profile.band[1]) ** 2 * profile.amplitude
    assert np.abs(np.diff(acceleration)).max() <= 0.02 * np.abs(acceleration).max()


@pytest.mark.parametrize("kind", [kind for kind in GENERATED if EXCITATIONS[kind].speeds == "one"])
def test_an_excitation_of_one_speed_has_one(kind: str) -> None:
    """A triangle's speed is constant; a sine's is within a factor of two of its largest most of the time."""
    profile = make(kind)
    time = np.arange(2.0, 18.0, 1e-3)
    speed = np.abs(np.gradient(profile.at(time), time))
    assert np.quantile(speed, 0.35) >= 0.5 * speed.max()


def test_another_seed_gives_another_prbs() -> None:
    assert not np.array_equal(sampled(make("prbs", seed=1))[1], sampled(make("prbs", seed=2))[1])


def test_a_file_is_followed_by_straight_lines(tmp_path: Path) -> None:
    path = tmp_path / "set.csv"
    path.write_text("time,torque\n0,0\n1,0.004\n3,-0.002\n4,0\n")
    profile = make("file", setpoints=path, amplitude=None, duration=None)
    assert (profile.amplitude, profile.duration) == (0.004, 4.0)
    assert profile.at(np.array([0.5, 2.0, 3.5])) == pytest.approx([0.002, 0.001, -0.001])


def test_a_file_with_an_amplitude_is_scaled_to_it(tmp_path: Path) -> None:
    path = tmp_path / "set.csv"
    path.write_text("0,0\n1,2\n2,0\n")
    assert make("file", setpoints=path, amplitude=0.01, duration=None).at(np.array([1.0])) == pytest.approx([0.01])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,0\n1,x\n", "row 2"),
        ("0,0\n1\n", "row 2"),
        ("0,0\n", "at least two rows"),
        ("0,0\n1,1\n1,2\n", "rises"),
        ("0,0\n1,0\n", "all set-points are zero"),
        ("0,0\n1,nan\n", "row 2"),
    ],
)
def test_a_bad_file_of_set_points_is_refused_with_its_row(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "set.csv"
    path.write_text(text)
    with pytest.raises(WrongUse, match=message):
        make("file", setpoints=path)


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        ("chrip", {}, "unknown profile 'chrip'"),
        ("chirp", {"band": (15.0, 0.1)}, "reversed"),
        ("chirp", {"band": (0.0, 5.0)}, "above zero"),
        ("chirp", {"band": (1.0, 200.0)}, "raise --rate"),
        ("chirp", {"band": (float("nan"), 5.0)}, "numbers"),
        ("sine", {"band": (1.0, 2.0)}, "one frequency"),
        ("chirp", {"amplitude": 0.0}, "--amplitude"),
        ("chirp", {"amplitude": float("nan")}, "--amplitude"),
        ("chirp", {"duration": -1.0}, "--duration"),
        ("chirp", {"fade": 0.0}, "--fade"),
        ("file", {}, "--setpoints"),
        ("multisine", {"band": (0.51, 0.52), "duration": 2.0}, "widen --band"),
    ],
)
def test_what_cannot_be_made_is_refused_with_the_option_to_change(
    kind: str, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(WrongUse, match=message):
        make(kind, **changes)


def test_a_profile_in_a_file_can_be_made_again(tmp_path: Path) -> None:
    del tmp_path
    written = make("multisine", band=(0.5, 5.0)).attributes()
    again = excitation.make(
        str(written["kind"]),
        Quantity(str(written["mode"])),
        amplitude=float(written["amplitude"]),
        default_amplitude=1.0,
        duration=float(written["duration"]),
        band=(float(written["band_low"]), float(written["band_high"])),
        rate=RATE,
        fade=float(written["fade"]),
        seed=int(written["seed"]),
    )
    np.testing.assert_array_equal(sampled(again)[1], sampled(make("multisine", band=(0.5, 5.0)))[1])
