"""The terms of the sensors: offset, drift, skew and lag of the torque reading."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ga.model.record import STRENGTH, Mark, Parameter, Term, searched

if TYPE_CHECKING:
    from ga.arrays import Array
    from ga.model.record import Bounds
    from ga.model.trajectory import Motion

LONGEST_SKEW: Final = 0.02
"""The largest difference in time between the torque reading and the angle reading of one tick, s."""

LONGEST_LAG: Final = 0.05
"""The longest time constant of a torque cell, s: that of a bandwidth of 3 Hz."""

LONGEST_MEAN: Final = 0.1
"""The longest time, s, over which a sensor may average its torque reading."""

TICKS_LATE: Final = 10.0
"""The number of ticks by which a filter may delay the torque reading, if that is longer than `LONGEST_SKEW`."""


def _skew_bounds(motion: Motion, highest: float) -> tuple[tuple[float, float], ...]:
    import numpy as np

    filtered = TICKS_LATE * float(np.median(np.diff(motion.time))) if len(motion) > 1 else 0.0
    # beyond a quarter of the shortest period it cannot be identified
    longest = min(max(LONGEST_SKEW, filtered), 1.0 / (4.0 * highest))
    return ((-longest, longest),)


def _until(longest: float, periods: float) -> Bounds:
    """Return the bounds of a time: 0 to `periods` shortest periods of the motion, but at most `longest`, s."""
    return lambda _motion, highest: ((0.0, min(longest, periods / highest)),)


def _lagged(motion: Motion, torque: Array, own: Array) -> Array:
    """Return a torque (m,) or columns (m, p) of the whole motion behind a first-order lag, at the samples (n,) of the
    motion. own (1,): the time constant, s.
    """
    (constant,), (whole, rows) = own.tolist(), motion.whole
    return whole.lagged(torque, constant)[rows]


def settling(motion: Motion, own: Array) -> Array:
    """Return the weight (n,), 1 to 0, that the initial state of its piece still has at each sample. own (1,): the time
    constant, s.
    """
    return motion.fading(motion.elapsed, *own.tolist())


OFFSET: Final = Term(
    "offset",
    "a constant torque",
    (Parameter("tau0", "N*m", "torque at rest, at the first sample", "torque at rest"),),
    columns=lambda r: (r.time**0,),
    role="bias",
    bench="always",
    mark=Mark("offset", "an offset of the torque", "try --model {offset}"),
    selection="smallest",  # no reading's zero is quite the coupling's: other terms would stand in for it on the way
    bends=False,
    example="tau0 2, 5, 40 % of torque",
    equation="tau0",
)

DRIFT: Final = Term(
    "drift",
    "a torque that grows in time",
    (Parameter("drift", "N*m/s", "slope of the torque reading in time"),),
    # from the first sample on: an absolute time would be nearly collinear with the offset
    columns=lambda r: (r.time,),
    selection="considered",
    role="bias",
    bench="small",
    repeats=True,
    mark=Mark("drift", "a drift of the torque", "try --model {drift}"),
    needs="offset",
    bends=False,
    example="drift 2, 10, 40 % of torque",
    equation="drift*t",
)

SKEW: Final = Term(
    "skew",
    "a torque reading older than the angle's",
    (
        searched(
            "skew", "s", "age of the torque reading less the angle's", "delay", starts=(0.25, 0.5, 0.75), refined=True
        ),
    ),
    bounds=_skew_bounds,
    delays=True,
    selection="considered",
    role="channel",
    bench="always",
    mark=Mark("skew", "a time shift between torque and angle", "try --model {skew}"),
    # it moves the breaks that friction makes at every reversal, and differs little from what else follows late
    confusable=("coulomb", "lag", "maxwell"),
    bends=False,
    example="skew 0.0003, 0.001, 0.004 s",
    equation="x and v are those of the time t - skew",
)

LAG: Final = Term(
    "lag",
    "a torque cell that follows with a first-order lag",
    (searched("lag", "s", "time constant of the torque cell", "lag time", **STRENGTH, starts=(0.02, 0.1, 0.3, 0.6)),),
    bounds=_until(LONGEST_LAG, 0.5),  # behind a longer one the damping cannot be identified
    cell=_lagged,
    forgets=settling,
    role="channel",
    mark=Mark(
        "sensor-lag",
        "a torque cell with a low bandwidth",
        "try --model {lag}, or use a faster cell or switch its filter off",
    ),
    bends=False,
    example="lag 0.001, 0.005, 0.02 s",
    equation="the reading r follows tau: lag*dr/dt = tau - r",
)

MEAN: Final = Term(
    "mean",
    "a torque reading that is a mean over some time, as filters of an even delay make it",
    (
        searched(
            "window",
            "s",
            "time over which a torque reading is the mean, half before and half after; its delay is the skew",
            "mean time",
            **STRENGTH,
            starts=(0.1, 0.3, 0.6),
        ),
    ),
    bounds=_until(LONGEST_MEAN, 0.7),  # a sine is lost in its mean over a period
    cell=lambda m, torque, own: m.averaged(torque, *own.tolist()),
    excludes=("lag",),
    role="channel",
    reason="lag and mean are two accounts of the torque cell's filter",
    bends=False,
    example="window 0.004, 0.01, 0.03 s",
    equation="the reading is the mean of tau over window",
)
