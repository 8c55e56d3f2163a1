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

from ga.lad.exact import Optimum, least_absolute_deviations
from ga.samples import resolution

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from ga.model.terms import Parameter
    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

FEW: Final = 600
ENOUGH: Final = 2500
"""Rows on which a valley is told from another, and those on which its bottom is looked for before all are taken."""

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
_CONVERGED: Final = 1e-7
"""Part of the fitness that a step gains, and of the bounds' width that it is long, at which a descent has arrived."""

_FIRST: Final = 8e-3
_FINE: Final = 1e-3
_LAST: Final = 1e-5
"""The steps of a compass, from and to, as parts of the bounds' width; from the middle one on they shrink faster."""


class Curved(Protocol):
    """What can be fitted: `ga.model.terms.Model`, or a user's own."""

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

    def solve(self, shape: Array, near: Fit | None = None, agreements: int = _AGREEMENTS) -> Fit:
        """The exact minimum for one shape (q,). Raises RuntimeError where no optimum can be proven.

        near: the fit of a shape close by, to begin with. When flanks let go depends on Bc/Kc, which the minimum gives:
        both are repeated until they agree, `agreements` times at most.
        """
        target, lag = self.model.target(self.motion, self.torque, shape), near.lag if near else 0.0
        if not self.model.linear:
            return Fit(shape, Optimum(np.empty(0), float(np.mean(np.abs(target))), 0.0, True, resolution(self.torque)))
        genes = near.optimum.genes if near else None
        best = Fit(shape, least_absolute_deviations(self.model.columns(self.motion, shape, lag), target, genes), lag)
        for _ in range(agreements if self.model.lets_go else 0):
            genes = best.optimum.genes
            next_lag = max(0.0, genes[1] / genes[0]) if genes[0] > 0.0 else 0.0
            if abs(next_lag - lag) <= _AGREED * lag:
                break
            lag = next_lag
            columns = self.model.columns(self.motion, shape, lag)
            best = Fit(shape, least_absolute_deviations(columns, target, genes), lag)
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
    return settled(problem, valley(problem.thinned(), near).shape)


def settled(problem: Problem, start: Array) -> Fit:
    """The bottom of the valley that the shape `start` (q,) lies in. Raises RuntimeError as `Problem.solve`."""
    return by_compass(problem, descend(problem, start)) if start.size else problem.solve(start)


def valley(problem: Problem, near: Mapping[str, float] = MappingProxyType({})) -> Fit:
    """Where the best of a few shapes in the bounds leads to; those that are near known begin where they are."""
    tried = []
    names = [parameter.name for parameter in problem.model.shape]
    for name, low, high in zip(names, problem.low, problem.high, strict=True):
        parts = np.array(_GRID.get(name, _ANYWHERE))
        tried.append(np.array([near[name]]) if name in near else low + (high - low) * parts)
    thin, best = problem.thinned(FEW), None
    for chosen in product(*tried):
        found = attempted(thin, np.array(chosen), best)
        if found is not None and (best is None or found.fitness < best.fitness):
            best = found
    if best is None:
        raise RuntimeError("for no shape were the columns different enough")
    return descend(problem, best.shape)


def attempted(problem: Problem, shape: Array, near: Fit | None) -> Fit | None:
    """The minimum for one shape (q,), as good as telling a valley takes; None where the columns are too much alike.

    Flanks let go as `near` says, where it is given.
    """
    try:
        return problem.solve(shape, near, agreements=0 if near else _AGREEMENTS)
    except RuntimeError:
        return None


def descend(problem: Problem, start: Array) -> Fit:
    """The bottom of the valley that the shape `start` (q,) lies in, within the bounds."""
    best = problem.solve(np.clip(start, problem.low, problem.high))
    count = problem.low.size
    for _ in range(_STEPS if count else 0):
        try:
            step = least_absolute_deviations(*problem.linearised(best), best.values).genes[-count:] - best.shape
        except RuntimeError:  # the shape does what the columns do already: no way down can be told
            break
        arrived = bool(np.all(np.abs(step) <= _CONVERGED * (problem.high - problem.low)))
        better = None if arrived else _shortened(problem, best, step)
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
        tried = problem.solve(shape, best)
        if tried.fitness < best.fitness:
            return tried
    return None


def by_compass(problem: Problem, best: Fit) -> Fit:
    """The bottom nearby, where gap or slack make it rough: both ways along each, with ever smaller steps."""
    steps, length = _rough(problem), _FIRST
    while len(steps) and length > _LAST:
        shapes = [best.shape + sign * length * step for step in steps for sign in (1.0, -1.0)]
        tried = [problem.solve(np.clip(shape, problem.low, problem.high), best) for shape in shapes]
        found = min(tried, key=lambda fit: fit.fitness)
        if found.fitness < best.fitness:
            best = found
        else:
            length *= 0.5 if length > _FINE else 0.25
    return best


def _rough(problem: Problem) -> Array:
    """The directions (k, q) in which the fitness is rough, each as long as the bounds are wide.

    Where a gap begins and where it ends are felt apart from each other: it is these that are moved.
    """
    names = [parameter.name for parameter in problem.model.shape]
    if not {"Fc", *_KINKED} & {*names, *(parameter.name for parameter in problem.model.linear)}:
        return np.empty((0, len(names)))
    steps = dict(zip(names, np.diag(problem.high - problem.low), strict=True))
    if {"gap", "centre"} <= set(names):
        half = 0.5 * steps["gap"][names.index("gap")] * (np.arange(len(names)) == names.index("centre"))
        steps["gap"], steps["centre"] = steps["gap"] + half, steps["gap"] - half
    return np.array([step for name, step in steps.items() if name in {*_KINKED, "skew"}]).reshape(-1, len(names))
