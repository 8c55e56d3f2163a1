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
from sim_backend.plant import MOTOR, MOTOR_RATE, STATES, Constants, Packed, Vector, at_rest, derivatives

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

TABLEAU = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0],
        [44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
"""The weights of the slopes of the earlier stages in the state of each stage; the last row is the solution."""
ERRORS = np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
"""The weights of the slopes of all stages in the estimated error."""

# The rows of a path.
CLOCK, STATE, TRIAL, SLOPES = range(4)
"""Rows of a `Path`: clock; present state; state at the end of the step that is tried; from SLOPES on, the slopes of the
seven stages.
"""
PAST = SLOPES + 7
"""First row of the ring buffer of past steps. A row holds time, s, state and slope."""
WIDTH = 1 + 2 * STATES

# The places of the clock.
TIME, STEP, WRITTEN, STIFFNESS, DAMPING, CEILING = range(6)
"""Columns of the clock: time now, s; length of the next step, s; number of steps written to the ring buffer so far;
then an impedance law of the firmware: N m/rad and N m s/rad by which angle and rate of the motor lower the demanded
torque within each step, and the largest magnitude of that torque, N m. Without gains the ceiling has no effect.
"""


def start(c: Constants) -> Path:
    """Return a path that starts at time zero with the plant at rest. c: constants of the plant."""
    path = np.zeros((PAST + REMEMBERED, WIDTH))
    path[CLOCK, STEP], path[CLOCK, WRITTEN] = 1e-5, 1.0
    path[STATE, :STATES] = path[PAST, 1 : 1 + STATES] = at_rest(c)
    return path


@compiled_no_refcount
def integrate(path: Path, demand: float, until: float, constants: Packed) -> None:
    """Integrate the path up to `until`, s, while the motor torque `demand`, N m, is demanded of the current loop, less
    what the impedance law in the clock takes off.

    Has no effect if this time has passed. The state becomes NaN if that takes more than `MOST_STEPS` steps.
    """
    clock, state, trial, slopes = path[CLOCK], path[STATE], path[TRIAL], path[SLOPES:PAST]
    first, tried = 0, 0  # the slope jumps with the demand: the first step begins with a new one
    while clock[TIME] < until:
        tried += 1
        if tried > MOST_STEPS:
            state[:], clock[TIME] = math.nan, until
            _remember(path)
            return
        left, proposed = until - clock[TIME], clock[STEP]
        step = left if left < _STRETCH * proposed else proposed
        for stage in range(first, 7):
            for i in range(STATES):
                trial[i] = state[i] + step * _weighted(TABLEAU[stage], slopes, i, stage)
            derivatives(trial, _demanded(demand, clock, trial), constants[0], slopes[stage])
            if stage == 0:
                _remember(path)  # the past ends with the old slope, the future begins with this
        first = 1
        error = _error_over_tolerance(step, state, slopes, trial)
        wanted = 0.9 * error**-0.2 if error > 1e-4 else 5.0
        wanted = step * (0.2 if wanted < 0.2 else wanted if wanted < 5.0 else 5.0)
        if error > 1.0 and step > SHORTEST:
            clock[STEP] = wanted if wanted > SHORTEST else SHORTEST
            continue
        clock[TIME] = until if step == left else clock[TIME] + step
        for i in range(STATES):
            state[i] = trial[i]
            slopes[0, i] = slopes[6, i]
        _remember(path)
        if step >= proposed:
            clock[STEP] = SHORTEST if wanted < SHORTEST else wanted if wanted < LONGEST else LONGEST


@compiled_within
def _demanded(demand: float, clock: Vector, state: Vector) -> float:
    """Return the torque demanded at a state, N m: `demand` less the impedance law of the clock, if it has gains."""
    if clock[STIFFNESS] == 0.0 and clock[DAMPING] == 0.0:
        return demand
    wanted: float = demand - clock[STIFFNESS] * state[MOTOR] - clock[DAMPING] * state[MOTOR_RATE]
    most: float = clock[CEILING]
    return most if wanted > most else -most if wanted < -most else wanted


@compiled_no_refcount
def _remember(path: Path) -> None:
    """Write time, state and slope to the ring buffer."""
    clock, entry = path[CLOCK], path[PAST + int(path[CLOCK, WRITTEN]) % REMEMBERED]
    entry[0] = clock[TIME]
    for i in range(STATES):
        entry[1 + i] = path[STATE, i]
        entry[1 + STATES + i] = path[SLOPES, i]
    clock[WRITTEN] += 1.0


@compiled_within
def _weighted(weights: Vector, slopes: Vector, i: int, stages: int) -> float:
    """Return the sum of the slopes of the first stages of the component i of the state, each times its weight."""
    total = 0.0
    for k in range(stages):
        total += weights[k] * slopes[k, i]
    return total


@compiled_within
def _error_over_tolerance(step: float, state: Vector, slopes: Vector, trial: Vector) -> float:
    """Return the largest ratio of estimated error to tolerance over the components of the state, for a step from state
    to trial.
    """
    worst = 0.0
    for i in range(STATES):
        before, after = abs(state[i]), abs(trial[i])
        error = abs(step * _weighted(ERRORS, slopes, i, 7))
        ratio = error / (ABSOLUTE[i] + RELATIVE * (after if after > before else before))
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
