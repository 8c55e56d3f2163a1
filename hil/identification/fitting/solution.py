"""Solve one model for its parameters: by the genetic search, and exactly."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from ga.arrays import Array
from ga.bounds import Bounds
from ga.evolution.evolution import PRESETS, Settings
from ga.lad.exact import Optimum
from ga.lad.out_of_core import Reduced
from ga.model.record import positive_among
from ga.model.separable import Problem, descend
from ga.trials.checkpoint import WrongCheckpoint
from ga.trials.nonlinear import search_nonlinear
from ga.trials.outcome import Trials
from ga.trials.trials import duration, run_trials
from hil.errors import WrongUse
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.bounds import bounds_for, narrowed
from hil.identification.fitting.dataset import Dataset
from hil.identification.fitting.exact import solved, unproven
from hil.recording.ahead import Progress
from hil.signals import constants as c


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
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
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
    bounds = bounds_for(data.choice.model, search.bounds, columns, torque, papers=search.preset == "paper")
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
    low, high = narrowed(low, high, search.bounds, parameters, model.name, zero=data.place.reference)
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
        raise unproven(error) from error
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
        words = f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} minutes"
        count = f"{trials * settings.generations:,} evaluations"
        progress(f"searching with {count}: about {words}; Ctrl-C ends it and keeps its result", math.nan)
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
