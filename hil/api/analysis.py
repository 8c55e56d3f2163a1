"""The functions that identify Kc and Bc from recordings and compare recordings."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from ga.evolution.evolution import PRESETS, READINGS, Settings
from ga.model.coupling import parse
from hil.api.arrays import recorded
from hil.api.recordings import LoadedRecording
from hil.api.results import AnyPath, ComparisonResult, IdentificationResult, NoResult
from hil.api.wording import in_python, worded
from hil.errors import Untrustworthy, WrongUse, unknown
from hil.identification import compare as comparison
from hil.identification import user_model
from hil.identification.coupling import Coupling
from hil.identification.each import Task, identified
from hil.identification.each import identify_each as identify_spread
from hil.identification.fitting.solution import Search
from hil.identification.result import Identification
from hil.recording.interval import Given, Part, between, path_of

Recordings = AnyPath | LoadedRecording | Sequence[AnyPath | LoadedRecording]
Progress = Callable[[str, float], None]
"""A callback: it gets the name of the phase of the work and the completed fraction, 0 to 1."""


@worded
def identify(
    recordings: Recordings | None = None,
    model: str | Coupling | None = None,
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

    time to command: in place of recordings, arrays (n,) in SI or as pint quantities: the time, the torque at the joint,
    the deflection, and, if known, its rate and the set-point of the torque. stand: the stand file for these arrays.
    start, end: only the rows between these times of the recording are used: numbers, s, pint quantities, or texts such
    as "2 min"; None: no bound.
    model: "auto" (model selection), terms such as "linear+offset", "FILE.py:NAME", or a model object; None: "linear" if
    preset, bounds, checkpoint or fixture is given, otherwise "auto". preset: "default" or "paper". trials: number of
    independent searches. generations to replacement: settings of the genetic algorithm; None: the preset's
    (docs/paper.md). bounds: lowest and highest value by parameter, SI. workers: number of threads; None: one a core.
    checkpoint: a file that keeps the state of the search; if it exists, the search continues from it. fixture: a
    recording of the empty rig, whose compliance is removed from the result, or the stand file into which `hil calibrate
    fixture` wrote that compliance.

    Ctrl-C ends the search; the best result so far is returned. Raises WrongUse, and NoResult if nothing can be
    identified from the recordings. Smaller problems are in the diagnostics.
    """
    options: dict[str, Any] = {"generations": generations, "population": population, "mutation": mutation}
    options |= {"selection": selection, "weights": weights, "replacement": replacement}
    search = _search(preset, options, trials=trials, bounds=bounds, seed=seed, workers=workers, checkpoint=checkpoint)
    arrays = {"time": time, "torque": torque, "dtheta": dtheta, "dtheta_dot": dtheta_dot, "command": command}
    given = between(_given(recordings, arrays, stand), start, end)
    [task] = _tasks([given], model, search, fixture)
    return _result(task, identified(task, progress))


@worded
def identify_each(
    recordings: Recordings,
    model: str | Coupling | None = None,
    *,
    start: Any = None,
    end: Any = None,
    preset: str = "default",
    trials: int | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    workers: int | None = None,
    fixture: AnyPath | None = None,
    progress: Progress | None = None,
) -> list[IdentificationResult | NoResult]:
    """Identify each recording separately, several at a time, and return the results in the order of the recordings.

    workers: number of processes on this computer; None: one a core. They are started if the work takes longer than
    about 10 s. The results do not depend on `workers`. The other arguments are those of `identify`.
    For a recording from which nothing can be identified, the list holds a NoResult. Raises WrongUse.
    """
    search = _search(preset, {}, trials=trials, bounds=bounds, seed=seed, workers=workers, checkpoint=None)
    tasks = _tasks([[one] for one in between(_paths(recordings), start, end)], model, search, fixture)
    found = identify_spread(tasks, progress)
    return [
        _no_result(task, one) if isinstance(one, Untrustworthy) else IdentificationResult(one)
        for task, one in zip(tasks, found, strict=True)
    ]


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
    recordings: Sequence[Sequence[Given]], model: str | Coupling | None, search: Search, fixture: AnyPath | None
) -> list[Task]:
    # bounds and checkpoints belong to one model, and a fixture is subtracted from apparent stiffness and damping
    fixed = search.preset == "paper" or bool(search.bounds) or search.checkpoint is not None or fixture is not None
    chosen = coupling_of(model or ("linear" if fixed else "auto"))
    rig = None if fixture is None else Path(fixture)
    return [Task(tuple(given), chosen, search, rig) for given in recordings]


def _result(task: Task, found: Identification | Untrustworthy) -> IdentificationResult:
    if isinstance(found, Untrustworthy):
        raise _no_result(task, found) from found
    return IdentificationResult(found)


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
    model: str | Coupling = "auto",
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
    given = between([path for one in recordings for path in _paths(one)], start, end)
    return ComparisonResult(comparison.compare(given, coupling_of(model), search, progress))


def coupling_of(model: str | Coupling) -> Coupling | None:
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
    if stand is not None:
        raise WrongUse("`stand` belongs to arrays: a recording holds the data of its stand already")
    return _paths(recordings)


def _paths(recordings: Recordings) -> list[Given]:
    several = [recordings] if isinstance(recordings, str | os.PathLike | LoadedRecording) else recordings
    return [
        (one.path if one.window is None else Part(one.path, *one.window))
        if isinstance(one, LoadedRecording)
        else Path(one)
        for one in several
    ]


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
