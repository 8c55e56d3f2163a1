"""A unit that was mistaken shows in the size of torque and deflection, against the stand's limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.recording.writer import Header, write
from hil.signals.inspection import inspect
from hil.signals.plausibility import Swing, in_words

LIMITS = "[stand]\n[limits]\ntorque = 0.03\ndeflection = 1.0\nvelocity = 100.0\n"


@pytest.mark.parametrize(
    ("torque", "angle", "stand", "count"),
    [
        (1.0, 1.0, LIMITS, 0),
        (1000.0, 57.3, LIMITS, 2),
        (1.0, 57.3, "", 1),
        (1000.0, 1.0, "", 0),  # nothing to hold it against
    ],
)
def test_a_recording_that_its_stand_cannot_have_made_is_warned_of(
    tmp_path: Path, torque: float, angle: float, stand: str, count: int
) -> None:
    time = np.arange(1000) / 500.0
    dtheta = 0.3 * np.sin(8.0 * time)
    noise = 1e-5 * np.random.default_rng(0).standard_normal(time.size)
    channels = {"time": time, "torque": torque * (0.02 * dtheta + noise), "dtheta": angle * dtheta}
    write(tmp_path / "a.h5", Header(profile={"kind": "imported"}, stand_toml=stand), channels)
    assert [one.code for one in inspect(tmp_path / "a.h5").diagnostics].count("wrong-unit") == count


@pytest.mark.parametrize(
    ("angle", "stand", "trusted"),
    [
        (12.0, "", False),
        (9.0, "", True),
        (12.0, LIMITS, False),
        (12.0, LIMITS.replace("deflection = 1.0", 'deflection = "5 rad"'), True),
    ],
)
def test_a_deflection_of_more_than_a_turn_is_an_error_unless_the_limits_allow_it(
    tmp_path: Path, angle: float, stand: str, *, trusted: bool
) -> None:
    time = np.arange(1000) / 500.0
    dtheta = angle * 0.3 * np.sin(8.0 * time)
    noise = 1e-5 * np.random.default_rng(0).standard_normal(time.size)
    channels = {"time": time, "torque": 0.01 * dtheta + noise, "dtheta": dtheta}
    write(tmp_path / "a.h5", Header(profile={"kind": "imported"}, stand_toml=stand), channels)
    found = inspect(tmp_path / "a.h5").diagnostics
    errors = [one for one in found if one.is_error]
    assert [(one.code, one.parameter) for one in errors] == ([] if trusted else [("wrong-unit", None)])


def test_a_range_states_the_span_and_not_the_offset() -> None:
    assert in_words(Swing(-0.1, 0.1), Swing(5.3, 6.33)).endswith("deflection 5.3 to 6.33 rad, a span of 59 deg")
    assert in_words(Swing(-0.1, 0.1), Swing(-34.1, 24.6)).endswith("deflection -34.1 to 24.6 rad, a span of 9.34 turns")


def test_the_likely_unit_is_named(tmp_path: Path) -> None:
    time = np.arange(1000) / 500.0
    channels = {"time": time, "torque": 6.0 * np.sin(8.0 * time), "dtheta": 17.2 * np.sin(8.0 * time)}
    write(tmp_path / "a.h5", Header(profile={"kind": "imported"}, stand_toml=LIMITS), channels)
    said = [one.message for one in inspect(tmp_path / "a.h5").diagnostics if one.code == "wrong-unit"]
    assert "6 N m, 200 times the stand's limit of 0.03 N m" in said[0]
    assert "likely in mN*m: import them with --torque-unit mN*m" in said[0]
    assert "likely in deg: import them with --dtheta-unit deg" in said[1]
