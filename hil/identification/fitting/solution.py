"""Solve one model for its parameters: by the genetic search, within bounds given by the user, those of the paper, or
those derived from the data, and exactly.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from functools import partial
from pathlib import Path

import numpy as np

from ga.arrays import Array
from ga.bounds import PAPER_BOUNDS, Bounds, bounds_from_data
from ga.evolution.evolution import PRESETS, Settings
from ga.lad.exact import Optimum
from ga.lad.out_of_core import Reduced, reduce
from ga.model.record import Parameter, positive_among
from ga.model.separable import Problem, SeparableModel, descend
from ga.trials.checkpoint import WrongCheckpoint
from ga.trials.nonlinear import search_nonlinear
from ga.trials.outcome import Trials
from ga.trials.trials import duration, run_trials
from hil.errors import Untrustworthy, WrongUse, meant
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import confidence_intervals
from hil.identification.fitting.dataset import Dataset
from hil.recording.ahead import Progress
from hil.signals import constants as c

Given = Mapping[str, tuple[float, float]]
"""The user's bounds: the lowest and highest value of some parameters, SI, by name."""


@dataclass(frozen=True, slots=True)
class Search:
    """The settings of a search.

    bounds: the given ranges of parameters, SI, by name. trials: the number of independent searches; None: the paper's
    30, or 5 for a model with nonlinear parameters. checkpoint: a file that keeps the state of the search; if the file
    exists, the search continues from that state.
    """

    preset: str = "default"
    settings: Settings = PRESETS["default"]
    trials: int | None = None
    seed: int = 0
    workers: int = os.cpu_count() or 1
    bounds: Given = field(default_factory=dict)
    checkpoint: Path | None = None


@dataclass(frozen=True, slots=True)
class Solution:
    """The result of the search and of the exact solution.

    values (p + q,): the exact solution. gap: the optimiser gap, relative. low and high (p + q,): the bounds of the
    searched parameters, NaN for the others. columns (m, p + q): the linearised problem at the samples of the signals.
    blocks: the linear problem around the solution.
    """

    values: Array
    optimum: Optimum
    gap: float
    low: Array
    high: Array
    trials: Trials
    seconds: float
    columns: Array
    blocks: Blocks


def solve(data: Dataset, search: Search, progress: Progress | None) -> Solution:
    """Search the parameters of the chosen model, and compute the exact optimum.

    Raises WrongUse if the requested search is impossible, and Untrustworthy if no optimum could be proven.
    """
    return (_nonlinear if data.choice.model.nonlinear else _linear)(data, search, progress)


def _linear(data: Dataset, search: Search, progress: Progress | None) -> Solution:
    """Return the solution of a model that is linear in its parameters: all are searched."""
    columns, torque = data.in_memory
    bounds = _bounds_for(data.choice.model, search.bounds, columns, torque, papers=search.preset == "paper")
    reduced = solved(data.blocks, positive_among(data.choice.model.linear))
    began = time.perf_counter()
    trials = _search(data, reduced, bounds, search, progress)
    seconds = time.perf_counter() - began
    optimum, gap = reduced.compared(trials.best)
    return Solution(optimum.genes, optimum, gap, bounds.low, bounds.high, trials, seconds, columns, data.blocks)


def _nonlinear(data: Dataset, search: Search, progress: Progress | None) -> Solution:
    """Return the solution of a model with nonlinear parameters: these are searched, the linear parameters are computed
    exactly.
    """
    model, motion = data.choice.model, data.signals.motion
    if search.checkpoint is not None:
        names = ", ".join(parameter.name for parameter in model.nonlinear)
        raise WrongUse(f"--checkpoint: the search for {names} takes seconds and is not saved: leave the option out")
    unbounded, p = np.full(len(model.linear), np.nan), len(model.linear)
    low, high = (np.concatenate([unbounded, ends]) for ends in model.bounds(motion, data.signals.band[1]))
    parameters = (*model.linear, *model.nonlinear)
    low, high = _narrowed(low, high, search.bounds, parameters, model.name, zero=data.place.reference)
    _check_population(search, len(model.nonlinear))
    problem = Problem(model, motion, data.signals.torque, low[p:], high[p:]).of(data.used)
    began = time.perf_counter()
    trials, best = search_nonlinear(
        problem,
        search.settings,
        trials=search.trials or c.NONLINEAR_TRIALS,
        seed=search.seed,
        workers=search.workers,
        progress=None if progress is None else partial(progress, "searching"),
    )
    seconds = time.perf_counter() - began
    try:
        # the best trial is among them, so that none is ever better than the optimum it is compared with
        near = problem.solve(best.nonlinear) if model.linear else descend(problem, best.nonlinear)
        exact = min(near, best, key=lambda found: found.fitness)
    except RuntimeError as error:
        raise _unproven(error) from error
    columns, target = problem.linearised(exact)
    blocks = Blocks.of(columns, target)
    gap = exact.optimum.relative_gap(best.fitness)
    return Solution(exact.values, exact.optimum, gap, low, high, trials, seconds, columns, blocks)


def _search(data: Dataset, reduced: Reduced, bounds: Bounds, search: Search, progress: Progress | None) -> Trials:
    """Run the trials on the data, or on the reduced data if the data do not fit in memory; both have the fitness, N m,
    of all data.

    Raises WrongUse for a population that is too small, a checkpoint of another search, or a checkpoint that cannot be
    written.
    """
    _check_population(search, len(bounds.low))
    columns, torque = data.in_memory if data.whole else (reduced.columns, reduced.torque)
    trials, workers, settings = search.trials or c.TRIALS, search.workers, search.settings
    if progress is not None and settings.scheme == "steady-state" and settings.generations >= c.LONG_SEARCH:
        seconds = duration(columns, torque, bounds, settings, trials=trials, workers=workers)
        count = f"{trials * settings.generations:,} evaluations"
        progress(
            f"searching with {count}: about {timedelta(seconds=round(seconds))} h; Ctrl-C ends it and keeps its result",
            math.nan,
        )
    try:
        found = run_trials(
            columns,
            torque,
            bounds,
            settings,
            trials=trials,
            seed=search.seed,
            workers=workers,
            start=None if data.whole else reduced.start,
            progress=None if progress is None else partial(progress, "searching"),
            stop=lambda: False,  # given one, the search ends at Ctrl-C and keeps its result
            checkpoint=search.checkpoint,
        )
    except WrongCheckpoint as error:
        raise WrongUse(f"--checkpoint: {error}") from None
    except OSError as error:
        raise WrongUse(f"--checkpoint {search.checkpoint}: {error.strerror}: name another file") from error
    return found if data.whole else found.scaled(reduced.share)


def _check_population(search: Search, count: int) -> None:
    try:
        search.settings.population_for(count)
    except ValueError as error:
        raise WrongUse(f"--population: {error}") from None


def _bounds_for(model: SeparableModel, given: Given, columns: Array, torque: Array, *, papers: bool) -> Bounds:
    """Return the bounds of the linear parameters: the given ranges, else the paper's if `papers` is true, else those
    from the data.

    No bound is below zero for a parameter that cannot be negative for physical reasons. Raises WrongUse for an
    unknown parameter, an empty range, or a negative range of a parameter that cannot be negative.
    """
    found = bounds_from_data(columns, torque, positive=positive_among(model.linear))
    low, high = found.low.copy(), found.high.copy()
    if papers:
        low[:2], high[:2] = PAPER_BOUNDS.low, PAPER_BOUNDS.high
    low, high = _narrowed(low, high, given, model.linear, model.name)
    return Bounds(low, high, tuple(parameter.name for parameter in model.linear))


def _narrowed(
    low: Array, high: Array, given: Given, parameters: Sequence[Parameter], model: str, *, zero: float = 0.0
) -> tuple[Array, Array]:
    """Return the bounds (p,), narrowed to the given ranges; parameters that are deflections count from `zero`, rad.

    Raises WrongUse for an unknown parameter, an empty range, or a negative range of a parameter that cannot be
    negative.
    """
    low, high, names = low.copy(), high.copy(), [parameter.name for parameter in parameters]
    for name, (lowest, highest) in given.items():
        if name not in names:
            near = meant(name, names)
            raise WrongUse(f"--bounds {name}: model {model!r} has no such parameter; {near}it has {', '.join(names)}")
        if not (np.isfinite(lowest) and np.isfinite(highest) and lowest < highest):
            raise WrongUse(f"--bounds {name}={lowest:g}:{highest:g}: write the lower one first, both as numbers in SI")
        at = names.index(name)
        if parameters[at].positive and highest <= 0.0:
            raise WrongUse(f"--bounds {name}={lowest:g}:{highest:g}: {name} is not negative; give a range above zero")
        shift = zero if parameters[at].place else 0.0
        low[at], high[at] = max(lowest, 0.0) if parameters[at].positive else lowest - shift, highest - shift
    return low, high


def solved(blocks: Blocks, positive: tuple[int, ...] = ()) -> Reduced:
    """Return the exact optimum of the blocks. positive: the indices of the parameters that must not be negative.

    Raises Untrustworthy if no optimum could be proven.
    """
    try:
        return reduce(blocks, blocks.rows, positive)
    except RuntimeError as error:
        raise _unproven(error) from error


def without_signs(blocks: Blocks, values: Array, positive: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Return the optimum (p,) without sign constraints, and its half intervals; None if none of the values (p,) is
    zero.

    positive: the indices of the constrained parameters. Raises Untrustworthy as `solved`.
    """
    if not any(values[at] <= 0.0 for at in positive):
        return None
    found = solved(blocks).optimum.genes
    return found, confidence_intervals(blocks, found).half_width


def _unproven(error: RuntimeError) -> Untrustworthy:
    """Return the error for an optimum that could not be proven."""
    return Untrustworthy(f"no exact optimum could be proven ({error}): leave a term out of --model")
