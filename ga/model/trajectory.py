"""The motion of the joint on one time base, from which a coupling model computes its columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from scipy.interpolate import CubicSpline

    Array = NDArray[np.float64]


_PARTS: Final = ("dtheta", "dtheta_dot", "dtheta_ddot", "known")


@dataclass(frozen=True, eq=False)
class Motion:
    """Arrays of one length (n,): time s, dtheta rad, dtheta_dot rad/s, dtheta_ddot rad/s^2, known N m.

    known: the part of the measured torque that is not the coupling's and needs no parameter, such as the motor's own
    inertia in equation (1). starts: where a new stretch begins, 0 first: a stretch is of one recording and gapless,
    and nothing is interpolated from one to the next. rate_noise: rad/s, what of the rate is noise; None: unknown.
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

    def __post_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in ("time", *_PARTS)}
        if shapes != {(self.time.size,)}:
            raise ValueError(f"the parts of a motion differ in shape: {sorted(shapes)}")

    def __len__(self) -> int:
        return len(self.time)

    @property
    def whole(self) -> tuple[Motion, NDArray[np.int64] | slice]:
        """The motion that this one is a part of, or itself, and its rows in that."""
        return (self, slice(None)) if self.part_of is None else self.part_of

    def of(self, rows: NDArray[np.bool_] | slice) -> Motion:
        """Some of the samples, to be delayed and lagged as exactly as if all were there."""
        chosen = np.arange(len(self))[rows]
        whole, places = self.whole
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in ("time", *_PARTS)},
            starts=tuple(np.searchsorted(chosen, self.starts).tolist()),
            part_of=(whole, np.arange(len(whole))[places][rows]),
        )

    def delayed(self, delay: float) -> Motion:
        """The motion as it was `delay` seconds before each time; before a stretch began, as its ends continue."""
        if delay == 0.0:
            return self
        return self._evaluated(delay, 0)

    def changing(self, delay: float) -> Motion:
        """How fast each part changes, per second, at `delay` seconds before each time."""
        return self._evaluated(delay, 1)

    def lagged(self, values: Array, constant: float) -> Array:
        """Values (n,) or (n, k) of each time, behind a first-order lag of `constant` s that has settled at each start.

        Exact for values that are cubic between two times, with the slopes that central differences give them.
        """
        from ga.model import memory

        if constant <= 0.0:
            return values
        parts = [memory.lagged(self.time[a:b], values[a:b], constant) for a, b in self._stretches()]
        return np.concatenate(parts)

    def presliding(self, length: float) -> Array:
        """The friction of Dahl (1976), (n,) -1 to 1, that builds up over `length` rad after a reversal."""
        from ga.model import memory

        return self._frictional(memory.presliding, length)

    def yielding(self, length: float) -> Array:
        """The friction of Bouc and Wen, (n,) -1 to 1, that builds up over `length` rad."""
        from ga.model import memory

        return self._frictional(memory.yielding, length)

    def _frictional(self, law: Callable[[Array, Array, float], Array], length: float) -> Array:
        return np.concatenate([law(self.time[a:b], self.dtheta_dot[a:b], length) for a, b in self._stretches()])

    def fading(self, clock: Array, constant: float) -> Array:
        """What is left (n,), 1 to 0, of the state at the beginning of each stretch, as a clock (n,) goes on.

        constant: in the clock's unit, after which 1/e is left; 0: one sample.
        """
        firsts = np.asarray(self.starts)[self.stretch]
        elapsed = clock - clock[firsts]
        left = np.exp(-elapsed / constant) if constant > 0.0 else np.arange(len(self)) == firsts
        return np.asarray(left, dtype=np.float64)

    def travelled(self) -> Array:
        """The way (n,) rad of the joint since the first sample, back and forth."""
        moved = np.diff(self.time) * 0.5 * np.abs(self.dtheta_dot[:-1] + self.dtheta_dot[1:])
        return np.concatenate([[0.0], np.cumsum(moved)])

    @property
    def stretch(self) -> NDArray[np.int64]:
        """The number (n,) of the stretch that each sample is in."""
        return np.asarray(np.searchsorted(self.starts, np.arange(len(self)), side="right") - 1)

    def _evaluated(self, delay: float, order: int) -> Motion:
        found = [
            curve(self.time[start:stop] - delay, order)
            for (start, stop), curve in zip(self._stretches(), self._curves, strict=True)
        ]
        parts = np.concatenate(found).T.copy()
        return replace(self, part_of=None, **dict(zip(_PARTS, parts, strict=True)))

    def _stretches(self) -> list[tuple[int, int]]:
        return list(zip(self.starts, [*self.starts[1:], len(self)], strict=True))

    @cached_property
    def _curves(self) -> tuple[CubicSpline, ...]:
        """Through the four parts of each stretch: as good as exact where samples are much denser than the motion."""
        from scipy.interpolate import CubicSpline

        if self.part_of is not None:
            return self.part_of[0]._curves
        values = np.stack([getattr(self, name) for name in _PARTS], axis=1)
        return tuple(CubicSpline(self.time[start:stop], values[start:stop]) for start, stop in self._stretches())
