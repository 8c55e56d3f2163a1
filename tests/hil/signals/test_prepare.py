"""From a file to signals: the rate against closed forms, coarse clocks, gaps, and torque through equation (1)."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from hil.errors import Untrustworthy
from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, write
from hil.signals.inspection import inspect
from hil.signals.prepare import LongRecording, joined, prepare, refuse_at_rest
from hil.signals.rate.spectrum import excited_band
from hil.signals.stamps import pieces, spread_stamps
from hil.stand.file import StandTable

from ..conftest import Maker


def signals_of(path: Path, stand: StandTable | None = None) -> object:
    with Recording(path) as recording:
        return prepare(recording, stand)


def test_the_excited_band_is_the_one_that_was_driven() -> None:
    time = np.arange(20000) / 500.0
    rng = np.random.default_rng(0)
    dtheta = 0.1 * np.sin(2 * np.pi * 0.5 * time) + 0.05 * np.sin(2 * np.pi * 6.0 * time)
    low, high = excited_band(time, dtheta + 1e-4 * rng.standard_normal(len(time)))
    assert low == pytest.approx(0.5, abs=0.1)
    assert high == pytest.approx(6.0, abs=0.1)


def test_a_coarse_clock_is_spread_to_within_its_own_tick() -> None:
    """A clock of 15.6 ms over rows every 2.3 ms: the true times come back to within one row's spacing."""
    true = np.arange(5000) * 0.0023
    time, coarse = spread_stamps(np.floor(true / 0.0156) * 0.0156)
    assert coarse
    assert np.all(np.diff(time) > 0.0)
    assert np.abs(time - true).max() < 0.0156 + 0.0023
    assert np.std(np.diff(time)) < 0.0004
    assert len(pieces(np.floor(np.arange(100) / 20.0))) == 1


@pytest.mark.parametrize(("pace", "lost"), [(350.0, 0.0), (350.0, 0.05), (777.0, 0.0)])
def test_stamps_that_a_millisecond_rounds_are_those_of_an_even_pace(pace: float, lost: float) -> None:
    true = np.arange(3000)[np.random.default_rng(0).random(3000) >= lost] / pace
    time, coarse = spread_stamps(1.7e9 + np.floor(1e3 * true) / 1e3)
    assert not coarse
    assert float(np.std(time - 1.7e9 - true)) < 0.02e-3
    jittered = np.round(true + 5e-5 * np.random.default_rng(1).standard_normal(len(true)), 6)
    np.testing.assert_array_equal(spread_stamps(np.sort(jittered))[0], np.sort(jittered))


@pytest.mark.parametrize("begin", [500.0, 1022.0, 9000.0])
def test_stamps_of_single_precision_are_those_of_an_even_pace(begin: float) -> None:
    true = begin + np.arange(3000) / 350.0
    stamps = np.asarray(true, dtype=np.float32).astype(np.float64)
    for read in (stamps, np.round(stamps, 8)):
        assert float(np.std(spread_stamps(read)[0] - true)) < 0.1 * float(np.std(read - true))


def test_stamps_that_repeat_because_they_are_rounded_are_those_of_an_even_pace() -> None:
    true = np.arange(6000) / 2777.0
    rounded = np.floor(1e3 * true) / 1e3
    time, coarse = spread_stamps(rounded)
    assert coarse
    assert float(np.std(time - true)) < 0.02e-3
    paused = np.floor(1e3 * (true + 0.7e-3 * (true > 1.0))) / 1e3
    assert float(np.abs(np.diff(spread_stamps(paused)[0]) * 2777.0 - 1.0).max()) > 0.1  # not taken for an even pace


@pytest.mark.parametrize(("rate", "unit"), [(2000.0, 1e-3), (4000.0, 1e-3), (250.0, 1e-2)])
def test_stamps_that_were_rounded_at_their_halves_get_the_pace_they_had(rate: float, unit: float) -> None:
    true = np.arange(12_000) / rate  # halves are rounded up for long and down for long
    read, coarse = spread_stamps(np.round(true / unit) * unit)
    assert coarse
    np.testing.assert_allclose(read, true, atol=1e-3 * unit)


@pytest.mark.parametrize("packet", [1e-3, 4e-3])
def test_rows_that_arrive_in_bursts_get_the_pace_at_which_they_were_taken(packet: float) -> None:
    """A packet brings the rows of one or four milliseconds, which are stamped as they are unpacked."""
    rng = np.random.default_rng(0)
    true = np.arange(12_000) / 4000.0
    packets = np.ceil(true / packet - 1e-9).astype(int)
    stamped = packets * packet + rng.uniform(0.0, 1e-4, 3001)[packets] + np.cumsum(rng.uniform(1e-9, 4e-9, len(true)))
    time, coarse = spread_stamps(stamped)
    assert coarse
    np.testing.assert_allclose(np.diff(time), 1.0 / 4000.0, rtol=1e-3)
    lost = np.delete(stamped, np.arange(5000, 5400))
    assert np.diff(spread_stamps(lost)[0]).min() > 0.02 / 4000.0


def test_samples_at_random_times_are_no_bursts() -> None:
    stamps = np.cumsum(np.random.default_rng(0).exponential(1e-3, 5000))
    np.testing.assert_array_equal(spread_stamps(stamps)[0], stamps)


def test_a_fine_clock_is_left_alone() -> None:
    stamps = np.cumsum(np.random.default_rng(0).uniform(0.001, 0.003, 500))
    time, coarse = spread_stamps(stamps)
    assert not coarse
    np.testing.assert_array_equal(time, stamps)


def test_a_repeated_last_stamp_goes_on_at_the_pace_before() -> None:
    time, _ = spread_stamps(np.array([0.0, 0.0, 0.1, 0.1, 0.2, 0.2]))
    np.testing.assert_allclose(time, [0.0, 0.05, 0.1, 0.15, 0.2, 0.25])


def test_signals_of_a_clean_recording_are_its_closed_form(make_recording: Maker) -> None:
    """torque = kc*dtheta + bc*rate holds to the gain of the local polynomial."""
    with Recording(make_recording(kc=0.02, bc=2e-4)) as recording:
        signals = prepare(recording, None)
    left = signals.torque - 0.02 * signals.motion.dtheta - 2e-4 * signals.motion.dtheta_dot
    assert 1900 < len(signals) < 2000  # without those at the ends
    assert signals.defects.near_gaps == 0
    assert signals.torque_from == "given"
    assert np.abs(left).max() < 5e-4 * 2e-4 * np.abs(signals.motion.dtheta_dot).max()


def test_rows_with_a_nan_are_dropped_and_counted(make_recording: Maker) -> None:
    def spoil(channels: dict[str, Array]) -> None:
        channels["torque"][100:103] = np.nan
        channels["dtheta"][500] = np.nan

    with Recording(make_recording(change=spoil)) as recording:
        signals = prepare(recording, None)
    assert (signals.defects.not_numbers, signals.defects.lost, signals.defects.near_gaps) == (4, 0, 0)


def test_a_rate_that_came_with_the_data_is_not_used_and_this_is_said(make_recording: Maker) -> None:
    with Recording(make_recording()) as recording:
        derived = prepare(recording, None).motion.dtheta_dot
    path = make_recording(change=lambda channels: channels.update(dtheta_dot=1.1 * np.ones(2000)))
    with Recording(path) as recording:
        assert np.array_equal(prepare(recording, None).motion.dtheta_dot, derived)
    assert [one.code for one in inspect(path).diagnostics] == ["unused-rate"]


def test_rows_of_one_stamp_between_two_pauses_have_no_rate(make_recording: Maker) -> None:
    def change(channels: dict[str, np.ndarray]) -> None:
        channels["time"] = np.floor(np.arange(80) / 17.0) * 0.34
        channels["time"][17:] += 3600.0

    with Recording(make_recording(samples=80, rate=50.0, change=change)) as recording:
        motion = prepare(recording, None).motion
    assert np.isfinite(motion.dtheta_dot + motion.dtheta_ddot).all()


def test_rows_beside_a_gap_have_no_rate_and_are_left_out(make_recording: Maker) -> None:
    def cut(channels: dict[str, Array]) -> None:
        channels["time"][1000:] += 0.5

    with Recording(make_recording(change=cut)) as recording:
        signals = prepare(recording, None)
    assert 0 < signals.defects.near_gaps < 100
    assert len(signals) < 2000 - signals.defects.near_gaps
    assert not np.any(np.abs(signals.motion.time - 2.25) < 0.25)


def test_torque_from_the_motor_is_equation_one(tmp_path: Path) -> None:
    """Prescribed motion, closed form: sigma_m = Dm*acc + Bm*vel + sigma_c/eta gives sigma_c back at the joint."""
    eta, inertia, damping, kc, bc = 4.0, 2e-6, 3e-6, 0.02, 2e-4
    time, omega = np.arange(5000) / 500.0, 2 * np.pi * 3.0
    dtheta, rate = 0.2 * np.sin(omega * time), 0.2 * omega * np.cos(omega * time)
    coupling = kc * dtheta + bc * rate
    motor_torque = inertia * eta * -(omega**2) * dtheta + damping * eta * rate + coupling / eta
    path = tmp_path / "m.h5"
    channels = {
        "time": time,
        "torque": eta * motor_torque,
        "dtheta": dtheta,
        "motor_torque": motor_torque,
        "motor_position": eta * dtheta,
    }
    write(path, Header(profile={"kind": "imported"}), channels)
    stand = StandTable(gear_ratio=eta, motor_inertia=inertia, motor_damping=damping, torque_source="motor")
    with Recording(path) as recording:
        signals = prepare(recording, stand)
    assert signals.torque_from == "motor"
    design = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    found = np.linalg.lstsq(design, signals.coupling_torque, rcond=None)[0]
    assert found[0] == pytest.approx(kc, rel=5e-4)
    assert found[1] == pytest.approx(bc, rel=5e-4)


@pytest.mark.parametrize("samples", [0, 1, 15])
def test_an_almost_empty_recording_is_refused(make_recording: Maker, samples: int) -> None:
    with pytest.raises(Untrustworthy, match="usable sample"):
        signals_of(make_recording(samples=samples))


def test_rows_that_leave_too_few_samples_with_a_rate_identify_nothing(make_recording: Maker) -> None:
    """The first and the last rows of a recording have no rate."""
    with (
        Recording(make_recording(samples=17)) as recording,
        pytest.raises(Untrustworthy, match=r"usable sample\(s\) of 17: record at least 16"),
    ):
        refuse_at_rest(recording, prepare(recording, None))


def test_a_joint_that_rests_wherever_its_rate_is_known_identifies_nothing(make_recording: Maker) -> None:
    """It jumps at the end, where no window gives the rate."""
    path = make_recording(samples=200, change=lambda one: one.update(dtheta=0.3 * (np.arange(200) > 198.0)))
    with (
        Recording(path) as recording,
        pytest.raises(Untrustworthy, match="in the samples that have a rate, the deflection never changes"),
    ):
        refuse_at_rest(recording, prepare(recording, None))


@pytest.mark.parametrize("source", ["motor", pytest.param("joint", marks=pytest.mark.study)])
def test_a_recording_read_in_blocks_is_the_one_read_whole(tmp_path: Path, source: Literal["motor", "joint"]) -> None:
    rng = np.random.default_rng(4)
    time = np.arange(3000) / 500.0 + 2e-5 * rng.standard_normal(3000)
    dtheta = 0.2 * np.sin(2 * np.pi * 2.0 * time) + 1e-4 * rng.standard_normal(3000)
    torque = 0.02 * dtheta + 1e-4 * rng.standard_normal(3000)
    torque[rng.choice(3000, 60)] = np.nan
    channels = {
        "time": time,
        "torque": torque,
        "dtheta": dtheta,
        "motor_torque": torque / 4.0,
        "motor_position": 4.0 * dtheta,
    }
    path = tmp_path / "s.h5"
    write(path, Header(profile={"kind": "imported"}), channels)
    stand = StandTable(gear_ratio=4.0, motor_inertia=2e-7, motor_damping=1e-7, torque_source=source)
    with Recording(path) as recording:
        whole, parts = prepare(recording, stand), list(LongRecording(recording, stand).stream(block=1100))
    assert len(parts) == 3
    together = joined(parts)
    np.testing.assert_allclose(together.torque, whole.torque, rtol=1e-9, atol=1e-12)
    for name in ("time", "dtheta", "dtheta_dot", "dtheta_ddot", "known"):
        found, expected = getattr(together.motion, name), getattr(whole.motion, name)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert together.defects == whole.defects
    assert whole.defects.not_numbers > 50


def test_no_sample_of_a_recording_is_glimpsed_twice(make_recording: Maker) -> None:
    with Recording(make_recording()) as recording:
        for rows in (1 << 14, 900, 100):
            times = np.concatenate([one.motion.time for one in LongRecording(recording, None).glimpse(rows=rows)])
            assert len(np.unique(times)) == len(times) > 0


def test_the_window_is_as_narrow_as_the_noise_of_the_deflection_allows(make_recording: Maker) -> None:
    """What a wide window smooths away is missing in Bc; noise of a hundredth of the rate takes 0.01 % off it."""

    def noisy(channels: dict[str, Array], size: float) -> None:
        rng, count = np.random.default_rng(0), len(channels["dtheta"])
        channels["dtheta"] += size * rng.standard_normal(count)
        channels["torque"] += np.std(channels["torque"]) * rng.standard_normal(count)  # hides that of the rate

    widths = []
    for number, size in enumerate((1e-9, 2e-4, 1e-3)):
        path = make_recording(f"{number}.h5", change=partial(noisy, size=size))
        with Recording(path) as recording:
            found = prepare(recording, None)
        usual = float(np.sqrt(np.mean(found.motion.dtheta_dot**2)))
        assert found.motion.rate_noise is not None
        widths.append((found.rate_window, found.motion.rate_noise / usual))
    assert widths[0][0] < widths[1][0] < widths[2][0]
    assert widths[0][0] == pytest.approx(13.0 * 2e-3, rel=0.01)
    assert 0.003 < widths[1][1] <= 0.01


@pytest.mark.parametrize(("channel", "size"), [("torque", 2e-4), ("torque", -4e-3), ("dtheta", 0.5)])
def test_a_step_of_a_zero_is_subtracted_but_no_friction(make_recording: Maker, channel: str, size: float) -> None:
    def change(channels: dict[str, Array]) -> None:
        channels["torque"] += 1e-3 * channels["time"] + 1e-3 * np.sign(np.gradient(channels["dtheta"]))
        channels[channel][900:] += size * is_step

    for is_step in (False, True):
        with Recording(make_recording(kc=0.02, bc=2e-4, change=change)) as recording:
            signals = prepare(recording, None)
        found = signals.defects.zero_steps
        assert np.ptp(signals.motion.dtheta) < 0.65
        assert [one.channel for one in found] == ["torque" if channel == "torque" else "deflection"] * is_step
        assert [one.size for one in found] == pytest.approx([size] * is_step, rel=0.05)
