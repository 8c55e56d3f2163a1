"""The joint that MuJoCo simulates for the truth study, against closed forms of the motion that it found."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP, KC, BC = 1e-4, 0.3, 3e-3

pytestmark = pytest.mark.study
pytest.importorskip("mujoco", reason="MUJOCO AS A SOURCE NOT TESTED: mujoco is not installed")


@pytest.fixture(scope="module")
def mujoco_joint() -> Iterator[ModuleType]:
    import importlib

    folder = str(Path(__file__).parent.parent.parent / "benchmarks")
    sys.path.insert(0, folder)
    yield importlib.import_module("mujoco_joint")
    sys.path.remove(folder)


def moved(mujoco_joint: ModuleType, **parts: float) -> tuple[Array, Array, Array]:
    """Deflection, rate, and torque beyond that of spring and damper, of a sine of 3 Hz."""
    time, speed = np.arange(5000) * STEP, 2.0 * np.pi * 3.0
    wave = 0.2 * np.sin(speed * time), 0.2 * speed * np.cos(speed * time)
    deflection, rate, torque = mujoco_joint.simulated(mujoco_joint.Joint(KC, BC, **parts), STEP, *wave)
    return deflection, rate, torque - KC * deflection - BC * rate


def test_a_cubic_spring_and_a_quadratic_damper_act_in_both_directions(mujoco_joint: ModuleType) -> None:
    deflection, rate, more = moved(mujoco_joint, cubic=1.0, quadratic=1e-3)
    assert more == pytest.approx(deflection**3 + 1e-3 * rate * np.abs(rate), abs=1e-12)


def test_friction_has_its_full_size_as_soon_as_the_joint_moves(mujoco_joint: ModuleType) -> None:
    _, rate, more = moved(mujoco_joint, friction=2e-3)
    moving = np.abs(rate) > 0.01
    assert np.mean(moving) > 0.995
    assert more[moving] == pytest.approx(2e-3 * np.sign(rate[moving]), rel=0.01)


def test_a_spring_with_a_gap_is_slack_in_it_while_the_damper_acts(mujoco_joint: ModuleType) -> None:
    deflection, _, more = moved(mujoco_joint, gap=0.02)
    assert more == pytest.approx(-KC * np.clip(deflection, -0.01, 0.01), abs=1e-12)


def test_a_spring_that_yields_has_moved_no_further_than_its_reach(mujoco_joint: ModuleType) -> None:
    deflection, _, more = moved(mujoco_joint, yielding=0.4, reach=0.01)
    state = np.zeros(len(deflection))
    for at in range(1, len(state)):
        state[at] = np.clip(state[at - 1] + deflection[at] - deflection[at - 1], -0.01, 0.01)
    assert more == pytest.approx(0.4 * state, abs=1e-12)


def test_a_branch_relaxes_in_its_time(mujoco_joint: ModuleType) -> None:
    deflection, _, more = moved(mujoco_joint, branch=0.1, relaxing=0.03)
    behind = np.zeros(len(deflection))
    for at in range(1, len(behind)):  # the trapezoidal rule, of second order in the step
        middle = 0.5 * (deflection[at] + deflection[at - 1])
        behind[at] = (behind[at - 1] * (1.0 - 0.5 * STEP / 0.03) + middle * STEP / 0.03) / (1.0 + 0.5 * STEP / 0.03)
    assert more == pytest.approx(0.1 * (deflection - behind), abs=2e-3 * np.abs(more).max())


def test_the_servo_of_a_stiff_joint_is_stiff_too(mujoco_joint: ModuleType) -> None:
    time, speed = np.arange(5000) * STEP, 2.0 * np.pi * 3.0
    wave = 0.01 * np.sin(speed * time), 0.01 * speed * np.cos(speed * time)
    deflection, _, torque = mujoco_joint.simulated(mujoco_joint.Joint(500.0, 5.0), STEP, *wave)
    assert deflection == pytest.approx(wave[0], abs=0.05 * 0.01)
    assert np.abs(torque).max() == pytest.approx(500.0 * 0.01, rel=0.05)
