"""From recordings to Kc and Bc: signals, model, genetic search, exact optimum, confidence intervals, diagnostics."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from ga.bounds import Bounds
from ga.evolution.evolution import PRESETS, Settings
from ga.lad.exact import Optimum
from ga.lad.out_of_core import Reduced
from ga.model.record import Parameter, positive_among
from ga.model.separable import Problem, descend
from ga.trials.checkpoint import WrongCheckpoint
from ga.trials.nonlinear import search_nonlinear
from ga.trials.outcome import Trials
from ga.trials.trials import run_trials
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.first_run import compiled_ahead
from hil.identification.averaging.average import averaged
from hil.identification.dataset import Dataset, open_dataset
from hil.identification.doubts.identifiability import judge
from hil.identification.doubts.misfit import misfit_diagnostics
from hil.identification.doubts.outweighed_spring import outweighed_spring
from hil.identification.evidence import Evidence, estimates, span_met, with_misfit
from hil.identification.fitting.bounds import bounds_for, narrowed
from hil.identification.fitting.deflection import (
    deflection_diagnostics,
    ignored_command,
    read_with_errors,
    summarised,
)
from hil.identification.fitting.described import Described, tested, without_model
from hil.identification.fitting.exact import solved, unproven, without_signs
from hil.identification.fitting.forecast import forecast
from hil.identification.fitting.unloaded import rest_for
from hil.identification.fitting.validation import validated
from hil.identification.model_choice import Choice, Coupling, choose
from hil.identification.result import Estimate, Identification
from hil.identification.same_stand import calibration_diagnostics, same_stand_diagnostics
from hil.identification.selection.rivals import with_rivals
from hil.identification.selection.stepwise import Step
from hil.recording.ahead import Progress
from hil.signals.prepare import Signals
from hil.signals.source import Source, open_sources
from hil.signals.windows import RATE_ACCURACY
from hil.uncertainty.blocks import Blocks
from hil.uncertainty.confidence import confidence_intervals
from hil.uncertainty.instruments import DeflectionErrors
from hil.uncertainty.stationarity import disagreement, pooled_intervals, stationarity_errors

Array = NDArray[np.float64]

_TRIALS, _NONLINEAR_TRIALS = 30, 5  # the paper's; a search for a skew or gap takes half a second
_UNMOVED = ("few-counts", "poor-snr")  # errors of a recording without usable motion


@dataclass(frozen=True, slots=True)
class Search:
    """The settings of a search. bounds: the parameters whose range was given, SI.

    trials: independent searches; None: the paper's 30, or 5 for a model with nonlinear parameters.
    checkpoint: a file that keeps the state of the search; where it exists, the search continues from it.
    """

    preset: str = "default"
    settings: Settings = PRESETS["default"]
    trials: int | None = None
    seed: int = 0
    workers: int = os.cpu_count() or 1
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    checkpoint: Path | None = None


@dataclass(frozen=True, slots=True)
class _Solution:
    """The result of the search and of the exact solution.

    values (p + q,): of the exact solution. gap: the optimiser's, relative. low and high (p + q,): the bounds of the
    parameters that were searched, NaN for the others. columns (m, p + q): of the signals. blocks: the linear problem
    around the solution.
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


def identify(
    paths: Sequence[Path], model: Coupling | None, search: Search, progress: Progress | None = None
) -> Identification:
    """Fit a model to the recordings, pooled; None: the model that model selection chooses.

    Ctrl-C during the search ends the search only: its result so far is returned, with the trials marked as interrupted.
    Raises WrongUse, and Untrustworthy where the recordings cannot be used at all; lesser doubts are in the diagnostics.
    """
    with compiled_ahead(), open_sources(paths) as sources:
        return identify_sources(sources, model, search, progress)


def identify_sources(
    sources: Sequence[Source], model: Coupling | None, search: Search, progress: Progress | None = None
) -> Identification:
    """Do what `identify` does with open recordings, on one core: on several, the last digit would be the computer's."""
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        return _identified(sources, model, search, progress)


def _identified(
    sources: Sequence[Source], model: Coupling | None, search: Search, progress: Progress | None
) -> Identification:
    began = time.perf_counter()
    stands = [*same_stand_diagnostics(sources), *calibration_diagnostics(sources)]

    def chosen(signals: Signals, whole: bool) -> Choice:
        if progress is not None and model is None:
            progress("choosing the model", 0.0)
        return choose(model, signals, linear_only=not whole or search.preset == "paper")

    with open_dataset(sources, chosen, progress, rest=rest_for(model)) as data:
        solution = (_nonlinear if data.choice.model.nonlinear else _linear)(data, search, progress)
        evidence = _evidence(data, solution)
        found = estimates(evidence)
        steps = _with_result(data.choice.steps, found, solution)
        differing = disagreement(evidence.names, evidence.scattered, [source.path for source in sources])
        described = _described(data, solution, evidence, differ=bool(differing))
        fit, dynamic = tested(described), without_model(described)
        found = with_misfit(found, fit)
        doubts: list[Diagnostic] = []
        if not any(one.code == "implausible" for one in data.diagnostics):  # a wrong sign is the cause of all others
            found, undecided = with_rivals(steps, found)
            doubts = [
                *_stationarity(data, solution),
                *differing,
                *judge(evidence),
                *undecided,
                *(deflection_diagnostics(evidence) or ignored_command(data.signals, dynamic)),
                *misfit_diagnostics(described, data.choice.model.name, fit, dynamic),
                *outweighed_spring(described, fit),
            ]
        return Identification(
            recordings=tuple(source.path for source in sources),
            model=data.choice.model,
            steps=steps,
            preset=search.preset,
            seed=search.seed,
            estimates=found,
            fitness=float(solution.trials.fitness.min()),
            optimum=solution.optimum.fitness,
            optimiser_gap=evidence.gap,
            samples=data.samples,
            trials=solution.trials,
            seconds=time.perf_counter() - began,
            search_seconds=solution.seconds,
            validation=evidence.holdout,
            diagnostics=tuple(stands + data.diagnostics + doubts),
            signals=data.signals,
            values=solution.values,
            fitted=data.used,
            torque_uncertainty=data.uncertainty,
            lack_of_fit=fit,
            dynamic_stiffness=dynamic,
            deflection=summarised(evidence),
        )


def _evidence(data: Dataset, solution: _Solution) -> Evidence:
    """The intervals, the validation and the gap, by which the result is judged."""
    parameters = (*data.choice.model.linear, *data.choice.model.nonlinear)
    sampling = confidence_intervals(solution.blocks, solution.values)
    pooled, components = pooled_intervals(solution.blocks, data.edges, sampling)
    model, used = data.choice.model, data.used
    deflection = read_with_errors(model, data.signals, used, solution.values, sampling.half_width)
    values, chosen = _averaged(data, solution, sampling.half_width, deflection)
    # the interval that is reported may be narrower than that of the selected model
    given = (_names(parameters), solution.values, np.minimum(sampling.half_width, chosen))
    span = (span_met(data.signals.motion, *given) if data.choice.steps else None) or data.place.span(
        dict(zip(given[0], solution.values.tolist(), strict=True))
    )
    if span is not None:
        values[0] += 0.5 * (span[0] + span[1]) - solution.values[0]  # Kc
        chosen[0] += 0.5 * (span[1] - span[0])
    chosen = np.hypot(chosen, deflection.half_width) if deflection else chosen
    values = np.where([one.positive for one in parameters], np.maximum(values, 0.0), values)
    exact = pooled.with_scale_uncertainty(_of_scale(data, parameters), solution.values)
    own = np.hypot(exact.half_width, deflection.half_width) if deflection else exact.half_width
    return Evidence(
        model=data.choice.model,
        signals=data.signals,
        reference=data.place.reference,
        columns=solution.columns,
        values=values,
        errors=exact.with_choice(chosen, sampling.half_width),
        exact=(solution.values, own),
        scattered=components,
        unbounded=without_signs(solution.blocks, solution.values, positive_among(parameters)),
        trials=solution.trials,
        low=solution.low,
        high=solution.high,
        gap=solution.gap,
        holdout=validated(data, solution.blocks, solution.values, np.isfinite(sampling.half_width)),
        selected=bool(data.choice.steps),
        span=span,
        deflection=deflection,
        unmoved=next((one.message for one in data.diagnostics if one.is_error and one.code in _UNMOVED), ""),
    )


def _of_scale(data: Dataset, parameters: Sequence[Parameter]) -> Array:
    """The relative uncertainty (p,) of what the parameters are proportional to: the torque, and for Bc the rate too."""
    torque = np.array([data.uncertainty if parameter.scales else 0.0 for parameter in parameters])
    rate = np.array([RATE_ACCURACY if parameter.name == "Bc" else 0.0 for parameter in parameters])
    return np.asarray(np.hypot(torque, rate))


def _averaged(
    data: Dataset, solution: _Solution, half_width: Array, deflection: DeflectionErrors | None
) -> tuple[Array, Array]:
    """The values (p + q,) and half of their intervals, Kc and Bc averaged over models where one was selected.

    All are corrected for errors of the deflection, each model on its own: a larger one suffers more from them.
    """
    half_width = half_width.copy()
    names = _names((*data.choice.model.linear, *data.choice.model.nonlinear))
    nonlinear = solution.values[len(data.choice.model.linear) :]
    change = deflection.change if deflection else np.zeros(len(names))
    values = solution.values + change
    own = dict(zip(names, change.tolist(), strict=True))
    for name, one in (averaged(data.choice, data.signals, data.used, nonlinear, own) if data.whole else {}).items():
        at = names.index(name)
        values[at], half_width[at] = one.value, one.half_width
    return values, half_width


def _described(data: Dataset, solution: _Solution, evidence: Evidence, *, differ: bool) -> Described:
    """The signals and the fit to them, to be tested; differ: whether the recordings do."""
    columns, target = next(iter(solution.blocks())) if data.choice.model.nonlinear else data.in_memory
    return Described(
        model=data.choice.model,
        signals=data.signals,
        kept=data.used,
        residuals=target - columns @ solution.values,
        columns=columns,
        values=solution.values,
        half_width=evidence.errors.half_width + np.abs(evidence.values - solution.values),
        averaged=bool(data.choice.steps),
        differing=data.edges if differ and data.whole else (),
    )


def _with_result(steps: Sequence[Step], found: Sequence[Estimate], solution: _Solution) -> tuple[Step, ...]:
    """The steps of model selection, the last included one with the values of the result.

    Model selection sees the samples before those where the joint may stick are left out, and of a recording that does
    not fit in memory only a part, so that its own values differ in the last digits.
    """
    if not steps:
        return ()
    last = max(at for at, step in enumerate(steps) if step.included)
    final = replace(steps[last], fitness=solution.optimum.fitness, Kc=found[0].exact, Bc=found[1].exact)
    return (*steps[:last], final, *steps[last + 1 :])


def _stationarity(data: Dataset, solution: _Solution) -> list[Diagnostic]:
    """The check of Kc over each recording; left out where the samples would have to be read from disk again for it."""
    names = _names((*data.choice.model.linear, *data.choice.model.nonlinear))
    return stationarity_errors(solution.blocks, data.edges, names.index("Kc")) if data.whole and "Kc" in names else []


def _linear(data: Dataset, search: Search, progress: Progress | None) -> _Solution:
    """The solution of a model that is linear in its parameters: all of them are searched."""
    columns, torque = data.in_memory
    bounds = bounds_for(data.choice.model, search.bounds, columns, torque, papers=search.preset == "paper")
    reduced = solved(data.blocks, positive_among(data.choice.model.linear))
    began = time.perf_counter()
    trials = _search(data, reduced, bounds, search, progress)
    seconds = time.perf_counter() - began
    optimum, gap = reduced.compared(trials.best)
    return _Solution(optimum.genes, optimum, gap, bounds.low, bounds.high, trials, seconds, columns, data.blocks)


def _nonlinear(data: Dataset, search: Search, progress: Progress | None) -> _Solution:
    """The solution of a model with nonlinear parameters: they are searched, and the linear ones solved for exactly."""
    model, motion = data.choice.model, data.signals.motion
    if search.checkpoint is not None:
        names = ", ".join(_names(model.nonlinear))
        raise WrongUse(f"--checkpoint: the search for {names} takes seconds and is not saved: leave the option out")
    unbounded, p = np.full(len(model.linear), np.nan), len(model.linear)
    low, high = (np.concatenate([unbounded, ends]) for ends in model.bounds(motion, data.signals.band[1]))
    low, high = narrowed(low, high, search.bounds, (*model.linear, *model.nonlinear), model.name)
    _check_population(search, len(model.nonlinear))
    problem = Problem(model, motion, data.signals.torque, low[p:], high[p:]).of(data.used)
    began = time.perf_counter()
    trials, best = search_nonlinear(
        problem,
        search.settings,
        trials=search.trials or _NONLINEAR_TRIALS,
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
    return _Solution(exact.values, exact.optimum, gap, low, high, trials, seconds, columns, blocks)


def _search(data: Dataset, reduced: Reduced, bounds: Bounds, search: Search, progress: Progress | None) -> Trials:
    """The trials on the data, or on the reduced data where they do not fit in memory; fitness in N m of the whole.

    Raises WrongUse for a population that is too small, or a checkpoint that is of another search or cannot be written.
    """
    _check_population(search, len(bounds.low))
    columns, torque = data.in_memory if data.whole else (reduced.columns, reduced.torque)
    if progress is not None and search.settings.scheme == "steady-state":
        many, workers = search.trials or _TRIALS, search.workers
        forecast(columns, torque, bounds, search.settings, trials=many, workers=workers, progress=progress)
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
            stop=lambda: False,  # given one, the search ends at Ctrl-C and keeps its result
            checkpoint=search.checkpoint,
        )
    except WrongCheckpoint as error:
        raise WrongUse(f"--checkpoint: {error}") from None
    except OSError as error:
        raise WrongUse(f"--checkpoint {search.checkpoint}: {error.strerror}: name another file") from error
    return trials if data.whole else trials.scaled(reduced.share)


def _names(parameters: tuple[Parameter, ...]) -> tuple[str, ...]:
    return tuple(parameter.name for parameter in parameters)


def _check_population(search: Search, count: int) -> None:
    try:
        search.settings.population_for(count)
    except ValueError as error:
        raise WrongUse(f"--population: {error}") from None
