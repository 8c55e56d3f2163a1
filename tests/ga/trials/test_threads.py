"""A search in several threads has the result of one thread, to the last digit: no thread changes what others read."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse
from ga.model.separable import Problem
from ga.model.terms import TERMS, compatible_model
from ga.model.trajectory import Motion
from ga.trials.nonlinear import search_nonlinear

HIGHEST = 9.0
NONLINEAR = sorted({compatible_model(name, ("offset", "coulomb")) for name, term in TERMS.items() if not term.linear})


@pytest.fixture
def beside_others() -> Iterator[None]:
    """Busy programs on all cores, and a turn for another thread after every few instructions."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4)]
    yield
    sys.setswitchinterval(interval)
    for loop in loops:
        loop.kill()
        loop.wait()


def problem(name: str, samples: int) -> Problem:
    """A model at a fifth of its bounds, and noise, of a motion of `samples` samples at 500 Hz."""
    time = np.arange(samples) / 500.0
    speeds = 2.0 * np.pi * np.geomspace(0.3, HIGHEST, 7)
    waves = np.geomspace(0.1, 0.02, 7) * np.exp(1j * (np.outer(time, speeds) + np.arange(7) ** 2))
    dtheta, rate, acceleration = ((waves * (1j * speeds) ** k).sum(axis=1).imag for k in range(3))
    motion = Motion(time, dtheta, rate, acceleration, np.zeros(samples))
    model = parse(name).anchored(motion)
    low, high = model.bounds(motion, HIGHEST)
    torque = model.columns(motion, low + 0.2 * (high - low), 0.01) @ np.geomspace(1.0, 0.05, len(model.linear))
    noise = 0.01 * np.random.default_rng(3).standard_normal(samples)
    return Problem(model, motion, torque + noise, low, high)


def genes(asked: Problem, workers: int) -> NDArray[np.float64]:
    settings = replace(PRESETS["default"], generations=6)
    return search_nonlinear(asked, settings, trials=4, seed=4, workers=workers)[0].genes


@pytest.mark.study
@pytest.mark.usefixtures("beside_others")
@pytest.mark.parametrize("name", NONLINEAR)
def test_every_nonlinear_model_has_the_same_result_from_any_number_of_threads(name: str) -> None:
    alone = genes(problem(name, 10_001), 1)
    asked = problem(name, 10_001)
    for workers in (2, 4):
        assert np.array_equal(genes(asked, workers), alone)


@pytest.mark.parametrize(
    "name", [pytest.param("linear+offset+backlash", marks=pytest.mark.study), "linear+offset+dahl+skew"]
)
def test_a_small_recording_has_the_same_result_from_any_number_of_threads(name: str) -> None:
    assert np.array_equal(genes(problem(name, 1001), 4), genes(problem(name, 1001), 1))
