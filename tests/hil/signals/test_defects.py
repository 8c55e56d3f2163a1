from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.errors import Untrustworthy
from hil.recording.reader import Array, Recording
from hil.signals.angle import frozen
from hil.signals.defects import clipped
from hil.signals.prepare import LongRecording, prepare
from hil.signals.quality import _wrong_torques
from hil.signals.zero_steps import stuck_torque

from ..conftest import Maker

TIME = np.arange(6000) / 500.0
ANGLE = 0.2 * np.sin(2.0 * np.pi * 1.3 * TIME) + 0.1 * np.sin(2.0 * np.pi * 4.1 * TIME + 1.0)


def in_levels(torque: Array, step: float) -> Array:
    return np.asarray(step * np.round(torque / step))


def noisy(torque: Array) -> Array:
    return np.asarray(torque + 2e-4 * np.random.default_rng(0).standard_normal(len(torque)))


@pytest.mark.parametrize("limits", [(-0.06, 0.05), (-1.0, 0.05), (-0.06, 1.0)])
@pytest.mark.parametrize("step", [1e-9, 1e-4])
def test_readings_at_the_end_of_the_torques_range_are_seen_and_few_others(
    limits: tuple[float, float], step: float
) -> None:
    torque = in_levels(noisy(0.25 * ANGLE), step)
    read = np.clip(torque, *limits)
    found = clipped(ANGLE, read)
    assert found[read != torque].all()
    assert np.count_nonzero(found) < 2.5 * np.count_nonzero(read != torque)


@pytest.mark.parametrize(
    ("angle", "torque"),
    [
        (ANGLE, noisy(0.25 * ANGLE)),
        (ANGLE, in_levels(0.25 * ANGLE, 1e-3)),
        (np.where(TIME % 1.0 < 0.5, 0.3, -0.2), in_levels(noisy(0.25 * np.where(TIME % 1.0 < 0.5, 0.3, -0.2)), 1e-3)),
        (ANGLE, np.repeat(noisy(0.25 * ANGLE)[::12], 12)),
        (ANGLE, noisy(0.25 * ANGLE + 0.02 * np.sign(np.gradient(ANGLE)))),
    ],
    ids=["smooth", "levels", "at rest", "held", "friction"],
)
def test_a_torque_that_turns_or_rests_at_its_extremes_is_not_at_the_end_of_its_range(
    angle: Array, torque: NDArray[np.float64]
) -> None:
    assert not clipped(angle, torque).any()


def test_the_rate_beside_a_clipped_torque_is_that_of_the_whole_motion(make_recording: Maker) -> None:
    def clip(channels: dict[str, Array]) -> None:
        channels["torque"] = np.clip(channels["torque"], *np.quantile(channels["torque"], (0.04, 0.96)))

    with Recording(make_recording(kc=0.02, bc=2e-4, change=clip)) as recording:
        signals = prepare(recording, None)
    columns = np.stack([signals.motion.dtheta, signals.motion.dtheta_dot], axis=1)
    np.testing.assert_allclose(np.linalg.lstsq(columns, signals.torque, rcond=None)[0], [0.02, 2e-4], rtol=1e-3)
    assert signals.defects.clipped > 0.08 * (len(signals) + signals.defects.clipped)
    assert signals.defects.near_gaps < 0.05 * len(signals)


@pytest.mark.parametrize("value", [0.0, 4e-3])
def test_a_torque_that_stands_still_amid_motion_is_left_out_and_its_rows_are_counted(
    make_recording: Maker, value: float
) -> None:
    def stick(channels: dict[str, Array]) -> None:
        channels["torque"][600:850] = value

    with Recording(make_recording(kc=0.02, bc=2e-4, change=stick)) as recording:
        signals, time = prepare(recording, None), recording.channel("time")
    assert signals.defects.stuck_torques == tuple(time[600:850])
    assert not np.isin(signals.motion.time, time[600:850]).any()
    (said,) = _wrong_torques(signals.defects, 2000)
    assert f"the torque of 250 of 2000 rows, from {time[600]:.6g} s to {time[849]:.6g} s, is constant" in said.message


def test_a_torque_that_is_constant_in_a_gap_is_not_stuck() -> None:
    angle = 0.3 * np.sin(2.0 * np.pi * 0.25 * TIME)
    torque = 0.25 * (angle - np.clip(angle, -0.15, 0.15))
    assert frozen(TIME, torque, angle).any()
    assert not stuck_torque(TIME, torque, angle).any()


def in_bursts(channels: dict[str, Array]) -> None:
    channels["time"] += 5.0 * np.median(np.diff(channels["time"])) * (np.arange(len(channels["time"])) // 7)


def mostly_no_numbers(channels: dict[str, Array]) -> None:
    channels["torque"][np.arange(len(channels["torque"])) % 16 > 5] = np.nan


def clipped_at_rest(channels: dict[str, Array]) -> None:
    """The joint passes in few rows from one range of angles to another; the torque of both is beyond its sensor's."""
    at = np.arange(len(channels["time"]))
    angle = np.clip(20.0 * np.sin(at / 20.0), -1.0, 1.0) + 0.3 * np.sin(at / 170.0)
    channels["dtheta"] = np.convolve(np.pad(angle, 3, mode="edge"), np.full(7, 1.0 / 7.0), mode="valid")
    channels["torque"] = np.clip(noisy(0.02 * channels["dtheta"]), -0.01, 0.01)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (in_bursts, "rows lie beside a gap, so that they have no rate. To identify Kc and Bc, record without a pause"),
        (mostly_no_numbers, "rows hold no number"),
        (clipped_at_rest, "end of its sensor's range. To identify Kc and Bc, drive with less torque"),
    ],
)
def test_a_recording_with_no_row_left_is_refused_with_what_most_of_them_lack(
    make_recording: Maker, change: Callable[[dict[str, Array]], None], reason: str
) -> None:
    with (
        Recording(make_recording(change=change)) as recording,
        pytest.raises(Untrustworthy, match=f"none of 2000 rows can be used: .*{reason}"),
    ):
        prepare(recording, None)


@pytest.mark.study
def test_a_long_recording_with_no_row_left_is_refused_before_it_is_read(make_recording: Maker) -> None:
    with Recording(make_recording(change=mostly_no_numbers)) as recording:
        long = LongRecording(recording, None)
        with pytest.raises(Untrustworthy, match="rows hold no number"):
            long.glimpse(rows=500)


def test_a_stretch_of_a_long_recording_without_usable_rows_is_left_out(make_recording: Maker) -> None:
    def half(channels: dict[str, Array]) -> None:
        channels["torque"][: len(channels["torque"]) // 2] = np.nan

    with Recording(make_recording(change=half)) as recording:
        stretches = LongRecording(recording, None).glimpse(parts=4, rows=300)
        assert len(stretches) == 2
        assert min(float(one.motion.time[0]) for one in stretches) > 0.4 * float(recording.channel("time")[-1])
