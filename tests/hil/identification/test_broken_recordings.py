"""Recordings that say nothing of Kc or Bc are looked at and refused in words, without a warning of NumPy."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest

from hil.errors import Untrustworthy
from hil.identification.identify import identify
from hil.recording.reader import Array
from hil.signals.inspection import inspect

from ..conftest import Maker
from .conftest import SEARCH

Change = Callable[[dict[str, Array]], None]


def ramp_beside_one_jump(channels: dict[str, Array]) -> None:
    time = channels["time"]
    channels["dtheta"] = 0.1 * np.sign(time - 0.4999 * time[-1])
    channels["torque"] = np.linspace(-16.0, 16.0, len(time))


def torque_of_half_the_time(channels: dict[str, Array]) -> None:
    channels["torque"][len(channels["time"]) // 2 :] = 0.0


@pytest.mark.study
@pytest.mark.parametrize(
    ("change", "samples", "rate"), [(ramp_beside_one_jump, 4000, 1000.0), (torque_of_half_the_time, 400, 250.0)]
)
def test_a_recording_that_says_nothing_is_not_trusted(
    make_recording: Maker, change: Change, samples: int, rate: float
) -> None:
    path = make_recording(samples=samples, rate=rate, noise=1e-5, change=change)
    assert inspect(path).samples > 0
    with suppress(Untrustworthy):
        assert not identify([path], None, SEARCH)["Kc"].identifiable
