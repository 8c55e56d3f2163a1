"""The functions that identify Kc and Bc from recordings and compare recordings, and the classes of their results."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ga.evolution.evolution import PRESETS, READINGS, Settings
from ga.model.coupling import parse
from hil.api.arrays import recorded
from hil.api.recordings import LoadedRecording
from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse, unknown
from hil.identification import compare as comparison
from hil.identification import user_model
from hil.identification.compare import Comparison, Repeated
from hil.identification.each import Task, identified
from hil.identification.each import identify_each as identify_spread
from hil.identification.fitting.solution import Search
from hil.identification.model_choice import Coupling
from hil.identification.result import Estimate, Identification
from hil.report import comparison as comparison_report
from hil.report import identification as identification_report
from hil.report import identification_json, identification_page
from hil.report.html_page import table_lines, table_rows
from hil.report.pictures import canvas, files, result
from hil.report.pictures.traces import modelled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.uncertainty.dynamic_stiffness import DynamicStiffness

AnyPath = str | os.PathLike[str]
Recordings = AnyPath | LoadedRecording | Sequence[AnyPath | LoadedRecording]
Progress = Callable[[str, float], None]
"""A callback: it gets the name of the phase of the work and the completed fraction, 0 to 1."""


@dataclass(frozen=True, slots=True)
class IdentificationResult:
    """The result of `identify`: Kc, Bc and the other parameters of the model.

    `str(result)` is the answer in one line, `result["Kc"]` is one parameter. identification: all numbers and signals of
    the result.
    """

    identification: Identification

    def __getitem__(self, name: str) -> Estimate:
        try:
            return self.parameters[name]
        except KeyError:
            raise KeyError(f"no parameter {name!r}; the model has {', '.join(self.parameters)}") from None

    def __str__(self) -> str:
        return identification_report.headline(self.identification)

    def __repr__(self) -> str:
        return f"<{self}; {self.model}>"

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """The parameters by name, each with its value, unit and 95 % interval, SI."""
        return MappingProxyType({estimate.name: estimate for estimate in self.identification.estimates})

    @property
    def model(self) -> str:
        """The name of the model: its terms joined with +."""
        return self.identification.model.name

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """The warnings and errors about the result, each with a remedy."""
        return self.identification.diagnostics

    @property
    def trustworthy(self) -> bool:
        """Return whether the diagnostics contain no error."""
        return self.identification.trustworthy

    def trusted(self, name: str) -> bool:
        """Return whether a parameter, "Kc" or "Bc", may be trusted: the data identifies it, and no error is about
        it.
        """
        return self.identification.trusted(name)

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C ended the search early; then the result is the best that the search had reached."""
        return self.identification.trials.interrupted

    @property
    def dynamic_stiffness(self) -> DynamicStiffness | None:
        """Stiffness and damping over frequency, estimated without a model; None if the recording is too short."""
        return self.identification.dynamic_stiffness

    @property
    def predicted(self) -> NDArray[np.float64]:
        """The model's torque at the joint (n,), N m, for each row that was used."""
        return modelled(self.identification)

    @property
    def residuals(self) -> NDArray[np.float64]:
        """Measured torque minus the model's torque (n,), N m, for each row that was used."""
        return np.asarray(self.identification.signals.torque - self.predicted)

    def summary(self) -> str:
        """Return the answer, the table of the parameters, the warnings and the quality of the fit as text."""
        lines = identification_report.identification_lines(self.identification)
        return "\n".join([str(self), *table_lines(self._rows()), *(f"{one}" for one in self.diagnostics), *lines])

    def _repr_html_(self) -> str:
        """Return the answer and the table of the parameters for a notebook."""
        rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self._rows())
        table = "".join(f"<tr>{row}</tr>" for row in rows)
        said = "".join(f"<p>{escape(str(one))}</p>" for one in self.diagnostics)
        return f"<p><b>{escape(str(self))}</b></p><table>{table}</table>{said}"

    def _rows(self) -> list[list[str]]:
        return table_rows(identification_report.estimates_table(self.identification))

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil identify --json`."""
        return identification_json.as_json(self.identification)

    def plot(self) -> Figure:
        """Return a figure: measured and modelled torque, residuals, the torque-deflection loop and the diagnostic
        checks.
        """
        return result.figure(self.identification)

    def report(self, path: AnyPath, command: str = "", *, force: bool = True) -> Path:
        """Write the HTML report to `path` and return the path. Raises WrongUse.

        command: the command or script that made the result, printed in the report. force: replace an existing file.
        """
        return identification_page.write_page(self.identification, Path(path), command, force=force)

    def save_plots(self, folder: AnyPath, *, force: bool = False) -> list[Path]:
        """Write every picture of the report as a PNG into a folder, and return their paths. Raises WrongUse."""
        return files.write_pictures(result.pictures(self.identification), Path(folder), force=force)


class NoResult(Untrustworthy):
    """The error for recordings from which nothing could be identified; the message says why."""

    def __init__(self, reason: str, recordings: Sequence[Path], model: str, preset: str, seed: int) -> None:
        super().__init__(reason)
        self.recordings, self.model, self.preset, self.seed = tuple(recordings), model, preset, seed

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil identify --json` for a failure: every value is null."""
        return identification_json.unusable_json(self.recordings, self.model, self.preset, self.seed, str(self))

    def report(self, path: AnyPath, command: str = "", *, force: bool = True) -> Path:
        """Write an HTML report that says why there is no result, and return its path. Raises WrongUse.

        command: the command or script that was run. force: replace an existing file.
        """
        return identification_page.write_failure(
            str(self), self.recordings, self.as_json(), Path(path), command, force=force
        )


@dataclass(frozen=True, slots=True)
class ComparisonResult:
    """The result of `compare`: Kc and Bc of several recordings. `str(result)` is the answer in one line.

    comparison: all numbers of the result.
    """

    comparison: Comparison

    def __getitem__(self, name: str) -> Repeated:
        return next(parameter for parameter in self.comparison.parameters if parameter.name == name)

    def __str__(self) -> str:
        return "\n".join(parameter.verdict for parameter in self.comparison.parameters)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """The warnings and errors about the comparison, each with a remedy."""
        return self.comparison.diagnostics

    @property
    def trustworthy(self) -> bool:
        """Return whether the diagnostics contain no error."""
        return self.comparison.trustworthy

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil compare --json`."""
        return comparison_report.as_json(self.comparison)

    def plot(self) -> Figure:
        """Return a figure: each parameter over the recordings with its interval, and the interval of all recordings
        together.
        """
        return canvas.drawn(comparison_report.chart(self.comparison))

    def report(self, path: AnyPath, command: str = "", *, force: bool = True) -> Path:
        """Write the HTML report to `path` and return the path. Raises WrongUse.

        command: the command or script that made the result, printed in the report. force: replace an existing file.
        """
        return comparison_report.write_page(self.comparison, Path(path), command, force=force)


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
    [task] = _tasks([_given(recordings, arrays, stand)], model, search, fixture)
    return _result(task, identified(task, progress))


def identify_each(
    recordings: Sequence[AnyPath],
    model: str | Coupling | None = None,
    *,
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
    tasks = _tasks([[path] for path in _paths(recordings)], model, search, fixture)
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
    recordings: Sequence[Sequence[Path]], model: str | Coupling | None, search: Search, fixture: AnyPath | None
) -> list[Task]:
    # bounds and checkpoints belong to one model, and a fixture is subtracted from apparent stiffness and damping
    fixed = search.preset == "paper" or bool(search.bounds) or search.checkpoint is not None or fixture is not None
    chosen = coupling_of(model or ("linear" if fixed else "auto"))
    rig = None if fixture is None else Path(fixture)
    return [Task(tuple(paths), chosen, search, rig) for paths in recordings]


def _result(task: Task, found: Identification | Untrustworthy) -> IdentificationResult:
    if isinstance(found, Untrustworthy):
        raise _no_result(task, found) from found
    return IdentificationResult(found)


def _no_result(task: Task, reason: Untrustworthy) -> NoResult:
    name = "auto" if task.model is None else task.model.name
    return NoResult(str(reason), task.recordings, name, task.search.preset, task.search.seed)


def compare(
    *recordings: Recordings,
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
    paths = [path for one in recordings for path in _paths(one)]
    return ComparisonResult(comparison.compare(paths, coupling_of(model), search, progress))


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


def _given(recordings: Recordings | None, arrays: Mapping[str, ArrayLike | None], stand: AnyPath | None) -> list[Path]:
    """Return the paths of the recordings, or that of a recording of the arrays. Raises WrongUse for both or neither."""
    has_arrays = any(values is not None for values in arrays.values())
    if (recordings is not None) == has_arrays:
        raise WrongUse("give either recordings, or the arrays time=, torque= and dtheta=")
    if recordings is None:
        return [recorded(arrays, None if stand is None else Path(stand))]
    if stand is not None:
        raise WrongUse("stand= belongs to arrays: a recording holds the data of its stand already")
    return _paths(recordings)


def _paths(recordings: Recordings) -> list[Path]:
    several = [recordings] if isinstance(recordings, str | os.PathLike | LoadedRecording) else recordings
    return [one.path if isinstance(one, LoadedRecording) else Path(one) for one in several]


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
