from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.recording.reader import Array, Recording
from hil.signals.defects import clipped
from hil.signals.prepare import prepare

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
