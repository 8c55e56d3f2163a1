"""Carries the plant through time with an error bound, and remembers its recent past.

Dormand and Prince's pair of orders 5 and 4 (J. Comput. Appl. Math. 6, 1980, table 2) with step-size control. A jump
of the torque, where backlash or a slack tendon makes contact, is found by the control itself: steps shrink until
the error of the one that straddles it is within the tolerance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount, compiled_within
from sim_backend.plant import STATES, Constants, Packed, Vector, at_rest, derivatives

Path = NDArray[np.float64]
"""The plant's state now, its recent past and working space, (PAST + REMEMBERED, WIDTH), changed in place.

One matrix, because a compiled function takes one over in the twentieth of the time that eight arrays need.
"""

RELATIVE = 1e-8
ABSOLUTE = np.array([1e-10, 1e-9, 1e-7, 1e-12, 1e-9, 1e-11, 1e-8, 1e-6, 1e-6, 1e-10, 1e-6])
"""Error allowed in one step, in the units of the plant's state: small against 1 % of the paper's joint at work."""
LONGEST = 0.01
SHORTEST = 1e-12
_STRETCH = 1.1
"""By how much the last step may be longer than proposed: the rest, if shorter, would cost a step of its own."""
REMEMBERED = 4096
"""Steps kept for a sensor that shows an earlier instant."""

# The rows of a path.
CLOCK, STATE, TRIAL, SLOPES = range(4)
"""Clock; state now; state at the end of the step that is tried; from SLOPES on the slopes of the seven stages."""
PAST = SLOPES + 7
"""From here on a ring of past steps: time, s; the state; its slope."""
WIDTH = 1 + 2 * STATES

# The places of the clock.
TIME, STEP, WRITTEN = range(3)
"""Time now, s; the next step to try, s; steps ever written into the ring."""


def start(c: Constants) -> Path:
    """Return a path that begins at rest at time zero."""
    path = np.zeros((PAST + REMEMBERED, WIDTH))
    path[CLOCK, STEP], path[CLOCK, WRITTEN] = 1e-5, 1.0
    path[STATE, :STATES] = path[PAST, 1 : 1 + STATES] = at_rest(c)
    return path


@compiled_no_refcount
def integrate(path: Path, demand: float, until: float, constants: Packed) -> None:
    """Carry the path to `until`, s, while the current loop is asked for the motor torque `demand`, N m.

    Nothing happens where `until` is not later than now.
    """
    clock, state, trial = path[CLOCK], path[STATE], path[TRIAL]
    a, b, c, d, e = path[SLOPES], path[SLOPES + 1], path[SLOPES + 2], path[SLOPES + 3], path[SLOPES + 4]
    f, g = path[SLOPES + 5], path[SLOPES + 6]
    first = 0  # the slope jumps with the demand: the first step begins with a new one
    while clock[TIME] < until:
        left, proposed = until - clock[TIME], clock[STEP]
        step = left if left < _STRETCH * proposed else proposed
        for stage in range(first, 7):
            _combine(stage, step, state, a, b, c, d, e, f, trial)
            derivatives(trial, demand, constants[0], path[SLOPES + stage])
            if stage == 0:
                _remember(path, clock, state, a)  # the past ends with the old slope, the future begins with this
        first = 1
        error = _error_over_tolerance(step, state, a, c, d, e, f, g, trial)
        wanted = 0.9 * error**-0.2 if error > 1e-4 else 5.0
        wanted = step * (0.2 if wanted < 0.2 else wanted if wanted < 5.0 else 5.0)
        if error > 1.0 and step > SHORTEST:
            clock[STEP] = wanted if wanted > SHORTEST else SHORTEST
            continue
        clock[TIME] = until if step == left else clock[TIME] + step
        for i in range(STATES):
            state[i] = trial[i]
            a[i] = g[i]
        _remember(path, clock, state, a)
        if step >= proposed:
            clock[STEP] = SHORTEST if wanted < SHORTEST else wanted if wanted < LONGEST else LONGEST


@compiled_within
def _remember(path: Path, clock: Vector, state: Vector, slope: Vector) -> None:
    """Write time, state and slope into the ring."""
    entry = path[PAST + int(clock[WRITTEN]) % REMEMBERED]
    entry[0] = clock[TIME]
    for i in range(STATES):
        entry[1 + i] = state[i]
        entry[1 + STATES + i] = slope[i]
    clock[WRITTEN] += 1.0


@compiled_within
def _combine(  # noqa: PLR0917 - compiled functions take their parts by position
    stage: int, h: float, y: Vector, a: Vector, b: Vector, c: Vector, d: Vector, e: Vector, f: Vector, x: Vector
) -> None:
    """Set x to the state at which a stage of a step of `h` s from y takes its slope; of the last, to the solution.

    a to f: the slopes of the stages. Written out, because a loop over the table of coefficients costs twice the time.
    """
    for i in range(STATES):
        if stage == 0:
            x[i] = y[i]
        elif stage == 1:
            x[i] = y[i] + h * (a[i] / 5.0)
        elif stage == 2:
            x[i] = y[i] + h * (3.0 / 40.0 * a[i] + 9.0 / 40.0 * b[i])
        elif stage == 3:
            x[i] = y[i] + h * (44.0 / 45.0 * a[i] - 56.0 / 15.0 * b[i] + 32.0 / 9.0 * c[i])
        elif stage == 4:
            slope = 19372.0 / 6561.0 * a[i] - 25360.0 / 2187.0 * b[i] + 64448.0 / 6561.0 * c[i]
            x[i] = y[i] + h * (slope - 212.0 / 729.0 * d[i])
        elif stage == 5:
            slope = 9017.0 / 3168.0 * a[i] - 355.0 / 33.0 * b[i] + 46732.0 / 5247.0 * c[i]
            x[i] = y[i] + h * (slope + 49.0 / 176.0 * d[i] - 5103.0 / 18656.0 * e[i])
        else:
            slope = 35.0 / 384.0 * a[i] + 500.0 / 1113.0 * c[i] + 125.0 / 192.0 * d[i]
            x[i] = y[i] + h * (slope - 2187.0 / 6784.0 * e[i] + 11.0 / 84.0 * f[i])


@compiled_within
def _error_over_tolerance(  # noqa: PLR0917 - compiled functions take their parts by position
    h: float, y: Vector, a: Vector, c: Vector, d: Vector, e: Vector, f: Vector, g: Vector, x: Vector
) -> float:
    """Return the largest error of a step of `h` s from y to x over what is allowed, by the slopes of the stages."""
    worst = 0.0
    for i in range(STATES):
        error = 71.0 / 57600.0 * a[i] - 71.0 / 16695.0 * c[i] + 71.0 / 1920.0 * d[i]
        error += -17253.0 / 339200.0 * e[i] + 22.0 / 525.0 * f[i] - g[i] / 40.0
        before, after = abs(y[i]), abs(x[i])
        ratio = abs(h * error) / (ABSOLUTE[i] + RELATIVE * (after if after > before else before))
        worst = ratio if ratio > worst else worst
    return worst


@compiled_within
def recall(path: Path, t: float, out: Vector) -> bool:
    """Write the state at the earlier time `t`, s, into `out`, (STATES,); cubic between the steps remembered.

    Before the beginning it was at rest. False where `t` lies further back than is remembered.
    """
    newest = int(path[CLOCK, WRITTEN]) - 1
    oldest = newest + 1 - REMEMBERED if newest >= REMEMBERED else 0
    entry = newest
    while entry > oldest and path[PAST + entry % REMEMBERED, 0] > t:
        entry -= 1
    first, second = path[PAST + entry % REMEMBERED], path[PAST + (entry + 1) % REMEMBERED]
    is_outside = entry == newest or first[0] > t
    span = second[0] - first[0]
    s = (t - first[0]) / span
    for i in range(1, 1 + STATES):
        if is_outside:
            out[i - 1] = first[i]
            continue
        y0, y1, d0, d1 = first[i], second[i], span * first[STATES + i], span * second[STATES + i]
        rise = y1 - y0
        out[i - 1] = y0 + s * (d0 + s * ((3.0 * rise - 2.0 * d0 - d1) + s * (d0 + d1 - 2.0 * rise)))
    return not is_outside or entry == newest or oldest == 0
