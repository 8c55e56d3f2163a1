"""Motions in closed form, and what is selected from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.model.terms import SMALLEST, TERMS
from ga.model.trajectory import Motion
from hil.identification.candidates.selection import Selection, select
from hil.signals.defects import Defects
from hil.signals.prepare import Signals
from hil.signals.rate.windows import Window

Array = NDArray[np.float64]

KC, BC = 17.75e-3, 0.19e-3
SAMPLES, RATE, HIGHEST = 2000, 125.0, 12.0
TIME = np.arange(SAMPLES) / RATE
SELECTED = tuple(name for name, one in TERMS.items() if one.selection != "named" and name not in SMALLEST.split("+"))


class Moved(NamedTuple):
    """Time s, deflection rad, rate and acceleration, in closed form."""

    time: Array
    dtheta: Array
    rate: Array
    acceleration: Array

    @property
    def motion(self) -> Motion:
        return Motion(*self, np.zeros(len(self.time)))


def chirp(time: Array = TIME, low: float = 0.2, high: float = HIGHEST) -> Moved:
    sweep = (high - low) / (SAMPLES / RATE)
    phase, omega = 2.0 * np.pi * (low * time + 0.5 * sweep * time**2), 2.0 * np.pi * (low + sweep * time)
    return Moved(
        time,
        0.35 * np.sin(phase),
        0.35 * omega * np.cos(phase),
        0.35 * (2.0 * np.pi * sweep * np.cos(phase) - omega**2 * np.sin(phase)),
    )


def slow() -> Moved:
    """The joint moved so slowly that damping is next to nothing."""
    return Moved(*(part[::4] for part in chirp(TIME, 0.05, 0.5)))


def linear(moved: Moved) -> Array:
    return KC * moved.dtheta + BC * moved.rate


def noise(size: float, seed: int = 1, samples: int = SAMPLES) -> Array:
    return np.asarray(size * np.random.default_rng(seed).standard_normal(samples))


def building_up(moved: Moved, reach: float, friction: float = 2e-3) -> Array:
    """Friction, N m, that builds up over `reach` rad, integrated step by step."""
    states, state = np.empty(len(moved.time)), 0.0
    for at, step in enumerate(np.diff(moved.dtheta, prepend=moved.dtheta[0]).tolist()):
        state = np.sign(step) + (state - np.sign(step)) * np.exp(-abs(step) / reach)
        states[at] = state
    return friction * states


def with_error(error: float) -> Window:
    """A window of readings of the deflection with an error, rad, one standard deviation, whose rates are right."""
    return Window(6, 6, 1.0 / RATE, (0.0, HIGHEST), 0.0, error, 0.0, unseen=np.inf)


def signals(motion: Motion, torque: Array, highest: float = HIGHEST, error: float = 0.0) -> Signals:
    return Signals(motion, torque, Defects(), (0.2, highest), 0.0, "given", with_error(error))


def selected(given: Signals, terms: tuple[str, ...] = SELECTED) -> Selection:
    return select(given, np.ones(len(given), dtype=bool), terms)
