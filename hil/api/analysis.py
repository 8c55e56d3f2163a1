"""The functions that identify Kc and Bc from recordings and compare recordings."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from ga.evolution.evolution import PRESETS, READINGS, Settings
from ga.model.coupling import parse
from ga.model.separable import SeparableModel
from hil.api.arrays import content_of, is_frame, recorded
from hil.api.distant import identify_on
from hil.api.given import Recordings, labels, paths, several
from hil.api.results import AnyPath, ComparisonResult, IdentificationResult, NoResult
from hil.api.wording import in_python, is_on_the_command_line, worded
from hil.errors import Untrustworthy, WrongUse, unknown
from hil.identification import compare as comparison
from hil.identification import user_model
from hil.identification.each import Interrupted, Result, Task, identified
from hil.identification.each import identify_each as identify_spread
from hil.identification.fitting.solution import Search
from hil.identification.result import Identification
from hil.recording.interval import Given, between, path_of
from hil.units import with_unit

Progress = Callable[[str, float], None]
"""A callback: it gets the name of the phase of the work and the completed fraction, 0 to 1."""


@worded
def identify(
    recordings: Recordings | None = None,
    model: str | SeparableModel | None = None,
    *,
    time: ArrayLike | None = None,
    torque: ArrayLike | None = None,
    dtheta: ArrayLike | None = None,
    dtheta_dot: ArrayLike | None = None,
    command: ArrayLike | None = None,
    stand: AnyPath | None = None,
    start: Any = None,
    end: Any = None,
    preset: str = "default",
    trials: int | None = None,
    generations: int | None = None,
    population: int | None = None,
    mutation: float | None = None,
    selection: str | None = None,
    weights: str | None = None,
    replacement: str | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    workers: int | None = None,
    checkpoint: AnyPath | None = None,
    fixture: AnyPath | None = None,
    progress: Progress | None = None,
) -> IdentificationResult:
    """Find the stiffness Kc and damping Bc of the coupling from one recording, or from several recordings together.

    recordings: paths, loaded recordings, the bytes of files, or data frames of pandas or polars with columns named as
    by `to_pandas()` and units as in "torque [mN*m]". time to command: in their place, arrays (n,) in SI or as pint
    quantities: the time, the torque at the joint, the deflection, and, if known, its rate and the set-point of the
    torque. stand: the stand file of arrays or frames.
    start, end: only the rows between these times of the recording are used: numbers, s, pint quantities, or texts such
    as "2 min"; None: no bound.
    model: "auto" (model selection), terms such as "linear+offset", "FILE.py:NAME", or a model object; None: "linear" if
    preset, bounds, checkpoint or fixture is given, otherwise "auto". preset: "default" or "paper". trials: number of
    independent searches. generations to replacement: settings of the genetic algorithm; None: the preset's
    (docs/paper.md). bounds: lowest and highest value by parameter, SI; a result outside is refused. workers: number of
    threads; None: one a core. checkpoint: a file that keeps the state of the search; if it exists, the search continues
    from it. fixture: a recording of the empty rig, whose compliance is removed from the result, or the stand file into
    which `hil calibrate fixture` wrote that compliance.

    Ctrl-C returns the best result so far, once the model is chosen. Raises WrongUse, and NoResult if nothing can be
    identified from the recordings. Smaller problems are in the diagnostics.
    """
    options: dict[str, Any] = {"generations": generations, "population": population, "mutation": mutation}
    options |= {"selection": selection, "weights": weights, "replacement": replacement}
    search = _search(preset, options, trials=trials, bounds=bounds, seed=seed, workers=workers, checkpoint=checkpoint)
    arrays = {"time": time, "torque": torque, "dtheta": dtheta, "dtheta_dot": dtheta_dot, "command": command}
    recordings = None if recordings is None else several(recordings)  # of an iterator there is only one pass
    given = between(_given(recordings, arrays, stand), start, end)
    [task] = _tasks([given], model, search, fixture)
    return _result(task, _within_bounds(task, _identified(task, progress)), labels(recordings, given[0]))


def _identified(task: Task, progress: Progress | None) -> Identification | Untrustworthy:
    try:
        return identified(task, progress)
    except KeyboardInterrupt:  # of a search there would be a result
        raise KeyboardInterrupt(
            "there is no result yet, because the model was being chosen: call it again, or name a model such as "
            'model="linear", whose best result so far is returned after Ctrl-C'
        ) from None


@worded
def identify_each(
    recordings: Recordings,
    model: str | SeparableModel | None = None,
    *,
    start: Any = None,
    end: Any = None,
    preset: str = "default",
    trials: int | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    workers: int | None = None,
    executor: Executor | None = None,
    fixture: AnyPath | None = None,
    progress: Progress | None = None,
) -> list[IdentificationResult | NoResult]:
    """Identify each recording separately, several at a time, and return the results in the order of the recordings.

    workers: number of processes on this computer; None: one a core. They are started if the work takes longer than
    about 10 s. executor: any `concurrent.futures.Executor`, whose processes do the work instead (docs/campaigns.md);
    they read a path themselves, and are sent bytes and frames. The results depend on neither. The other arguments are
    those of `identify`. For a recording from which nothing can be identified, or whose process was lost, the list holds
    a NoResult; after Ctrl-C also for those that were not complete. Raises WrongUse.
    """
    search = _search(preset, {}, trials=trials, bounds=bounds, seed=seed, workers=workers, checkpoint=None)
    recordings = several(recordings)
    tasks = _tasks([[one] for one in between(paths(recordings), start, end)], model, search, fixture)
    pairs = zip(tasks, _spread(tasks, executor, progress), recordings, strict=True)
    found = [(task, _within_bounds(task, one), given) for task, one, given in pairs]
    return [
        _no_result(task, one)
        if isinstance(one, Untrustworthy)
        else IdentificationResult(one, labels(given, task.recordings[0]))
        for task, one, given in found
    ]


def _spread(tasks: Sequence[Task], executor: Executor | None, progress: Progress | None) -> list[Result]:
    try:
        if executor is None:
            return identify_spread(tasks, progress)
        return identify_on(executor, [(task, content_of(task.recordings[0])) for task in tasks], progress)
    except Interrupted as interrupted:
        if is_on_the_command_line():
            raise
        left = Untrustworthy("Ctrl-C ended the work before this recording was identified: identify it again")
        return [interrupted.results.get(at, left) for at in range(len(tasks))]


def _search(
    preset: str,
    options: dict[str, Any],
    *,
    trials: int | None,
    bounds: Mapping[str, tuple[float, float]] | None,
    seed: int,
    workers: int | None,
    checkpoint: AnyPath | None,
) -> Search:
    return Search(
        preset=preset,
        settings=_settings(preset, {name: value for name, value in options.items() if value is not None}),
        trials=trials,
        seed=seed,
        workers=workers or os.cpu_count() or 1,
        bounds=bounds or {},
        checkpoint=None if checkpoint is None else Path(checkpoint),
    )


def _tasks(
    recordings: Sequence[Sequence[Given]], model: str | SeparableModel | None, search: Search, fixture: AnyPath | None
) -> list[Task]:
    # bounds and checkpoints belong to one model, and a fixture is subtracted from apparent stiffness and damping
    fixed = search.preset == "paper" or bool(search.bounds) or search.checkpoint is not None or fixture is not None
    chosen = coupling_of(model or ("linear" if fixed else "auto"))
    rig = None if fixture is None else Path(fixture)
    return [Task(tuple(given), chosen, search, rig) for given in recordings]


def _within_bounds(task: Task, found: Identification | Untrustworthy) -> Identification | Untrustworthy:
    """Return a result, or the reason why there is none: the exact optimum of a parameter is outside the given range."""
    for one in () if isinstance(found, Untrustworthy) else found.estimates:
        low, high = task.search.bounds.get(one.name, (-math.inf, math.inf))
        if not low <= one.value <= high:
            return Untrustworthy(
                f"{one.name} would be {with_unit(f'{one.value:.4g}', one.unit)}, outside --bounds "
                f"{one.name}={low:g}:{high:g}, and no value within fits as well. Widen these bounds, or check the units"
            )
    return found


def _result(task: Task, found: Identification | Untrustworthy, labels: Any) -> IdentificationResult:
    if isinstance(found, Untrustworthy):
        raise _no_result(task, found) from found
    return IdentificationResult(found, labels)


def _no_result(task: Task, reason: Untrustworthy) -> NoResult:
    name = "auto" if task.model is None else task.model.name
    return NoResult(
        in_python(str(reason)), [path_of(one) for one in task.recordings], name, task.search.preset, task.search.seed
    )


@worded
def compare(
    *recordings: Recordings,
    start: Any = None,
    end: Any = None,
    model: str | SeparableModel = "auto",
    trials: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> ComparisonResult:
    """Identify each recording separately, and test whether Kc and Bc repeat and whether they drift.

    recordings: one after the other, or a sequence. The other arguments are those of `identify_each`. A recording from
    which nothing can be identified is left out with a warning. Raises WrongUse for fewer than two recordings, for
    recordings of different stands, and for the same run twice.
    """
    search = Search(trials=trials, seed=seed, workers=workers or os.cpu_count() or 1)
    given = between([path for one in recordings for path in paths(one)], start, end)
    return ComparisonResult(comparison.compare(given, coupling_of(model), search, progress))


def coupling_of(model: str | SeparableModel) -> SeparableModel | None:
    """Return the coupling model with the name `model`, None for model selection ("auto"). Raises WrongUse."""
    if not isinstance(model, str):
        return model
    if model == "auto":
        return None
    if ".py:" in model:
        return user_model.load(model)
    if (found := user_model.of_package(model)) is not None:
        return found
    try:
        return parse(model)
    except ValueError as error:
        raise WrongUse(f"--model {model!r}: {error}") from None


def _given(recordings: Recordings | None, arrays: Mapping[str, ArrayLike | None], stand: AnyPath | None) -> list[Given]:
    """Return the paths of the recordings, or that of a recording of the arrays. Raises WrongUse for both or neither."""
    has_arrays = any(values is not None for values in arrays.values())
    if (recordings is not None) == has_arrays:
        raise WrongUse("give either recordings, or the arrays `time`, `torque` and `dtheta`")
    if recordings is None:
        return [recorded(arrays, None if stand is None else Path(stand))]
    if stand is not None and not all(map(is_frame, several(recordings))):
        raise WrongUse("`stand` belongs to arrays: a recording holds the data of its stand already")
    return paths(recordings, stand)


def _settings(preset: str, given: dict[str, Any]) -> Settings:
    if preset not in PRESETS:
        raise unknown("--preset", preset, PRESETS)
    for name, readings in READINGS.items():
        if name in given and given[name] not in readings:
            raise unknown(f"--{name}", str(given[name]), readings, " (see docs/paper.md)")
    try:
        return replace(PRESETS[preset], **given)
    except ValueError as error:
        raise WrongUse(str(error)) from None
