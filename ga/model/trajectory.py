"""The motion of the joint on one time base, from which a coupling model computes its columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy.interpolate import CubicSpline

    Array = NDArray[np.float64]


_PARTS: Final = ("dtheta", "dtheta_dot", "dtheta_ddot", "known")


@dataclass(frozen=True, eq=False)
class Motion:
    """Arrays of one length (n,): time s, dtheta rad, dtheta_dot rad/s, dtheta_ddot rad/s^2, known N m.

    known: the part of the measured torque that is not the coupling's and needs no parameter, such as the motor's own
    inertia in equation (1). starts: where a new stretch begins, 0 first: a stretch is of one recording and gapless,
    and nothing is interpolated from one to the next. rate_noise: rad/s, what of the rate is noise;
    None: unknown. curves: what is interpolated on, one a stretch; None: the samples themselves.
    Raises ValueError where the lengths differ.
    """

    time: Array
    dtheta: Array
    dtheta_dot: Array
    dtheta_ddot: Array
    known: Array
    starts: tuple[int, ...] = (0,)
    rate_noise: float | None = None
    curves: tuple[CubicSpline, ...] | None = None

    def __post_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in ("time", *_PARTS)}
        if shapes != {(self.time.size,)}:
            raise ValueError(f"the parts of a motion differ in shape: {sorted(shapes)}")

    def __len__(self) -> int:
        return len(self.time)

    def of(self, rows: NDArray[np.bool_] | slice) -> Motion:
        """Some of the samples, to be delayed as exactly as if all were there."""
        chosen = np.arange(len(self))[rows]
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in ("time", *_PARTS)},
            starts=tuple(np.searchsorted(chosen, self.starts).tolist()),
            curves=self._curves,
        )

    def delayed(self, delay: float) -> Motion:
        """The motion as it was `delay` seconds before each time; before a stretch began, as its ends continue."""
        if delay == 0.0:
            return self
        return self._evaluated(delay, 0)

    def changing(self, delay: float) -> Motion:
        """How fast each part changes, per second, at `delay` seconds before each time."""
        return self._evaluated(delay, 1)

    def _evaluated(self, delay: float, order: int) -> Motion:
        found = [
            curve(self.time[start:stop] - delay, order)
            for (start, stop), curve in zip(self._stretches(), self._curves, strict=True)
        ]
        parts = np.concatenate(found).T.copy()
        return replace(self, curves=None, **dict(zip(_PARTS, parts, strict=True)))

    def _stretches(self) -> list[tuple[int, int]]:
        return list(zip(self.starts, [*self.starts[1:], len(self)], strict=True))

    @cached_property
    def _curves(self) -> tuple[CubicSpline, ...]:
        """Through the four parts of each stretch: as good as exact where samples are much denser than the motion."""
        from scipy.interpolate import CubicSpline

        if self.curves is not None:
            return self.curves
        values = np.stack([getattr(self, name) for name in _PARTS], axis=1)
        return tuple(CubicSpline(self.time[start:stop], values[start:stop]) for start, stop in self._stretches())
