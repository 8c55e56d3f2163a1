"""What a search asks for again is kept, and equals what is computed without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.cache import Kept
from ga.model.coupling import parse
from ga.model.trajectory import Motion

Array = NDArray[np.float64]

TIME = np.arange(0.0, 3.0, 0.004)
WAVE = 0.2 * np.exp(14.0j * TIME) + 0.02 * np.exp(31.0j * TIME)
RATE, ACCELERATION = np.gradient(WAVE, TIME).imag, np.gradient(np.gradient(WAVE, TIME), TIME).imag
MODELS = (
    "linear+offset+drift+coulomb+stribeck+cubic+quadratic+skew",
    "linear+offset+dahl+softening+maxwell+backlash+skew+lag",
    "linear+offset+coulomb+asymmetric+smooth+capstan+mean",
    "linear+offset+boucwen+inertia+hardening+deadband",
    "linear+offset+toe+backlash+gear",
    "linear+offset+dahl+exponential+slack",
    "linear+offset+sheath+progressive",
)


class Smoothed:
    """A filter of the torque: a mean over two samples."""

    longest_step = 1.0

    def of_every(self, _every: int) -> Smoothed:
        return self

    def passing(self, _time: Array) -> Callable[[Array], Array]:
        return lambda values: 0.5 * (values + np.roll(values, 1, axis=-1))


@pytest.mark.study
def test_kept_columns_are_those_computed_without() -> None:
    """At parameters of which one after another moves and returns: no key leaves out what its columns depend on."""
    motion = Motion(TIME, WAVE.imag, RATE, ACCELERATION, np.zeros(len(TIME)), behind=Smoothed())
    some = np.random.default_rng(0).random(len(TIME)) < 0.5
    for name in (*MODELS, *MODELS[::-1]):
        model = parse(name).anchored(motion)
        low, high = model.bounds(motion, 4.0)
        for at in (-1, *range(len(low)), -1):
            values = low + np.where(np.arange(len(low)) == at, 0.6, 0.4) * (high - low)
            for rows, lag in ((slice(None), 0.0), (some, 0.0), (some, 0.02)):
                found = model.columns(motion.of(rows), values, lag)
                assert np.array_equal(found, model.columns(replace(motion).of(rows), values, lag)), (name, at)


def test_what_was_asked_for_last_is_kept() -> None:
    kept = Kept()
    first = kept.get("of a kind", 0, lambda: [0], 2)
    for other in range(1, 9):
        assert kept.get("of a kind", other, lambda: [0], 2) is not first
        assert kept.get("of a kind", 0, lambda: [0], 2) is first
    assert [kept.recalled("of a kind", key) is None for key in range(9)] == [False, *[True] * 7, False]
