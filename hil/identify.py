"""From recordings to Kc and Bc: signals, model, genetic search, exact optimum, and what may be believed of them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ga.checkpoint import WrongCheckpoint
from ga.evolution import Settings
from ga.exact import Optimum
from ga.models import Model
from ga.space import PAPER_BOUNDS, Bounds, bounds_from_data
from ga.streaming import Blocks, Reduced, reduce
from ga.trials import Trials, run_trials
from hil.dataset import Dataset, open_dataset
from hil.errors import Untrustworthy, WrongUse
from hil.findings import Finding
from hil.intervals import Spread, spread
from hil.signals import Signals
from hil.spool import Progress

Array = NDArray[np.float64]

_CONFUSED = 30.0  # variance inflation from which two columns are said to look alike
_OPTIMISER_GAP = 1e-3  # relative gap from which the search is said not to have arrived
_FOLDS = 10  # blocks in time; every fifth is held out


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter in SI. value: of the best trial. exact: of the exact optimum. ci95: around the exact optimum."""

    name: str
    unit: str
    value: float
    exact: float
    ci95: tuple[float, float]
    trials_mean: float
    trials_std: float
    identifiable: bool
    at_bound: str | None
    bounds: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Holdout:
    """A fit to four fifths of the run, judged on the rest.

    fitness: mean |error|, N m. nrmse: RMS error over the torque's spread, NaN where it has none.
    """

    fitness: float
    nrmse: float


@dataclass(frozen=True, slots=True)
class Identification:
    """What `hil identify` found. fitness and optimum: N m. relative_gap: the search's own error, as a ratio.

    seconds: all of it; search_seconds: the trials alone.
    """

    recordings: tuple[Path, ...]
    model: Model
    preset: str
    seed: int
    estimates: tuple[Estimate, ...]
    fitness: float
    optimum: float
    relative_gap: float
    samples: int
    trials: Trials
    seconds: float
    search_seconds: float
    holdout: Holdout
    findings: tuple[Finding, ...]
    signals: Signals

    def __getitem__(self, name: str) -> Estimate:
        return next(estimate for estimate in self.estimates if estimate.name == name)

    @property
    def trustworthy(self) -> bool:
        """Whether nothing fatal was found."""
        return not any(finding.fatal for finding in self.findings)


@dataclass(frozen=True, slots=True)
class Search:
    """How to search. bounds: the parameters whose range was given, SI.

    checkpoint: a file that keeps the state of the search, which goes on from it where it is there already.
    """

    preset: str
    settings: Settings
    trials: int
    seed: int
    workers: int
    bounds: Mapping[str, tuple[float, float]]
    checkpoint: Path | None = None


def identify(paths: list[Path], model: Model, search: Search, progress: Progress | None = None) -> Identification:
    """Fit `model` to the recordings, pooled.

    Ctrl-C while it searches ends the search only: what came of it is returned, with the trials marked as interrupted.
    Raises WrongUse, and Untrustworthy where the recordings cannot be used at all; what is doubtful but usable is in
    the findings.
    """
    began = time.perf_counter()
    with open_dataset(paths, model, progress) as data:
        bounds = _bounds(model, search, data.columns, data.torque)
        reduced = _exact(data.blocks, data.samples)
        optimum = reduced.optimum
        searching = time.perf_counter()
        trials = _search(data, reduced, bounds, search, progress)
        searched = time.perf_counter()
        errors = spread(data.blocks, optimum.genes)
        estimates = _estimates(model, bounds, trials, optimum, errors)
        fitness = float(trials.fitness.min())
        gap = optimum.relative_gap(fitness)
        findings = data.findings + _interruption(trials) + _result_findings(model, estimates, data.columns, errors, gap)
        return Identification(
            recordings=tuple(paths),
            model=data.model,
            preset=search.preset,
            seed=search.seed,
            estimates=estimates,
            fitness=fitness,
            optimum=optimum.fitness,
            relative_gap=gap,
            samples=data.samples,
            trials=trials,
            seconds=time.perf_counter() - began,
            search_seconds=searched - searching,
            holdout=_hold_out(data),
            findings=tuple(findings),
            signals=data.signals,
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
    try:
        search.settings.population_for(len(bounds.low))
    except ValueError as error:
        raise WrongUse(f"--population: {error}") from None
    columns, torque = (data.columns, data.torque) if data.whole else (reduced.columns, reduced.torque)
    try:
        trials = run_trials(
            columns,
            torque,
            bounds,
            search.settings,
            trials=search.trials,
            seed=search.seed,
            workers=search.workers,
            progress=None if progress is None else partial(progress, "searching"),
            stop=lambda: False,  # with one, Ctrl-C keeps what was found
            checkpoint=search.checkpoint,
        )
    except WrongCheckpoint as error:
        raise WrongUse(f"--checkpoint: {error}") from None
    except OSError as error:
        raise WrongUse(f"--checkpoint {search.checkpoint}: {error.strerror}: name another file") from error
    return trials if data.whole else trials.scaled(reduced.share)


def _interruption(trials: Trials) -> list[Finding]:
    if not trials.interrupted:
        return []
    return [
        Finding(
            "interrupted",
            f"the search was cut short with {int(trials.finished.sum())} of {len(trials.finished)} trials at their "
            "end: the best is the best so far, mean and deviation are over all of them as they stood",
        )
    ]


def _bounds(model: Model, search: Search, columns: Array, torque: Array) -> Bounds:
    """The box to search: given ranges first, then the paper's for its preset, then the data's own."""
    found = bounds_from_data(columns, torque)
    low, high = found.low.copy(), found.high.copy()
    names = tuple(parameter.name for parameter in model.parameters)
    if search.preset == "paper":
        low[:2], high[:2] = PAPER_BOUNDS.low, PAPER_BOUNDS.high
    for name, (lowest, highest) in search.bounds.items():
        if name not in names:
            raise WrongUse(f"--bounds {name}: model {model.name!r} has no such parameter; it has {', '.join(names)}")
        if not (np.isfinite(lowest) and np.isfinite(highest) and lowest < highest):
            raise WrongUse(f"--bounds {name}={lowest:g}:{highest:g}: write the lower one first, both as numbers in SI")
        low[names.index(name)], high[names.index(name)] = lowest, highest
    return Bounds(low, high, names)


def _estimates(model: Model, bounds: Bounds, trials: Trials, optimum: Optimum, errors: Spread) -> tuple[Estimate, ...]:
    at_bound = bounds.at_bound(trials.best)
    found = []
    for index, parameter in enumerate(model.parameters):
        exact, half = float(optimum.genes[index]), float(errors.half_width[index])
        told = optimum.unique and errors.inflation[index] < _CONFUSED
        if parameter.name in {"Kc", "Bc"}:  # a coupling is known once its value stands out from its interval
            told = told and half < 0.5 * abs(exact)
        found.append(
            Estimate(
                name=parameter.name,
                unit=parameter.unit,
                value=float(trials.best[index]),
                exact=exact,
                ci95=(exact - half, exact + half),
                trials_mean=float(trials.mean[index]),
                trials_std=float(trials.std[index]),
                identifiable=bool(told),
                at_bound=at_bound[index],
                bounds=(float(bounds.low[index]), float(bounds.high[index])),
            )
        )
    return tuple(found)


def _result_findings(
    model: Model, estimates: tuple[Estimate, ...], columns: Array, errors: Spread, gap: float
) -> list[Finding]:
    found = []
    for index, estimate in enumerate(estimates):
        name = estimate.name
        if estimate.at_bound is not None:
            found.append(
                Finding(
                    "at-bound",
                    f"{name} lies at the {estimate.at_bound} end of its bounds: the answer is the bound's, not the "
                    f"data's; widen it with --bounds {name}=LOW:HIGH",
                    name,
                    fatal=name in {"Kc", "Bc"},
                )
            )
        if not estimate.identifiable:
            found.append(
                Finding(
                    "not-identifiable",
                    _why_not(model, index, columns, errors),
                    name,
                    fatal=name in {"Kc", "Bc"},
                )
            )
    # the exact optimum knows no bounds: at one, the gap is the bound's and not the search's
    if gap > _OPTIMISER_GAP and not any(estimate.at_bound for estimate in estimates):
        found.append(
            Finding("not-converged", f"the search ended {gap:.2g} above the exact optimum: give it more --generations")
        )
    return found


def _why_not(model: Model, index: int, columns: Array, errors: Spread) -> str:
    names = [parameter.name for parameter in model.parameters]
    name = names[index]
    if not columns[:, index].any():
        return f"{name} cannot be told: nothing in this recording excites it"
    if errors.inflation[index] < _CONFUSED:
        return f"{name} cannot be told: its 95 % interval is as wide as its value; excite it more (--band, --amplitude)"
    norms = np.linalg.norm(columns, axis=0)
    alike = np.abs(columns.T @ columns[:, index]) / np.where(norms > 0.0, norms, 1.0) / norms[index]
    alike[index] = 0.0
    other = names[int(np.argmax(alike))]
    return (
        f"{name} cannot be told from {other}: in this recording they look alike; drive at several speeds "
        "(--profile chirp or multisine) and over a wider band"
    )


def _hold_out(data: Dataset) -> Holdout:
    def is_out(number: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray(number * _FOLDS // data.samples % 5 == 2)

    def is_in(number: NDArray[np.int64]) -> NDArray[np.bool_]:
        return ~is_out(number)

    kept = int(np.count_nonzero(is_in(np.arange(data.samples))))
    genes = _exact(lambda: data.blocks(is_in), kept).optimum.genes
    count, absolute, square, total, power = 0, 0.0, 0.0, 0.0, 0.0
    for columns, torque in data.blocks(is_out):
        left = torque - columns @ genes
        count += len(torque)
        absolute += float(np.abs(left).sum())
        square += float(left @ left)
        total += float(torque.sum())
        power += float(torque @ torque)
    variance = power / count - (total / count) ** 2
    return Holdout(absolute / count, float(np.sqrt(square / count / variance)) if variance > 0.0 else np.nan)
