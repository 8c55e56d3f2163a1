"""Carries the plant through time with an error bound, and remembers its recent past.

Dormand and Prince's pair of orders 5 and 4 (J. Comput. Appl. Math. 6, 1980, table 2) with step-size control. A jump
of the torque, where backlash or a slack tendon makes contact, is found by the control itself: steps shrink until
the error of the one that straddles it is within the tolerance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled, compiled_no_refcount
from sim_backend.plant import STATES, Constants, Vector, at_rest, derivatives

RELATIVE = 1e-8
ABSOLUTE = np.array([1e-10, 1e-9, 1e-7, 1e-12, 1e-9, 1e-11, 1e-8, 1e-6, 1e-6, 1e-10, 1e-6])
"""Error allowed a step, in the units of the plant's state: small against 1 % of the paper's joint at work."""
LONGEST = 0.01
SHORTEST = 1e-12
_STRETCH = 1.1
"""By how much the last step may be longer than proposed: a rest that is shorter would cost a step of its own."""
REMEMBERED = 4096
"""Steps kept for a sensor that shows an earlier instant."""

SIZE = 3 + 9 * STATES + REMEMBERED * (1 + 2 * STATES)
"""Numbers that a path takes."""

Counter = NDArray[np.int64]

TIME = 0
STEP = 1


class Path(NamedTuple):
    """The state now, the recent past, and room to work in: arrays only, all written in place.

    All are parts of one memory, which is passed to a compiled function in a twentieth of their time. now: time, s, and
    the next step to try, s. state: (STATES,). slopes: (7, STATES). trial: (STATES,).
    times: (REMEMBERED,), states and rates: (REMEMBERED, STATES), a ring. written: entries ever written, (1,).
    """

    now: Vector
    state: Vector
    slopes: Vector
    trial: Vector
    times: Vector
    states: Vector
    rates: Vector
    written: Counter


def start(c: Constants, memory: Vector | None = None) -> Path:
    """A path that begins at rest at time zero, in `memory`, (SIZE,) zeros, or in one of its own."""
    path = path_in(np.zeros(SIZE) if memory is None else memory)
    path.now[STEP] = 1e-5
    path.state[:] = at_rest(c)
    _begin(path)
    return path


@compiled
def _begin(path: Path) -> None:
    _remember(path)


@compiled
def path_in(memory: Vector) -> Path:
    """Return the path that `memory` holds."""
    state = memory[3:]
    slopes = state[STATES:]
    trial = slopes[7 * STATES :]
    times = trial[STATES:]
    states = times[REMEMBERED:]
    rates = states[REMEMBERED * STATES :]
    return Path(
        memory[0:2],
        state[:STATES],
        slopes[: 7 * STATES].reshape((7, STATES)),
        trial[:STATES],
        times[:REMEMBERED],
        states[: REMEMBERED * STATES].reshape((REMEMBERED, STATES)),
        rates[: REMEMBERED * STATES].reshape((REMEMBERED, STATES)),
        memory[2:3].view(np.int64),
    )


@compiled_no_refcount
def _remember(path: Path) -> None:
    """Write where the path is, and its slope there, into the ring."""
    entry = path.written[0] % REMEMBERED
    path.times[entry] = path.now[TIME]
    for i in range(STATES):
        path.states[entry, i] = path.state[i]
        path.rates[entry, i] = path.slopes[0, i]
    path.written[0] += 1


@compiled_no_refcount
def _stages(path: Path, demand: float, h: float, c: Constants) -> None:
    """One step of `h` s: the slopes of the seven stages, and the solution of order 5 in `trial`.

    Written out, because a loop over the table of coefficients costs twice the time.
    """
    x, k, y = path.trial, path.slopes, path.state
    for i in range(STATES):
        x[i] = y[i] + h * (k[0, i] / 5.0)
    derivatives(x, demand, c, k[1])
    for i in range(STATES):
        x[i] = y[i] + h * (3.0 / 40.0 * k[0, i] + 9.0 / 40.0 * k[1, i])
    derivatives(x, demand, c, k[2])
    for i in range(STATES):
        x[i] = y[i] + h * (44.0 / 45.0 * k[0, i] - 56.0 / 15.0 * k[1, i] + 32.0 / 9.0 * k[2, i])
    derivatives(x, demand, c, k[3])
    for i in range(STATES):
        slope = 19372.0 / 6561.0 * k[0, i] - 25360.0 / 2187.0 * k[1, i] + 64448.0 / 6561.0 * k[2, i]
        x[i] = y[i] + h * (slope - 212.0 / 729.0 * k[3, i])
    derivatives(x, demand, c, k[4])
    for i in range(STATES):
        slope = 9017.0 / 3168.0 * k[0, i] - 355.0 / 33.0 * k[1, i] + 46732.0 / 5247.0 * k[2, i]
        x[i] = y[i] + h * (slope + 49.0 / 176.0 * k[3, i] - 5103.0 / 18656.0 * k[4, i])
    derivatives(x, demand, c, k[5])
    for i in range(STATES):
        slope = 35.0 / 384.0 * k[0, i] + 500.0 / 1113.0 * k[2, i] + 125.0 / 192.0 * k[3, i]
        x[i] = y[i] + h * (slope - 2187.0 / 6784.0 * k[4, i] + 11.0 / 84.0 * k[5, i])
    derivatives(x, demand, c, k[6])


@compiled_no_refcount
def _attempt(path: Path, demand: float, h: float, c: Constants) -> float:
    """Try one step of `h` s; the result is left in `trial`, its slope in the last of `slopes`. Error over tolerance."""
    _stages(path, demand, h, c)
    k = path.slopes
    worst = 0.0
    for i in range(STATES):
        error = 71.0 / 57600.0 * k[0, i] - 71.0 / 16695.0 * k[2, i] + 71.0 / 1920.0 * k[3, i]
        error += -17253.0 / 339200.0 * k[4, i] + 22.0 / 525.0 * k[5, i] - k[6, i] / 40.0
        allowed = ABSOLUTE[i] + RELATIVE * max(abs(path.state[i]), abs(path.trial[i]))
        worst = max(worst, abs(h * error) / allowed)
    return worst


@compiled_no_refcount
def integrate(path: Path, demand: float, until: float, c: Constants) -> None:
    """Carry the path to `until`, s, with the motor torque demand held at `demand`, N m.

    Nothing happens where `until` is not later than now.
    """
    if until <= path.now[TIME]:
        return
    derivatives(path.state, demand, c, path.slopes[0])
    _remember(path)  # the slope jumps with the demand: the past ends with the old one, the future begins with this
    while path.now[TIME] < until:
        left = until - path.now[TIME]
        proposed = path.now[STEP]
        step = left if left < _STRETCH * proposed else proposed
        error = _attempt(path, demand, step, c)
        factor = 5.0 if error < 1e-4 else max(0.2, min(5.0, 0.9 * error**-0.2))
        if error > 1.0 and step > SHORTEST:
            path.now[STEP] = max(step * factor, SHORTEST)
            continue
        path.now[TIME] = until if step == left else path.now[TIME] + step
        for i in range(STATES):
            path.state[i] = path.trial[i]
            path.slopes[0, i] = path.slopes[6, i]
        _remember(path)
        if step >= proposed:
            path.now[STEP] = max(SHORTEST, min(LONGEST, step * factor))


@compiled_no_refcount
def recall(path: Path, t: float, out: Vector) -> bool:
    """Write the state at the earlier time `t`, s, into `out`, (STATES,); cubic between the steps remembered.

    Before the beginning it was at rest. False where `t` lies further back than is remembered.
    """
    newest = path.written[0] - 1
    oldest = max(0, path.written[0] - REMEMBERED)
    entry = newest
    while entry > oldest and path.times[entry % REMEMBERED] > t:
        entry -= 1
    first = entry % REMEMBERED
    if entry == newest or path.times[first] > t:
        for i in range(STATES):
            out[i] = path.states[first, i]
        return bool(entry == newest or oldest == 0)
    second = (entry + 1) % REMEMBERED
    span = path.times[second] - path.times[first]
    s = (t - path.times[first]) / span
    for i in range(STATES):
        y0, y1 = path.states[first, i], path.states[second, i]
        d0, d1 = span * path.rates[first, i], span * path.rates[second, i]
        rise = y1 - y0
        out[i] = y0 + s * (d0 + s * ((3.0 * rise - 2.0 * d0 - d1) + s * (d0 + d1 - 2.0 * rise)))
    return True
