"""A drive holds its torque set-points: Kc and Bc come from the smooth part of the staircase."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from ga.model.coupling import parse
from hil.identification.identify import identify
from hil.recording.writer import Header, write
from hil.signals.held_torque import smooth_torque

from ..identification.conftest import SEARCH

KC, BC, INERTIA, STEP = 0.3, 4e-3, 5e-5, 0.02
STAND = f'[stand]\nbackend = "sim"\ngear_ratio = 1.0\nmotor_inertia = {INERTIA}\nmotor_damping = 0.0\n'
TIME = np.arange(400) * STEP
SET_POINTS = 0.1 * np.sin(2.0 * np.pi * (0.5 + 0.28 * TIME) * TIME)  # N m, up to 5 Hz


@pytest.mark.parametrize(
    ("risen", "count", "command"),
    [(0.0, 1e-9, True), (0.3, 1e-9, True), (1.0, 1e-9, True), (1.0, 0.01, True), (0.3, 1e-9, False)],
)
def test_ten_readings_in_a_period_give_bc_only_with_the_set_points(
    tmp_path: Path, risen: float, count: float, command: bool
) -> None:
    """risen: the part of its step that the current has risen when it is read, give or take a fifth. count: N m."""
    b, a, _ = cont2discrete(([1.0], [INERTIA, BC, KC]), STEP)  # exact, for held set-points
    missing = np.clip(1.0 - risen + np.random.default_rng(1).uniform(-0.2, 0.2, len(TIME)), 0.0, 1.0)
    level = count * np.round(SET_POINTS / count)
    read = count * np.round((level - np.diff(level, prepend=0.0) * missing) / count)
    channels = {"time": TIME, "dtheta": lfilter(b[0], a, level), "torque": read, "motor_torque": read}
    channels |= {"command": SET_POINTS} if command else {}
    stand = f'{STAND}torque_source = "motor"\n'
    write(tmp_path / "a.h5", Header(profile={"kind": "chirp", "mode": "torque"}, stand_toml=stand), channels)
    found = identify([tmp_path / "a.h5"], parse("linear+skew"), SEARCH)
    for name, truth in (("Kc", KC), ("Bc", BC)):
        assert found[name].ci95[0] < truth < found[name].ci95[1]
    assert found["Bc"].identifiable == command


def test_a_torque_that_does_not_follow_its_set_points_stays_as_read() -> None:
    for read in (np.tanh(30.0 * SET_POINTS), np.roll(SET_POINTS, 3)):
        assert smooth_torque(read, SET_POINTS) is read


def test_a_lost_reading_stays_lost_and_what_exceeds_the_set_points_is_kept() -> None:
    read = SET_POINTS.copy()
    read[100], read[200] = np.nan, max(SET_POINTS[199:201]) + 0.02
    found = smooth_torque(read, SET_POINTS)
    assert np.flatnonzero(np.isnan(found)).tolist() == [100]
    assert found[200] - smooth_torque(SET_POINTS, SET_POINTS)[200] == pytest.approx(0.02, rel=0.01)
