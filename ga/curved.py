"""Fits of models that are not linear in all their parameters: the shape is searched, the rest is solved exactly inside.

For a given shape (skew, gap, slack) the fitness is a least-absolute-deviations problem, and its exact minimum is the
fitness of the shape. `search` looks everywhere in the bounds with the genetic algorithm; `descend` goes from any point
to the bottom of the valley it lies in (Gauss-Newton with the exact solver as its step; Osborne and Watson 1971).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from ga.dense import resolution
from ga.exact import Optimum, least_absolute_deviations

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from ga.models import Parameter
    from ga.motion import Motion

    Array = NDArray[np.float64]

ENOUGH: Final = 2500
"""Rows on which a valley is told from another; the bottom is then found on all of them."""

_GRID: Final[Mapping[str, tuple[float, ...]]] = MappingProxyType(
    {
        "skew": (0.25, 0.5, 0.75),
        "gap": (0.0, 0.03, 0.1, 0.25, 0.5),
        "centre": (0.3, 0.5, 0.7),
        "slack": (0.05, 0.2, 0.4, 0.6, 0.8),
    }
)
"""Parts of the way from the low to the high bound from which a valley is looked for."""

_ANYWHERE: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
"""The same for a shape parameter of a user's own model."""

_KINKED: Final = ("gap", "centre", "slack")
"""Where these end the torque jumps: the bottom of the valley is too rough to be found by its slope. So it is for a
skew where friction turns with the motion."""

_AGREEMENTS: Final = 8
_AGREED: Final = 1e-3
"""How often, at most, and to what part the lag of flanks is found again from the fit that it led to."""

_STEPS: Final = 20
_HALVINGS: Final = 4
_CONVERGED: Final = 1e-9
_FIRST: Final = 4e-3
_LAST: Final = 1e-6
"""The steps of a compass, from and to, as parts of the bounds' width."""


class Curved(Protocol):
    """What can be fitted: `ga.models.Model`, or a user's own."""

    @property
    def linear(self) -> tuple[Parameter, ...]: ...  # noqa: D102
    @property
    def shape(self) -> tuple[Parameter, ...]: ...  # noqa: D102
    @property
    def lets_go(self) -> bool: ...  # noqa: D102
    def columns(self, motion: Motion, shape: Array | None = None, lag: float = 0.0) -> Array: ...  # noqa: D102
    def target(self, motion: Motion, torque: Array, shape: Array | None = None) -> Array: ...  # noqa: D102
    def slopes(self, motion: Motion, shape: Array, genes: Array, lag: float = 0.0) -> Array: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Fit:
    """The bottom of a valley. shape: (q,); optimum: of the columns for that shape and lag, its genes (p,).

    lag: s, Bc/Kc of these genes where the model has flanks that let go, else 0.
    """

    shape: Array
    optimum: Optimum
    lag: float = 0.0

    @property
    def fitness(self) -> float:
        """The mean absolute error, N m."""
        return self.optimum.fitness

    @property
    def values(self) -> Array:
        """All parameters, (p + q,): genes, then shape."""
        return np.concatenate([self.optimum.genes, self.shape])


@dataclass(frozen=True, eq=False)
class Problem:
    """A model on a recording: motion (n,), torque (n,) N m; low and high (q,): the bounds of the shape."""

    model: Curved
    motion: Motion
    torque: Array
    low: Array
    high: Array

    def solve(self, shape: Array) -> Fit:
        """The exact minimum for one shape (q,). Raises RuntimeError where no optimum can be proven.

        When flanks let go depends on Bc/Kc, which the minimum gives: both are repeated until they agree.
        """
        target, lag = self.model.target(self.motion, self.torque, shape), 0.0
        if not self.model.linear:
            return Fit(shape, Optimum(np.empty(0), float(np.mean(np.abs(target))), 0.0, True, resolution(self.torque)))
        best = Fit(shape, least_absolute_deviations(self.model.columns(self.motion, shape), target))
        for _ in range(_AGREEMENTS if self.model.lets_go else 0):
            kc, bc = best.optimum.genes[:2]
            next_lag = max(0.0, bc / kc) if kc > 0.0 else 0.0
            if abs(next_lag - lag) <= _AGREED * lag:
                break
            lag = next_lag
            best = Fit(shape, least_absolute_deviations(self.model.columns(self.motion, shape, lag), target), lag)
        return best

    def of(self, rows: NDArray[np.bool_] | slice) -> Problem:
        """The same on some of the rows."""
        return replace(self, motion=self.motion.of(rows), torque=self.torque[rows])

    def thinned(self, rows: int = ENOUGH) -> Problem:
        """The same on about as many rows, evenly taken."""
        return self.of(slice(None, None, max(1, len(self.torque) // rows)))

    def residuals(self, fit: Fit) -> Array:
        """What the fit leaves, (n,) N m."""
        target = self.model.target(self.motion, self.torque, fit.shape)
        return np.asarray(target - self.model.columns(self.motion, fit.shape, fit.lag) @ fit.optimum.genes)

    def linearised(self, fit: Fit) -> tuple[Array, Array]:
        """Columns (n, p + q) and torque (n,) of the linear problem that the fit's neighbourhood looks like.

        Its residuals at `fit.values` are those of the fit.
        """
        columns = self.model.columns(self.motion, fit.shape, fit.lag)
        slopes = self.model.slopes(self.motion, fit.shape, fit.optimum.genes, fit.lag)
        target = self.model.target(self.motion, self.torque, fit.shape) + slopes @ fit.shape
        return np.concatenate([columns, slopes], axis=1), target


def fit(problem: Problem, near: Mapping[str, float] = MappingProxyType({})) -> Fit:
    """The bottom of the best valley; near: where some shape parameters are, by name, where that is known.

    Raises RuntimeError as `Problem.solve`.
    """
    if not problem.low.size:
        return problem.solve(problem.low)
    return by_compass(problem, descend(problem, valley(problem.thinned(), near).shape))


def valley(problem: Problem, near: Mapping[str, float] = MappingProxyType({})) -> Fit:
    """Where the best of a few shapes in the bounds leads to; those that are near known begin where they are."""
    tried = []
    names = [parameter.name for parameter in problem.model.shape]
    for name, low, high in zip(names, problem.low, problem.high, strict=True):
        parts = np.array(_GRID.get(name, _ANYWHERE))
        tried.append(np.array([near[name]]) if name in near else low + (high - low) * parts)
    best = min((problem.solve(np.array(shape)) for shape in product(*tried)), key=lambda found: found.fitness)
    return descend(problem, best.shape)


def descend(problem: Problem, start: Array) -> Fit:
    """The bottom of the valley that the shape `start` (q,) lies in, within the bounds."""
    best = problem.solve(np.clip(start, problem.low, problem.high))
    count = problem.low.size
    for _ in range(_STEPS if count else 0):
        try:
            step = least_absolute_deviations(*problem.linearised(best)).genes[-count:] - best.shape
        except RuntimeError:  # the shape does what the columns do already: no way down can be told
            break
        better = _shortened(problem, best, step)
        if better is None:
            break
        gained = best.fitness - better.fitness
        best = better
        if gained <= _CONVERGED * best.fitness:
            break
    return best


def _shortened(problem: Problem, best: Fit, step: Array) -> Fit | None:
    """The first of ever shorter steps that leads downhill."""
    for halving in range(_HALVINGS):
        shape = np.clip(best.shape + step * 0.5**halving, problem.low, problem.high)
        if np.array_equal(shape, best.shape):
            return None
        tried = problem.solve(shape)
        if tried.fitness < best.fitness:
            return tried
    return None


def by_compass(problem: Problem, best: Fit) -> Fit:
    """The bottom nearby, where gap or slack make it rough: both ways along each, with ever smaller steps."""
    width = problem.high - problem.low
    jumps = {parameter.name for parameter in (*problem.model.linear, *problem.model.shape)} & {"Fc", *_KINKED}
    rough = [k for k, parameter in enumerate(problem.model.shape) if parameter.name in {*_KINKED, "skew"} and jumps]
    length = _FIRST
    while rough and length > _LAST:
        shapes = [best.shape + sign * length * width * (np.arange(len(width)) == k) for k in rough for sign in (1, -1)]
        tried = [problem.solve(np.clip(shape, problem.low, problem.high)) for shape in shapes]
        found = min(tried, key=lambda fit: fit.fitness)
        if found.fitness < best.fitness:
            best = found
        else:
            length *= 0.25
    return best
