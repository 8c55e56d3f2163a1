"""The delay and the bandwidth of a torque cell from its response to a load that is taken off suddenly.

Two responses are fitted by least squares, and the better one is chosen. A converter that averages over T s (an HX711, a
sigma-delta converter) responds with a ramp of length T: the delay of its reading is T/2, and a sine at 0.443/T keeps 71
% of its amplitude. A first-order low-pass with time constant tau delays low frequencies by tau, and has a bandwidth of
1/(2 pi tau). A constant delay on the way to the computer cannot be measured in this way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from hil.errors import Untrustworthy

Array = NDArray[np.float64]
Shape = Callable[[Array, float], Array]

_CLEAR = 10.0  # times the noise that a step must have
_FEW = 8  # readings on each side


class StepResponse(NamedTuple):
    """The response of a torque cell to a step of the load.

    delay: s. uncertainty: standard uncertainty of the delay, s. bandwidth: Hz. shape: "average" or "low-pass".
    """

    delay: float
    uncertainty: float
    bandwidth: float
    shape: str


def _ramp(t: Array, length: float) -> Array:
    return np.clip(t / length, 0.0, 1.0)


def _decay(t: Array, tau: float) -> Array:
    return -np.expm1(-np.maximum(t, 0.0) / tau)


_SHAPES: dict[str, tuple[Shape, float, float]] = {
    "average": (_ramp, 0.5, 0.443),
    "low-pass": (_decay, 1.0, 1.0 / (2.0 * math.pi)),
}
"""For each shape of response: the response to a step at time 0, as a function of its length, and the delay and
bandwidth for a length of 1 s.
"""


def step_response(time: Array, value: Array) -> StepResponse:
    """Return the step response of a cell from its readings `value` (n,) at `time` (n,), s, which contain one step.

    Raises Untrustworthy if there is no clear step, or if there are too few readings before or after the step.
    """
    time, step = _normalised(time, value)
    period = float(np.median(np.diff(time)))
    middle = float(time[np.argmax(step >= 0.5)])
    near = np.abs(time - middle) < max(40.0 * period, 0.2)
    found = {name: _fitted(time[near] - middle, step[near], shape, period) for name, (shape, _, _) in _SHAPES.items()}
    name = min(found, key=lambda one: found[one][0])
    squares, length = found[name]
    _, late, wide = _SHAPES[name]
    if length < period:  # shorter than readings can show: somewhere between none and a period
        return StepResponse(0.25 * period, 0.25 * period / math.sqrt(3.0), wide / period, name)
    unsure = late * length * math.sqrt(squares / np.count_nonzero(near))
    return StepResponse(late * length, math.hypot(unsure, 0.05 * period), wide / length, name)


def _normalised(time: Array, value: Array) -> tuple[Array, Array]:
    """Return the times (n,), and the readings scaled so that the step goes from 0 to 1."""
    if len(value) < 2 * _FEW:
        raise Untrustworthy(f"{len(value)} readings are too few for a step: measure for longer")
    before, after = float(np.median(value[:_FEW])), float(np.median(value[-_FEW:]))
    noise = max(float(np.std(value[:_FEW])), float(np.std(value[-_FEW:])))
    if abs(after - before) <= _CLEAR * noise or after == before:
        raise Untrustworthy(
            f"no step is seen: the readings go from {before:.6g} to {after:.6g} with a noise of {noise:.3g}; hang a "
            "heavier weight, wait until it is still, and take it off at once, as with scissors"
        )
    step = (value - before) / (after - before)
    crossed = int(np.argmax(step >= 0.5))
    if not _FEW <= crossed <= len(step) - _FEW:
        raise Untrustworthy("the load came off too early or too late: leave a second before and behind it")
    return time, step


def _fitted(time: Array, step: Array, shape: Shape, period: float) -> tuple[float, float]:
    """Return the squared error of the best response of one shape, and its length, s. step: the readings, scaled to a
    step from 0 to 1. period: time between two readings, s.
    """

    def error(begin_and_length: Array) -> float:
        begin, length = float(begin_and_length[0]), math.exp(float(begin_and_length[1]))
        return float(np.sum((step - shape(time - begin, length)) ** 2))

    lengths = np.geomspace(0.5 * period, float(np.ptp(time)), 12)
    tried = [
        minimize(
            error, [-0.5 * length, math.log(length)], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-12}
        )
        for length in lengths
    ]
    best = min(tried, key=lambda one: float(one.fun))
    return float(best.fun), math.exp(float(best.x[1]))
