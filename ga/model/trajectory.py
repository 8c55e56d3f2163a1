"""The motion of the joint, from which a coupling model computes its columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from ga.arrays import Array, Index, Mask
    from ga.model.spline import Spline


class Filter(Protocol):
    """The filter that the readings of torque and of angle went through, the same for both.

    longest_step: the longest time between two samples, s, at which the filter is possible. of_every: returns the filter
    for a signal with only every n-th sample. passing: returns a function that filters values (n,) or (k, n).
    """

    @property
    def longest_step(self) -> float: ...  # noqa: D102

    def of_every(self, every: int) -> Filter: ...  # noqa: D102

    def passing(self, time: Array) -> Callable[[Array], Array]: ...  # noqa: D102


FORGOTTEN: Final = 30.0
"""The number of time constants after which an initial state has no effect within floating-point precision."""

_APART: Final = 300.0
"""The motion is a single sine if the variance of the acceleration exceeds this many times that of its part that
deflection and rate do not explain.
"""

_TINY: Final = 1e-300

_EIGHTH: Final = 0.125
"""Half a quarter of the range, the distance between the deflections whose crossings are counted, over the range."""

_AGAIN: Final = 4
"""The number of passes of the joint below which a change in time looks like a difference between directions."""

_DENSE: Final = 0.25
"""The largest time between samples for interpolation, relative to the time in which the rate changes by its own
size.
"""

_FEWEST: Final = 50
"""The smallest number of samples of each piece in a coarser motion."""

_PARTS: Final = ("dtheta", "dtheta_dot", "dtheta_ddot", "known")


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of the joint, as arrays (n,): time s, dtheta rad, dtheta_dot rad/s, dtheta_ddot rad/s^2, known N m.

    known: the part of the measured torque that is not the coupling's and needs no parameter, such as the motor's own
    inertia in equation (1). starts: the first sample of each piece, beginning with 0. A piece is a part of one
    recording without gaps; nothing is interpolated from one piece to the next. rate_noise: the noise of the rate,
    rad/s; None if unknown. behind: the filter that the torque and all parts of the motion went through; None without a
    filter. part_of: the larger motion, and the rows of it that this motion consists of; None if this motion is whole.
    Raises ValueError if the lengths differ.
    """

    time: Array
    dtheta: Array
    dtheta_dot: Array
    dtheta_ddot: Array
    known: Array
    starts: tuple[int, ...] = (0,)
    rate_noise: float | None = None
    part_of: tuple[Motion, Index] | None = None
    behind: Filter | None = None

    def __post_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in ("time", *_PARTS)}
        if shapes != {(self.time.size,)}:
            raise ValueError(f"the parts of a motion differ in shape: {sorted(shapes)}")

    def __len__(self) -> int:
        return len(self.time)

    def __getstate__(self) -> dict[str, object]:
        """Return the state for pickling, without functions."""
        return {name: value for name, value in self.__dict__.items() if name != "_filters"}

    @property
    def pieces(self) -> list[slice]:
        """Return the samples of each piece; a piece of the whole motion may have no samples in a part of it."""
        return [slice(*ends) for ends in zip(self.starts, [*self.starts[1:], len(self)], strict=True)]

    def by_piece(self, law: Callable[[Array, Array], Array], values: Array) -> Array:
        """Return law(time, values) of each piece, joined; values (n,) or (n, k)."""
        return np.concatenate([law(self.time[piece], values[piece]) for piece in self.pieces])

    def slope(self, values: Array) -> Array:
        """Return the time derivative of values (n,), per second, by central differences."""
        return self.by_piece(lambda time, own: np.gradient(own, time) if len(own) > 1 else np.zeros(len(own)), values)

    @cached_property
    def step(self) -> float:
        """The usual time between two samples, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def passes(self) -> int:
        """Return how often the joint crossed a quarter of its range, for the quarter that it crossed most often."""
        least, span = float(self.dtheta.min()), float(np.ptp(self.dtheta))
        middles = least + span * _EIGHTH * np.arange(1.0, 1.0 / _EIGHTH)
        through = [centred[np.abs(centred) > _EIGHTH * span] for centred in self.dtheta - middles[:, None]]
        return max(int(np.count_nonzero(np.diff(np.sign(one)))) for one in through)

    @property
    def repeats(self) -> bool:
        """Return whether the motion repeats often enough to separate changes with time from changes with direction."""
        return self.passes >= _AGAIN

    @property
    def has_one_frequency(self) -> bool:
        """Return whether deflection and rate determine the acceleration, as in a single sine."""
        coupling = np.stack([self.dtheta, self.dtheta_dot, np.ones(len(self))], axis=1)
        left = self.dtheta_ddot - coupling @ np.linalg.lstsq(coupling, self.dtheta_ddot, rcond=None)[0]
        return float(np.var(left)) * _APART <= float(np.var(self.dtheta_ddot))

    @property
    def whole(self) -> tuple[Motion, Index | slice]:
        """Return the whole motion that contains this motion, and the rows of this motion in the whole one."""
        return (self, slice(None)) if self.part_of is None else self.part_of

    def of(self, rows: Mask | Index | slice) -> Motion:
        """Return the motion at the samples `rows`; delays and lags remain as exact as in the whole."""
        chosen = np.arange(len(self))[rows]
        whole, places = self.whole
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in ("time", *_PARTS)},
            starts=tuple(np.searchsorted(chosen, self.starts).tolist()),
            part_of=(whole, np.arange(len(whole))[places][rows]),
        )

    def alone(self, rows: Index | slice, starts: Iterable[int] = ()) -> Motion:
        """Return a new motion of the samples `rows` (n,) only. starts: samples of it at which further pieces begin."""
        parts = {name: getattr(self, name)[rows] for name in ("time", *_PARTS)}
        begin = {0, *starts, *np.searchsorted(np.arange(len(self))[rows], self.starts).tolist()}
        starts = tuple(sorted(start for start in begin if start < len(parts["time"])))
        return replace(self, **parts, starts=starts, part_of=None)

    def coarser(self, fewest: int) -> tuple[Motion, Index]:
        """Return `fewest` or more samples of the motion, as a part of a coarser whole motion, and their indices (k,).

        Effects that depend on earlier samples cost a step for each sample of the whole motion. To find a starting
        point, the samples that interpolation needs are enough.
        """
        whole, places = self.whole
        rows = np.arange(len(whole))[places]
        every = max(1, min(whole._longest_stride, len(rows) // fewest))
        kept = np.arange(rows[0] % every, len(whole), every)
        starts = np.searchsorted(kept, whole.starts)
        chosen = np.flatnonzero((rows - kept[0]) % every == 0)
        if every == 1 or len(chosen) < fewest or np.diff([*starts, len(kept)]).min() < _FEWEST:
            return self, np.arange(len(self))
        behind = whole.behind.of_every(every) if whole.behind else None
        coarse = replace(whole.alone(kept), behind=behind)
        return coarse.of(rows[chosen] // every), chosen

    @cached_property
    def _longest_stride(self) -> int:
        """Return how many times further apart the samples may be and still be dense enough to interpolate."""
        fastest = float(np.sqrt(np.mean(self.dtheta_ddot**2) / max(float(np.mean(self.dtheta_dot**2)), _TINY)))
        longest = min(_DENSE / max(fastest, _TINY), self.behind.longest_step if self.behind else np.inf)
        return max(1, int(min(longest / self.step, len(self))))

    def at(self, time: Array) -> Motion:
        """Return the motion interpolated at times (m,), s, rising; times between pieces, or alone in one, are left out.

        The result is a part of a whole motion as dense as this one, so its delays and lags are as exact.
        """
        inside = [time[(time >= self.time[piece][0]) & (time <= self.time[piece][-1])] for piece in self.pieces]
        inside = [part if len(part) > 1 else part[:0] for part in inside]  # no curve leads through one
        grids = [_subdivided(part, self.step) for part in inside]
        lengths = [len(grid) for grid, _ in grids if len(grid)]
        if not lengths:
            return self.of(np.empty(0, dtype=np.intp))
        parts = [curve(grid) for (grid, _), curve in zip(grids, self._curves, strict=True) if len(grid)]
        whole = replace(
            self,
            time=np.concatenate([grid for grid, _ in grids]),
            starts=tuple(np.cumsum([0, *lengths[:-1]]).tolist()),
            part_of=None,
            **dict(zip(_PARTS, np.concatenate(parts, axis=1), strict=True)),
        )
        return whole.of(np.concatenate([asked for _, asked in grids]))

    def shifted(self, reference: float) -> Motion:
        """Return the motion with deflections relative to `reference`, rad."""
        moved = replace(self, dtheta=self.dtheta - reference, part_of=None)
        return (
            moved
            if self.part_of is None
            else replace(moved, part_of=(self.part_of[0].shifted(reference), self.part_of[1]))
        )

    def delayed(self, delay: float) -> Motion:
        """Return the motion `delay` seconds before each time; before the start of a piece it is extrapolated."""
        return self._evaluated(delay, self._curves) if delay else self

    def changing(self, delay: float) -> Motion:
        """Return the time derivative of each array of the motion, per second, `delay` seconds before each time."""
        return self._evaluated(delay, self._changes)

    def lagged(self, values: Array, constant: float) -> Array:
        """Return values (n,) or (n, k) behind a first-order lag of `constant`, s, settled at the start of each piece.

        Exact for values that are cubic between two times, with slopes from central differences.
        """
        from ga.model import memory

        if constant <= 0.0:
            return values
        return self.by_piece(lambda time, own: memory.lagged(time, own, constant), values)

    def averaged(self, values: Array, width: float) -> Array:
        """Return the means (n,) or (n, k) over `width` s around each time, shorter at the ends.

        values (m,) or (m, k): of the whole motion.
        """
        from ga.model import memory

        whole, rows = self.whole
        places = np.arange(len(whole))[rows]
        if width <= 0.0:
            return values[places]
        parts = []
        for piece in whole.pieces:
            own = places[np.searchsorted(places, piece.start) : np.searchsorted(places, piece.stop)] - piece.start
            parts.append(memory.averaged(whole.time[piece], values[piece], width, own))
        return np.concatenate(parts)

    def filtered(self, values: Array) -> Array:
        """Return values (n,) or (k, n) after the filter that the torque went through."""
        parts = zip(self.pieces, self._filters, strict=True)
        return np.concatenate([through(values[..., piece]) for piece, through in parts], axis=-1)

    def presliding(self, length: float) -> Array:
        """Return Dahl's (1976) friction state (n,), -1 to 1, which builds up over `length`, rad, after a reversal."""
        from ga.model import memory

        return self._frictional(memory.presliding, length)

    def bristles(self, length: float, rise: float, over: float) -> Array:
        """Return LuGre's friction (n,), 1 at speed and 1 + rise at rest.

        length: the deflection over which the friction builds up, rad. over: the rate over which it falls, rad/s.
        """
        from ga.model import memory

        return self._frictional(memory.bristles, length, rise, over)

    def yielding(self, length: float) -> Array:
        """Return the friction state of Bouc and Wen (n,), -1 to 1, which builds up over `length`, rad."""
        from ga.model import memory

        return self._frictional(memory.yielding, length)

    def _frictional(self, law: Callable[..., Array], *own: float) -> Array:
        return np.concatenate([law(time, rate, *own)[rows] for time, rate, rows in self._turning])

    def fading(self, passed: Array, constant: float) -> Array:
        """Return the weight (n,), 1 to 0, that the state at the start of its piece still has at each sample.

        passed (n,): the time or the distance since the start. constant: the time or distance after which the weight is
        1/e; 0: the weight lasts one sample.
        """
        if not constant > 0.0:
            whole, rows = self.whole
            return np.isin(np.arange(len(whole)), whole.starts)[rows].astype(np.float64)
        left = np.zeros(len(passed))
        near = passed < FORGOTTEN * constant
        left[near] = np.exp(-passed[near] / constant)
        return left

    @cached_property
    def elapsed(self) -> Array:
        """Return the time (n,), s, since the start of the piece that each sample is in."""
        whole, rows = self.whole
        return np.asarray(self.time - whole.time[np.asarray(whole.starts)[whole.stretch[rows]]])

    @cached_property
    def travelled(self) -> Array:
        """Return the distance (n,), rad, travelled since the start of the piece, both directions together."""
        if self.part_of is not None:
            return self.part_of[0].travelled[self.part_of[1]]
        moved = (np.diff(time) * 0.5 * np.abs(rate[:-1] + rate[1:]) for time, rate, _ in self._turning)
        ways = (np.concatenate([[0.0], np.cumsum(way)]) for way in moved)
        return np.concatenate([way[rows] for way, (_, _, rows) in zip(ways, self._turning, strict=True)])

    @cached_property
    def stretch(self) -> Index:
        """Return the number (n,) of the piece of the whole motion that each sample is in."""
        if self.part_of is not None:
            return self.part_of[0].stretch[self.part_of[1]]
        return np.asarray(np.searchsorted(self.starts, np.arange(len(self)), side="right") - 1)

    def _evaluated(self, delay: float, curves: tuple[Spline, ...]) -> Motion:
        parts = zip(self.pieces, curves, strict=True)
        found = np.concatenate([curve(self.time[piece] - delay) for piece, curve in parts], axis=1)
        return replace(self, part_of=None, **dict(zip(_PARTS, found, strict=True)))

    @cached_property
    def _turning(self) -> tuple[tuple[Array, Array, Index], ...]:
        """Return each piece's times, s, and rates, rad/s, with a sample at each reversal, and the original samples."""
        from ga.model.memory import with_turns

        return tuple(with_turns(self.time[piece], self.dtheta_dot[piece]) for piece in self.pieces)

    @cached_property
    def _filters(self) -> tuple[Callable[[Array], Array], ...]:
        """Return for each piece a function that passes values (n,) of the piece through the filter `behind`."""
        return tuple(self.behind.passing(self.time[one]) if self.behind else np.asarray for one in self.pieces)

    @cached_property
    def _curves(self) -> tuple[Spline, ...]:
        """Return splines through the four arrays of each piece; nearly exact if samples are dense."""
        from ga.model.spline import Spline

        if self.part_of is not None:
            return self.part_of[0]._curves
        values = np.stack([getattr(self, name) for name in _PARTS])
        return tuple(Spline.through(self.time[piece], values[:, piece]) for piece in self.pieces)

    @cached_property
    def _changes(self) -> tuple[Spline, ...]:
        return tuple(curve.changing() for curve in self._curves) if self.part_of is None else self.part_of[0]._changes


def joined(motions: Sequence[Motion]) -> Motion:
    """Return the motions concatenated; each begins a new piece."""
    noises = [motion.rate_noise for motion in motions if motion.rate_noise is not None]
    firsts = np.cumsum([0, *(len(motion) for motion in motions[:-1])])
    starts = tuple(int(first) + start for first, motion in zip(firsts, motions, strict=True) for start in motion.starts)
    time, dtheta, rate, acceleration, known = (
        np.concatenate([getattr(motion, name) for motion in motions]) for name in ("time", *_PARTS)
    )
    return Motion(
        time,
        dtheta,
        rate,
        acceleration,
        known,
        starts=starts,
        rate_noise=max(noises) if len(noises) == len(motions) else None,
        part_of=_joined_wholes(motions) if any(motion.part_of for motion in motions) else None,
        behind=next((motion.behind for motion in motions if motion.behind), None),
    )


def _joined_wholes(motions: Sequence[Motion]) -> tuple[Motion, Index]:
    wholes = [motion.whole for motion in motions]
    firsts = np.cumsum([0, *(len(whole) for whole, _ in wholes[:-1])])
    places = [first + np.arange(len(whole))[rows] for first, (whole, rows) in zip(firsts, wholes, strict=True)]
    return joined([whole for whole, _ in wholes]), np.concatenate(places)


def _subdivided(time: Array, step: float) -> tuple[Array, Mask]:
    """Return times (n,), s, at most about `step` apart, that include the given times, and which of them were given."""
    if len(time) < 2:
        return time, np.ones(len(time), dtype=bool)
    parts = np.maximum(np.round(np.diff(time) / step), 1.0).astype(np.int64)
    ends = np.concatenate([[0], np.cumsum(parts)])
    asked = np.zeros(ends[-1] + 1, dtype=bool)
    asked[ends] = True
    return np.interp(np.arange(ends[-1] + 1), ends, time), asked
