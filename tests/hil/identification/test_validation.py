"""The error in held-out data: of a fit in which nothing is guessed that the other data do not say."""

from __future__ import annotations

import numpy as np
import pytest

from ga.model.coupling import parse
from hil.identification.identify import identify
from hil.recording.reader import Array

from ..conftest import Maker
from .conftest import SEARCH

NOISE = 2e-5


def slackens_where_held_out(channels: dict[str, Array]) -> None:
    """The tendon pulls beyond -0.2 rad, and the joint passes that place in one held-out tenth of the time only."""
    time, rng = channels["time"], np.random.default_rng(1)
    aside = np.exp(-(((time - 0.75 * time[-1]) / (0.02 * time[-1])) ** 2))  # the eighth tenth
    angle = channels["dtheta"] * 0.5 - 0.3 * aside
    rate = np.gradient(angle, time)
    pulls = np.maximum(angle + 0.2, 0.0) > 0.0
    channels["dtheta"] = angle
    channels["torque"] = np.where(pulls, 0.02 * (angle + 0.2) + 2e-4 * rate, 0.0) + NOISE * rng.standard_normal(
        len(time)
    )


@pytest.mark.study
def test_a_place_that_only_held_out_data_show_keeps_its_value(make_recording: Maker) -> None:
    """The other data say where torque and spring meet, but not where the tendon slackens."""
    path = make_recording(samples=3000, change=slackens_where_held_out)
    found = identify([path], parse("linear+offset+slack"), SEARCH)
    assert found["slack"].value == pytest.approx(-0.2, abs=2e-3)
    assert found.validation.nrmse < 2.0 * NOISE / float(np.std(found.signals.torque))


def grows_beyond_all_measure(channels: dict[str, Array]) -> None:
    """What an unstable filter makes of the angle: the last of the readings outweigh all others."""
    channels["dtheta"] = np.power(-3.0, np.arange(24.0))


def test_readings_that_decide_on_no_parameter_are_refused_in_words(make_recording: Maker) -> None:
    found = identify([make_recording(samples=24, change=grows_beyond_all_measure)], parse("linear"), SEARCH)
    assert [found[name].identifiable for name in ("Kc", "Bc")] == [False, False]
    assert found.validation.nrmse > 0.0
