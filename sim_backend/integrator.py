"""Integrate the plant's equations over time with a bounded error, and store the recent past.

The method is Dormand and Prince's pair of orders 5 and 4 (J. Comput. Appl. Math. 6, 1980, table 2) with step-size
control. The torque jumps where backlash or a slack tendon makes contact. The step-size control needs no special case
for this: steps shrink until the error of the step that contains the jump is within the tolerance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount, compiled_within
from sim_backend.plant import STATES, Constants, Packed, Vector, at_rest, derivatives

Path = NDArray[np.float64]
"""The plant's present state, its recent past and working space: an array (PAST + REMEMBERED, WIDTH) that is changed in
place.

One array is used because a compiled function accepts one array in a twentieth of the time of eight arrays.
"""

RELATIVE = 1e-8
ABSOLUTE = np.array([1e-10, 1e-9, 1e-7, 1e-12, 1e-9, 1e-11, 1e-8, 1e-6, 1e-6, 1e-10, 1e-6])
"""Absolute error allowed in one step, for each component of the plant's state: small against 1 % of the values at which
the paper's joint works.
"""
LONGEST = 0.01
SHORTEST = 1e-12
MOST_STEPS = 4_000_000
"""Most steps of one call of `integrate`, some seconds of processor time."""
_STRETCH = 1.1
"""Factor by which the last step may be longer than proposed. A short remainder would need a step of its own."""
REMEMBERED = 4096
"""Number of past steps that are stored for sensors with a delay."""

# The rows of a path.
CLOCK, STATE, TRIAL, SLOPES = range(4)
"""Rows of a `Path`: clock; present state; state at the end of the step that is tried; from SLOPES on, the slopes of the
seven stages.
"""
PAST = SLOPES + 7
"""First row of the ring buffer of past steps. A row holds time, s, state and slope."""
WIDTH = 1 + 2 * STATES

# The places of the clock.
TIME, STEP, WRITTEN = range(3)
"""Columns of the clock: time now, s; length of the next step, s; number of steps written to the ring buffer so far."""


def start(c: Constants) -> Path:
    """Return a path that starts at time zero with the plant at rest. c: constants of the plant."""
    path = np.zeros((PAST + REMEMBERED, WIDTH))
    path[CLOCK, STEP], path[CLOCK, WRITTEN] = 1e-5, 1.0
    path[STATE, :STATES] = path[PAST, 1 : 1 + STATES] = at_rest(c)
    return path


@compiled_no_refcount
def integrate(path: Path, demand: float, until: float, constants: Packed) -> None:
    """Integrate the path up to `until`, s, while the motor torque `demand`, N m, is demanded of the current loop.

    Has no effect if this time has passed. The state becomes NaN if that takes more than `MOST_STEPS` steps.
    """
    clock, state, trial = path[CLOCK], path[STATE], path[TRIAL]
    a, b, c, d, e = path[SLOPES], path[SLOPES + 1], path[SLOPES + 2], path[SLOPES + 3], path[SLOPES + 4]
    f, g = path[SLOPES + 5], path[SLOPES + 6]
    first, tried = 0, 0  # the slope jumps with the demand: the first step begins with a new one
    while clock[TIME] < until:
        tried += 1
        if tried > MOST_STEPS:
            state[:], clock[TIME] = math.nan, until
            _remember(path, clock, state, a)
            return
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
    """Write time, state and slope to the ring buffer."""
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
    """Set x to the state at which the stage `stage` of a step from y evaluates its slope; for the last stage this is
    the solution.

    h: length of the step, s. a to f: the slopes of the earlier stages. The sums are written out, because a loop over
    the table of coefficients takes twice the time.
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
    """Return the largest ratio of estimated error to tolerance over the components of the state, for a step from y to
    x.

    h: length of the step, s. a to g: the slopes of the stages (b is not needed).
    """
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
    """Write the state at the earlier time `t`, s, into `out`, (STATES,), by cubic interpolation between stored steps.

    For a time before the start, the state is the state at rest. Returns False if `t` is older than the stored steps.
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
