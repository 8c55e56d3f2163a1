"""The motion of the joint on one time base, from which a coupling model computes its columns."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from ga.model.memory import Beginnings
    from ga.model.spline import Spline

    Array = NDArray[np.float64]

K = TypeVar("K")
V = TypeVar("V")


class Filter(Protocol):
    """What readings went through, each as every other.

    longest_step: s between two samples, up to which it is possible. of_every: the filter of every so many samples.
    """

    @property
    def longest_step(self) -> float: ...  # noqa: D102

    def of_every(self, every: int) -> Filter: ...  # noqa: D102

    def passing(self, time: Array) -> Callable[[Array], Array]: ...  # noqa: D102


FORGOTTEN: Final = 30.0
"""Times its constant, after which nothing is left of a state to all digits that matter."""

_APART: Final = 300.0
"""Variance of the acceleration over what deflection and rate leave of it, from which the motion is one sine."""

_TINY: Final = 1e-300

_AGAIN: Final = 4
"""Passes, below which what seems to change in time may as well differ between the directions."""

_UNSURE: Final = 0.005
_UNLIKE: Final = 8.0
"""Part of the r.m.s. value, and times the usual difference or the noise, up to which two windows give one slope."""

_DENSE: Final = 0.25
"""Of the time in which the rate changes by itself, up to which samples are close enough to interpolate between."""

_FEWEST: Final = 50
"""Samples that each stretch keeps in a coarser motion."""

_MOST_KEPT: Final = 2
"""Delays, and models with their parameters, of which what was computed is kept."""

_PARTS: Final = ("dtheta", "dtheta_dot", "dtheta_ddot", "known")


@dataclass(frozen=True, eq=False)
class Motion:
    """Arrays of one length (n,): time s, dtheta rad, dtheta_dot rad/s, dtheta_ddot rad/s^2, known N m.

    known: the part of the measured torque that is not the coupling's and needs no parameter, such as the motor's own
    inertia in equation (1). starts: where a new stretch begins, 0 first: a stretch is of one recording and gapless,
    and nothing is interpolated from one to the next. rate_noise: rad/s, what of the rate is noise; None: unknown.
    behind: what the torque went through, as all parts of the motion; None: nothing.
    part_of: the motion that this one is some rows of, and these; None: it is whole.
    Raises ValueError where the lengths differ.
    """

    time: Array
    dtheta: Array
    dtheta_dot: Array
    dtheta_ddot: Array
    known: Array
    starts: tuple[int, ...] = (0,)
    rate_noise: float | None = None
    part_of: tuple[Motion, NDArray[np.int64]] | None = None
    behind: Filter | None = None
    _late: dict[float, Motion] = field(default_factory=dict, init=False, repr=False)
    _begun: dict[tuple[str, bytes], Beginnings] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in ("time", *_PARTS)}
        if shapes != {(self.time.size,)}:
            raise ValueError(f"the parts of a motion differ in shape: {sorted(shapes)}")

    def __len__(self) -> int:
        return len(self.time)

    def __getstate__(self) -> dict[str, object]:
        """Return what goes to another process: functions cannot, so that the filters are made anew there."""
        return {name: value for name, value in self.__dict__.items() if name != "_filters"}

    @property
    def passes(self) -> int:
        """How often the joint crossed a quarter of its range, up or down: the quarter that it crossed most often."""
        import numpy as np

        least, span = float(self.dtheta.min()), float(np.ptp(self.dtheta))
        middles = least + span * np.arange(0.125, 0.9, 0.125)
        through = [centred[np.abs(centred) > 0.125 * span] for centred in self.dtheta - middles[:, None]]
        return max(int(np.count_nonzero(np.diff(np.sign(one)))) for one in through)

    @property
    def repeats(self) -> bool:
        """Whether it passes its range so often that what changes in time differs from what changes with direction."""
        return self.passes >= _AGAIN

    @property
    def has_one_frequency(self) -> bool:
        """Whether its acceleration follows from deflection and rate, as that of one sine does."""
        coupling = np.stack([self.dtheta, self.dtheta_dot, np.ones(len(self))], axis=1)
        left = self.dtheta_ddot - coupling @ np.linalg.lstsq(coupling, self.dtheta_ddot, rcond=None)[0]
        return float(np.var(left)) * _APART <= float(np.var(self.dtheta_ddot))

    @property
    def whole(self) -> tuple[Motion, NDArray[np.int64] | slice]:
        """The motion that this one is a part of, or itself, and its rows in that."""
        return (self, slice(None)) if self.part_of is None else self.part_of

    def of(self, rows: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Motion:
        """Some of the samples, to be delayed and lagged as exactly as if all were there."""
        chosen = np.arange(len(self))[rows]
        whole, places = self.whole
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in ("time", *_PARTS)},
            starts=tuple(np.searchsorted(chosen, self.starts).tolist()),
            part_of=(whole, np.arange(len(whole))[places][rows]),
        )

    def coarser(self, fewest: int) -> tuple[Motion, NDArray[np.int64]]:
        """Return some of the samples, `fewest` or more, in a whole motion with fewer between them; and which (k,).

        What the motion remembers costs a step for each sample of the whole. To find a place to descend from, as many as
        interpolation needs are enough.
        """
        whole, places = self.whole
        rows = np.arange(len(whole))[places]
        every = max(1, min(whole._longest_stride, len(rows) // fewest))
        kept = np.arange(rows[0] % every, len(whole), every)
        starts = np.searchsorted(kept, whole.starts)
        chosen = np.flatnonzero((rows - kept[0]) % every == 0)
        if every == 1 or len(chosen) < fewest or np.diff([*starts, len(kept)]).min() < _FEWEST:
            return self, np.arange(len(self))
        parts = {name: getattr(whole, name)[kept] for name in ("time", *_PARTS)}
        behind = whole.behind.of_every(every) if whole.behind else None
        coarse = replace(whole, **parts, starts=tuple(starts.tolist()), behind=behind)
        return coarse.of(rows[chosen] // every), chosen

    @cached_property
    def _longest_stride(self) -> int:
        """How many times as far apart the samples may be, and still be close enough to interpolate between."""
        fastest = float(np.sqrt(np.mean(self.dtheta_ddot**2) / max(float(np.mean(self.dtheta_dot**2)), _TINY)))
        longest = min(_DENSE / max(fastest, _TINY), self.behind.longest_step if self.behind else np.inf)
        return max(1, int(min(longest / float(np.median(np.diff(self.time))), len(self))))

    def at(self, time: Array) -> Motion:
        """The motion interpolated at other times (m,), s, rising, without those between two stretches or alone in one.

        It is some of the samples of a whole motion as dense as this one, so that it is delayed and lagged as exactly.
        """
        inside = [time[(time >= self.time[a]) & (time <= self.time[b - 1])] for a, b in self._stretches()]
        inside = [part if len(part) > 1 else part[:0] for part in inside]  # no curve leads through one
        step = float(np.median(np.diff(self.time)))
        grids = [_subdivided(part, step) for part in inside]
        lengths = [len(grid) for grid, _ in grids if len(grid)]
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
        """The motion with deflections from `reference`, rad."""
        moved = replace(self, dtheta=self.dtheta - reference, part_of=None)
        return (
            moved
            if self.part_of is None
            else replace(moved, part_of=(self.part_of[0].shifted(reference), self.part_of[1]))
        )

    def delayed(self, delay: float) -> Motion:
        """The motion as it was `delay` seconds before each time; before a stretch began, as its ends continue.

        The last ones are kept: a descent needs columns, torque and their changes at one delay after the other.
        """
        if delay == 0.0:
            return self
        return _kept(self._late, delay, lambda: self._evaluated(delay, self._curves))

    def begun(self, key: tuple[str, bytes], left: Callable[[], Array]) -> Beginnings:
        """Return what the states at the beginning of each stretch can make: `ga.model.memory.beginnings`.

        left: (k, n), as there. key: the model and its parameters, because columns and torque need the same.
        """
        from ga.model.memory import beginnings

        return _kept(self._begun, key, lambda: beginnings(left(), self.stretch))

    def changing(self, delay: float) -> Motion:
        """Return the derivative of each part, per second, `delay` seconds before each time."""
        return self._evaluated(delay, self._changes)

    def lagged(self, values: Array, constant: float) -> Array:
        """Values (n,) or (n, k) of each time, behind a first-order lag of `constant` s that has settled at each start.

        Exact for values that are cubic between two times, with the slopes that central differences give them.
        """
        from ga.model import memory

        if constant <= 0.0:
            return values
        parts = [memory.lagged(self.time[a:b], values[a:b], constant) for a, b in self._stretches()]
        return np.concatenate(parts)

    def averaged(self, values: Array, width: float) -> Array:
        """The means (n,) or (n, k) over `width` s, half before each time and half after; less at the ends.

        values (m,) or (m, k): of the whole motion.
        """
        from ga.model import memory

        whole, rows = self.whole
        places = np.arange(len(whole))[rows]
        if width <= 0.0:
            return values[places]
        parts = []
        for first, end in whole._stretches():
            own = places[np.searchsorted(places, first) : np.searchsorted(places, end)] - first
            parts.append(memory.averaged(whole.time[first:end], values[first:end], width, own))
        return np.concatenate(parts)

    def filtered(self, values: Array) -> Array:
        """Values (n,) behind what the torque went through."""
        parts = zip(self._stretches(), self._filters, strict=True)
        return np.concatenate([through(values[a:b]) for (a, b), through in parts])

    def presliding(self, length: float) -> Array:
        """The friction of Dahl (1976), (n,) -1 to 1, that builds up over `length` rad after a reversal."""
        from ga.model import memory

        return self._frictional(memory.presliding, length)

    def bristles(self, length: float, rise: float, over: float) -> Array:
        """LuGre's friction (n,), 1 at speed and 1 + rise at rest, which falls over a rate, rad/s, and builds up."""
        from ga.model import memory

        return self._frictional(memory.bristles, length, rise, over)

    def yielding(self, length: float) -> Array:
        """The friction of Bouc and Wen, (n,) -1 to 1, that builds up over `length` rad."""
        from ga.model import memory

        return self._frictional(memory.yielding, length)

    def _frictional(self, law: Callable[..., Array], *own: float) -> Array:
        return np.concatenate([law(time, rate, *own)[rows] for time, rate, rows in self._turning])

    def fading(self, passed: Array, constant: float) -> Array:
        """Return the part (n,), 1 to 0, that is left of the state at the start of each stretch.

        passed (n,): the time or the way since then. constant: in its unit, after which 1/e is left; 0: one sample.
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
        """The time (n,), s, since the stretch began that each sample is in."""
        whole, rows = self.whole
        return np.asarray(self.time - whole.time[np.asarray(whole.starts)[whole.stretch[rows]]])

    @cached_property
    def travelled(self) -> Array:
        """The distance (n,), rad, that the joint travelled since its stretch began, back and forth."""
        if self.part_of is not None:
            return self.part_of[0].travelled[self.part_of[1]]
        moved = (np.diff(time) * 0.5 * np.abs(rate[:-1] + rate[1:]) for time, rate, _ in self._turning)
        ways = (np.concatenate([[0.0], np.cumsum(way)]) for way in moved)
        return np.concatenate([way[rows] for way, (_, _, rows) in zip(ways, self._turning, strict=True)])

    @cached_property
    def stretch(self) -> NDArray[np.int64]:
        """The number (n,) of the stretch of the whole motion that each sample is in."""
        if self.part_of is not None:
            return self.part_of[0].stretch[self.part_of[1]]
        return np.asarray(np.searchsorted(self.starts, np.arange(len(self)), side="right") - 1)

    def _evaluated(self, delay: float, curves: tuple[Spline, ...]) -> Motion:
        parts = zip(self._stretches(), curves, strict=True)
        found = np.concatenate([curve(self.time[start:stop] - delay) for (start, stop), curve in parts], axis=1)
        return replace(self, part_of=None, **dict(zip(_PARTS, found, strict=True)))

    def _stretches(self) -> list[tuple[int, int]]:
        return list(zip(self.starts, [*self.starts[1:], len(self)], strict=True))

    @cached_property
    def _turning(self) -> tuple[tuple[Array, Array, NDArray[np.int64]], ...]:
        """Of each stretch, times s and rates rad/s with a sample more at each turn, and which are its samples."""
        from ga.model.memory import with_turns

        return tuple(with_turns(self.time[a:b], self.dtheta_dot[a:b]) for a, b in self._stretches())

    @cached_property
    def _filters(self) -> tuple[Callable[[Array], Array], ...]:
        """The filter of the values in each stretch, as a function."""
        stretches = self._stretches()
        return tuple(self.behind.passing(self.time[a:b]) if self.behind else np.asarray for a, b in stretches)

    @cached_property
    def _curves(self) -> tuple[Spline, ...]:
        """Through the four parts of each stretch: as good as exact where samples are much denser than the motion."""
        from ga.model.spline import Spline

        if self.part_of is not None:
            return self.part_of[0]._curves
        values = np.stack([getattr(self, name) for name in _PARTS])
        return tuple(Spline.through(self.time[a:b], values[:, a:b]) for a, b in self._stretches())

    @cached_property
    def _changes(self) -> tuple[Spline, ...]:
        return tuple(curve.changing() for curve in self._curves) if self.part_of is None else self.part_of[0]._changes


def _kept(found: dict[K, V], key: K, make: Callable[[], V]) -> V:
    """Return what was made for a key, of which the last few are kept: two searches beside each other have one each."""
    value = found.get(key)
    if value is None:
        value = make()
        if len(found) >= _MOST_KEPT:
            found.clear()
        found[key] = value
    return value


def beyond_noise(apart: Array, values: Array, noise: float = 0.0) -> float:
    """Return from where on a difference says that motion is not smooth in a window, in the values' unit.

    apart (n,): by how much derivatives of the deflection in two windows differ. values (n,): the derivative in one of
    them, and noise: the standard deviation of that. What is not known is NaN.
    """
    usual = float(np.sqrt(np.nanmean(values**2)))
    return max(_UNSURE * usual, _UNLIKE * max(float(np.nanmedian(apart)), noise))


def joined(motions: Sequence[Motion]) -> Motion:
    """Return motions one after the other, each of them beginning a stretch of its own."""
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


def _joined_wholes(motions: Sequence[Motion]) -> tuple[Motion, NDArray[np.int64]]:
    wholes = [motion.whole for motion in motions]
    firsts = np.cumsum([0, *(len(whole) for whole, _ in wholes[:-1])])
    places = [first + np.arange(len(whole))[rows] for first, (whole, rows) in zip(firsts, wholes, strict=True)]
    return joined([whole for whole, _ in wholes]), np.concatenate(places)


def _subdivided(time: Array, step: float) -> tuple[Array, NDArray[np.bool_]]:
    """Times (n,), s, no more than about `step` apart, among which are those asked for; and which of them these are."""
    if len(time) < 2:
        return time, np.ones(len(time), dtype=bool)
    parts = np.maximum(np.round(np.diff(time) / step), 1.0).astype(np.int64)
    ends = np.concatenate([[0], np.cumsum(parts)])
    asked = np.zeros(ends[-1] + 1, dtype=bool)
    asked[ends] = True
    return np.interp(np.arange(ends[-1] + 1), ends, time), asked
