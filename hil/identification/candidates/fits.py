"""Fit models to one recording by least absolute deviations: to all samples, and to held-out blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ga.arrays import Array, Index, Mask
from ga.model.coupling import CouplingModel
from ga.model.separable import ENOUGH, Fit, Problem, best_start, compass_search, descend
from ga.model.terms import TERMS, canonical, of_kind, size_of
from ga.model.trajectory import Motion
from hil.signals import constants as c
from hil.signals.rate.windows import Window, is_smooth

LATE = tuple(name for name, one in TERMS.items() if one.delays or of_kind((p.name for p in one.parameters), "lag time"))
"""The terms that delay the torque reading."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model and its fit to all samples.

    error: standard deviation of the errors of the deflection, rad.
    """

    terms: tuple[str, ...]
    model: CouplingModel
    problem: Problem
    fit: Fit
    error: float = 0.0

    @cached_property
    def held_out(self) -> Array:
        """The mean errors (c.FOLDS,), N m, of blocks in time, each from a fit without that block, at the nonlinear
        parameters of the fit to all samples.
        """
        thin = self.problem.thinned()
        block = np.arange(len(thin.torque)) * c.FOLDS // len(thin.torque)
        errors = np.empty(c.FOLDS)
        for first in range(c.FOLDS // 2):
            out = block % (c.FOLDS // 2) == first
            left = np.abs(thin.of(out).residuals(thin.of(~out).solve(self.fit.nonlinear)))
            for number in (first, first + c.FOLDS // 2):
                errors[number] = left[block[out] == number].mean()
        return errors

    @property
    def stiffness(self) -> float:
        """The stiffness Kc, N m/rad."""
        return float(self.fit.optimum.genes[0])

    @property
    def damping(self) -> float:
        """The damping Bc, N m s/rad."""
        return float(self.fit.optimum.genes[1])

    @property
    def values(self) -> dict[str, float]:
        """All parameters, SI, by name."""
        return dict(zip((one.name for one in self.model.parameters), self.fit.values.tolist(), strict=True))

    @cached_property
    def residuals(self) -> Array:
        """The residuals (n,), N m."""
        return self.problem.residuals(self.fit)

    def on(self, rows: Mask) -> Candidate:
        """Return the fit to the samples `rows` (n,) only, at the nonlinear parameters of the fit to all samples."""
        part = self.problem.of(rows)
        return replace(self, problem=part, fit=part.solve(self.fit.nonlinear, self.fit))

    @property
    def columns(self) -> Array:
        """Return the columns (n, p + q) of the problem linearised at the fit. They are computed at each call, to save
        memory.
        """
        return self.problem.linearised(self.fit)[0]

    def own_columns(self, *terms: str, together: bool = False) -> Iterator[tuple[Array, Array]]:
        """Yield for each parameter of the terms its column (n,), and the part of it orthogonal to all other columns;
        together: to the columns of all other terms.
        """
        columns, names = self.columns, np.array([parameter.name for parameter in self.model.parameters])
        mine = np.isin(names, [name for term in terms for name in own(term)])
        for at in np.flatnonzero(mine):
            others = columns[:, ~mine if together else np.arange(len(names)) != at]
            yield columns[:, at], columns[:, at] - others @ np.linalg.lstsq(others, columns[:, at], rcond=None)[0]

    def is_possible(self, *terms: str) -> bool:
        """Return whether the terms are physically possible and none of their parameters is at an end of its bounds."""
        return not any(self.is_at_end(term) or self.is_impossible(term) for term in terms)

    def is_at_end(self, term: str) -> bool:
        """Return whether a parameter of the term reached an end of its bounds: then the data reject the term."""
        problem, values = self.problem, self.fit.nonlinear
        near = c.RESOLVED * (problem.high - problem.low)
        open_ended = np.array([parameter.open_ended for parameter in self.model.nonlinear], dtype=bool)
        ends = (values <= problem.low + near) | ((values >= problem.high - near) & ~open_ended)
        return any(end and p.name in own(term) for end, p in zip(ends, self.model.nonlinear, strict=True))

    def is_impossible(self, term: str) -> bool:
        """Return whether a parameter of the term is held at zero because the data give it an impossible negative value.

        Friction, for example, cannot be negative. A skew can be, unless it only undoes a part of the lag beside it.
        """
        values = self.values
        at_zero = any(parameter.positive and values[parameter.name] <= 0.0 for parameter in TERMS[term].parameters)
        early = term in LATE and of_kind(values, "lag time") and size_of(values, "delay") < 0.0
        return at_zero or bool(early) or self.is_stop(term) or self.is_in_errors(term)

    def is_in_errors(self, term: str) -> bool:
        """Return whether the motion exceeds a gap only by as much as the errors of the outermost readings.

        If the joint rests there, a gap fits the errors of the readings at rest; that is no evidence of a gap.
        """
        opened, values, readings = TERMS[term].open, self.values, self.problem.motion.dtheta
        if opened is None:
            return False
        lowest, highest = opened(np.array([values[name] for name in own(term)]))
        errors = c.GAP_OF_NOISE * self.error
        return bool(highest - readings.min() < errors or readings.max() - lowest < errors)

    def is_stop(self, term: str) -> bool:
        """Return whether the term makes the spring many times stiffer in one direction, as a mechanical stop does."""
        if not of_kind(own(term), "side stiffness"):
            return False
        stiffness, half = self.values["Kc"], abs(size_of(self.values, "side stiffness"))
        return stiffness + half > c.STOP * (stiffness - half)


@dataclass(frozen=True, eq=False)
class Fits:
    """A recording and the models fitted to it so far; each model is fitted only once.

    motion: the motion (n,). torque (n,): N m. highest: the frequency up to which the joint moved, Hz. window: the
    window from which the rate was computed, if known.
    """

    motion: Motion
    torque: Array
    highest: float
    window: Window | None = None
    _fitted: dict[tuple[str, ...], Candidate] = field(default_factory=dict, init=False)
    _problems: dict[frozenset[str], Problem] = field(default_factory=dict, init=False)

    @cached_property
    def smooth(self) -> Mask:
        """Return the samples (n,) whose rate hardly depends on the window that it is computed with. Beside a jerk it
        does depend on it.
        """
        return is_smooth(self.motion, self.window)

    @cached_property
    def _coarser(self) -> tuple[Motion, Index]:
        """Return the motion on which a fit begins, and its samples' indices."""
        return self.motion.coarser(ENOUGH)

    def candidate(self, terms: tuple[str, ...], values: Mapping[str, float]) -> Candidate:
        """Return the model of these terms, fitted to all samples.

        values: approximate nonlinear parameters, SI, by name; others are searched on a grid. Raises RuntimeError if the
        columns are nearly collinear.
        """
        if terms not in self._fitted:
            problem = self._problem(terms)
            start = problem.low
            if len(start):
                ends = zip(problem.model.nonlinear, problem.low, problem.high, strict=True)
                inside = {p.name: float(np.clip(values[p.name], *own)) for p, *own in ends if p.name in values}
                motion, rows = self._coarser
                some = replace(problem, motion=motion, torque=self.torque[rows]).thinned()
                start = best_start(some, inside).nonlinear
            found = descend(problem, start) if len(start) else problem.solve(start)
            error = self.window.of_deflection if self.window else 0.0
            self._fitted[terms] = Candidate(terms, _model(terms), problem, found, error)
        return self._fitted[terms]

    def candidate_or_none(self, terms: tuple[str, ...], values: Mapping[str, float]) -> Candidate | None:
        """Return the model of these terms, fitted to all samples; None if the columns are nearly collinear."""
        try:
            return self.candidate(terms, values)
        except RuntimeError:
            return None

    def deeper(self, found: Candidate) -> Candidate:
        """Return a lower local minimum near a fit, if breaks give the fitness many local minima."""
        if not len(found.fit.nonlinear):
            return found
        self._fitted[found.terms] = replace(found, fit=compass_search(found.problem, found.fit))
        return self._fitted[found.terms]

    def _problem(self, terms: tuple[str, ...]) -> Problem:
        unordered = frozenset(terms)
        if unordered not in self._problems:
            model = _model(terms).anchored(self.motion)
            bounds = model.bounds(self.motion, self.highest)
            self._problems[unordered] = Problem(model, self.motion, self.torque, *bounds)
        return self._problems[unordered]


def with_flanks(model: CouplingModel, found: Fit) -> CouplingModel:
    """Return the model with flanks that part as they do in a fit: at the edge of the gap, or when they would pull."""
    return replace(model, at_edge=found.lag == 0.0) if model.chooses_edge else model


def own(term: str) -> tuple[str, ...]:
    """Return the names of a term's own parameters."""
    return tuple(parameter.name for parameter in TERMS[term].parameters)


def _model(terms: tuple[str, ...]) -> CouplingModel:
    return CouplingModel(canonical("+".join(terms)))  # on the way to a model it may lack what a term needs
