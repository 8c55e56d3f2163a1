"""From recordings to Kc and Bc: signals, model, genetic search, exact optimum, and what may be believed of them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ga.bounds import PAPER_BOUNDS, Bounds, bounds_from_data
from ga.evolution.evolution import Settings
from ga.lad.exact import Optimum
from ga.lad.out_of_core import Blocks, Reduced, reduce
from ga.model.separable import Problem, descend, fit
from ga.model.terms import Parameter
from ga.trials.checkpoint import WrongCheckpoint
from ga.trials.nonlinear import search_shapes
from ga.trials.trials import Trials, run_trials
from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.identification.dataset import Dataset, Table, open_dataset, table
from hil.identification.disk_table import Progress
from hil.identification.identifiability import Evidence, estimates, judge, rivals
from hil.identification.model_choice import Choice, Coupling, choose
from hil.identification.result import Holdout, Identification
from hil.identification.same_stand import check_together
from hil.signals.prepare import Signals
from hil.uncertainty.confidence import spread
from hil.uncertainty.pooling import scatter
from hil.uncertainty.stationarity import unsteady

Array = NDArray[np.float64]

_FOLDS = 10  # blocks in time; every fifth is held out
_TRIALS, _SHAPE_TRIALS = 30, 5  # the paper's; a search for a skew or gap takes half a second
_UNMOVED = ("few-counts", "poor-snr")  # errors of a recording in which nothing moved
_COUNTED = 1 << 18  # samples looked at a time


@dataclass(frozen=True, slots=True)
class Search:
    """How to search. bounds: the parameters whose range was given, SI.

    trials: independent searches; None: as many as the paper's 30 where that is a matter of milliseconds, else fewer.
    checkpoint: a file that keeps the state of the search, which goes on from it where it is there already.
    """

    preset: str
    settings: Settings
    trials: int | None
    seed: int
    workers: int
    bounds: Mapping[str, tuple[float, float]]
    checkpoint: Path | None = None


@dataclass(frozen=True, slots=True)
class _Found:
    """What the search and the exact solution came to.

    values: (p + q,), of the exact solution. low and high: (p + q,), the bounds of the parameters that were searched,
    NaN for the others. columns: (m, p + q), of the signals. blocks: the linear problem that the neighbourhood of the
    solution looks like.
    """

    values: Array
    optimum: Optimum
    low: Array
    high: Array
    trials: Trials
    seconds: float
    columns: Array
    blocks: Table


def identify(
    paths: list[Path], model: Coupling | None, search: Search, progress: Progress | None = None
) -> Identification:
    """Fit a model, None: the one the ladder chooses, to the recordings, pooled.

    Ctrl-C while it searches ends the search only: what came of it is returned, with the trials marked as interrupted.
    Raises WrongUse, and Untrustworthy where the recordings cannot be used at all; what is doubtful but usable is in
    the diagnostics.
    """
    began = time.perf_counter()
    together = check_together(paths)

    def chosen(signals: Signals, whole: bool) -> Choice:
        if progress is not None and model is None:
            progress("choosing the model", 0.0)
        return choose(model, signals, straight=not whole or search.preset == "paper")

    with open_dataset(paths, chosen, progress) as data:
        found = (_curved if data.choice.model.shape else _straight)(data, search, progress)
        parameters = (*data.choice.model.linear, *data.choice.model.shape)
        scales = np.array([parameter.scales for parameter in parameters])
        within = spread(lambda: found.blocks(None), found.values)
        apart, scattered = scatter(found.blocks, data.edges, within)
        errors = apart.carrying(data.uncertainty, found.values, scales)
        fitness = float(found.trials.fitness.min())
        holdout = _hold_out(data, found)
        evidence = Evidence(
            model=data.choice.model,
            signals=data.signals,
            columns=found.columns,
            values=found.values,
            errors=errors,
            scattered=scattered,
            trials=found.trials,
            low=found.low,
            high=found.high,
            gap=found.optimum.relative_gap(fitness),
            holdout=holdout,
            unmoved=next((one.message for one in data.diagnostics if one.is_error and one.code in _UNMOVED), ""),
        )
        judged = estimates(evidence)
        return Identification(
            recordings=tuple(paths),
            model=data.choice.model,
            rungs=data.choice.rungs,
            preset=search.preset,
            seed=search.seed,
            estimates=judged,
            fitness=fitness,
            optimum=found.optimum.fitness,
            relative_gap=evidence.gap,
            samples=data.samples,
            trials=found.trials,
            seconds=time.perf_counter() - began,
            search_seconds=found.seconds,
            holdout=holdout,
            diagnostics=tuple(
                together
                + data.diagnostics
                + _of_parts(data, found, parameters)
                + judge(evidence)
                + rivals(data.choice.rungs, judged)
            ),
            signals=data.signals,
        )


def _of_parts(data: Dataset, found: _Found, parameters: tuple[Parameter, ...]) -> list[Diagnostic]:
    """What parts of the recordings say against the whole; a recording that does not fit in memory is not gone through
    once more for it.
    """
    names = _names(parameters)
    return unsteady(found.blocks, data.edges, names.index("Kc")) if data.whole and "Kc" in names else []


def _straight(data: Dataset, search: Search, progress: Progress | None) -> _Found:
    """A model that is linear in its parameters: all of them are searched."""
    model = data.choice.model
    columns, torque = next(iter(data.blocks(None))) if data.whole else _glimpsed(data)
    bounds = _bounds(model, search, columns, torque)
    reduced = _exact(lambda: data.blocks(None), data.samples)
    began = time.perf_counter()
    trials = _search(data, reduced, bounds, search, progress)
    seconds = time.perf_counter() - began
    optimum = reduced.optimum
    return _Found(optimum.genes, optimum, bounds.low, bounds.high, trials, seconds, columns, data.blocks)


def _glimpsed(data: Dataset) -> tuple[Array, Array]:
    model, motion = data.choice.model, data.signals.motion
    return model.columns(motion)[data.told], model.target(motion, data.signals.torque)[data.told]


def _curved(data: Dataset, search: Search, progress: Progress | None) -> _Found:
    """A model with a shape: that is searched, and the linear parameters are solved for exactly inside."""
    model, motion = data.choice.model, data.signals.motion
    if search.checkpoint is not None:
        names = ", ".join(_names(model.shape))
        raise WrongUse(f"--checkpoint: the search for {names} takes seconds and is not kept: leave the option out")
    unbounded, p = np.full(len(model.linear), np.nan), len(model.linear)
    low, high = (np.concatenate([unbounded, ends]) for ends in model.bounds(motion, data.signals.band[1]))
    low, high = _narrowed(low, high, search, _names((*model.linear, *model.shape)), model.name)
    _check_population(search, len(model.shape))
    problem = Problem(model, motion, data.signals.torque, low[p:], high[p:]).of(data.told)
    began = time.perf_counter()
    trials = search_shapes(
        problem,
        search.settings,
        trials=search.trials or _SHAPE_TRIALS,
        seed=search.seed,
        workers=search.workers,
        progress=None if progress is None else partial(progress, "searching"),
    )
    seconds = time.perf_counter() - began
    try:
        # a user's own model has no valleys that are known beforehand: where its best trial ended is its bottom
        exact = problem.solve(trials.best[p:]) if model.linear else descend(problem, trials.best)
        if model.linear:
            exact = min(exact, fit(problem), key=lambda found: found.fitness)
    except RuntimeError as error:
        raise Untrustworthy(f"no exact optimum could be proven ({error}): leave a term out of --model") from error
    columns, target = problem.linearised(exact)
    return _Found(
        values=exact.values,
        optimum=exact.optimum,
        low=low,
        high=high,
        trials=trials,
        seconds=seconds,
        columns=columns,
        blocks=table(columns, target),
    )


def _exact(blocks: Blocks, samples: int) -> Reduced:
    try:
        return reduce(blocks, samples)
    except RuntimeError as error:
        raise Untrustworthy(f"no exact optimum could be proven ({error}): leave a term out of --model") from error


def _search(data: Dataset, reduced: Reduced, bounds: Bounds, search: Search, progress: Progress | None) -> Trials:
    """The trials on the data, or on what stands for them where they do not fit in memory; fitness in N m of the whole.

    Raises WrongUse for a population that is too small, or a checkpoint that is of another search or cannot be written.
    """
    _check_population(search, len(bounds.low))
    columns, torque = next(iter(data.blocks(None))) if data.whole else (reduced.columns, reduced.torque)
    try:
        trials = run_trials(
            columns,
            torque,
            bounds,
            search.settings,
            trials=search.trials or _TRIALS,
            seed=search.seed,
            workers=search.workers,
            start=None if data.whole else reduced.start,
            progress=None if progress is None else partial(progress, "searching"),
            stop=lambda: False,  # with one, Ctrl-C keeps what was found
            checkpoint=search.checkpoint,
        )
    except WrongCheckpoint as error:
        raise WrongUse(f"--checkpoint: {error}") from None
    except OSError as error:
        raise WrongUse(f"--checkpoint {search.checkpoint}: {error.strerror}: name another file") from error
    return trials if data.whole else trials.scaled(reduced.share)


def _bounds(model: Coupling, search: Search, columns: Array, torque: Array) -> Bounds:
    """The box to search: given ranges first, then the paper's for its preset, then the data's own."""
    found = bounds_from_data(columns, torque)
    low, high = found.low.copy(), found.high.copy()
    if search.preset == "paper":
        low[:2], high[:2] = PAPER_BOUNDS.low, PAPER_BOUNDS.high
    names = _names(model.linear)
    return Bounds(*_narrowed(low, high, search, names, model.name), names)


def _narrowed(low: Array, high: Array, search: Search, names: tuple[str, ...], model: str) -> tuple[Array, Array]:
    """The bounds (p,) with the ranges that were given. Raises WrongUse for an unknown one, or one that is none."""
    low, high = low.copy(), high.copy()
    for name, (lowest, highest) in search.bounds.items():
        if name not in names:
            raise WrongUse(f"--bounds {name}: model {model!r} has no such parameter; it has {', '.join(names)}")
        if not (np.isfinite(lowest) and np.isfinite(highest) and lowest < highest):
            raise WrongUse(f"--bounds {name}={lowest:g}:{highest:g}: write the lower one first, both as numbers in SI")
        low[names.index(name)], high[names.index(name)] = lowest, highest
    return low, high


def _check_population(search: Search, count: int) -> None:
    try:
        search.settings.population_for(count)
    except ValueError as error:
        raise WrongUse(f"--population: {error}") from None


def _names(parameters: tuple[Parameter, ...]) -> tuple[str, ...]:
    return tuple(parameter.name for parameter in parameters)


def _hold_out(data: Dataset, found: _Found) -> Holdout:
    def is_out(number: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray(number * _FOLDS // data.samples % 5 == 2)

    def is_in(number: NDArray[np.int64]) -> NDArray[np.bool_]:
        return ~is_out(number)

    firsts = range(0, data.samples, _COUNTED)  # the numbers of all samples at once would not fit in memory either
    kept = sum(int(is_in(np.arange(at, min(at + _COUNTED, data.samples))).sum()) for at in firsts)
    genes = _exact(lambda: found.blocks(is_in), kept).optimum.genes
    count, absolute, square, total, power = 0, 0.0, 0.0, 0.0, 0.0
    for columns, torque in found.blocks(is_out):
        left = torque - columns @ genes
        count += len(torque)
        absolute += float(np.abs(left).sum())
        square += float(left @ left)
        total += float(torque.sum())
        power += float(torque @ torque)
    variance = power / count - (total / count) ** 2
    return Holdout(absolute / count, float(np.sqrt(square / count / variance)) if variance > 0.0 else np.nan)
