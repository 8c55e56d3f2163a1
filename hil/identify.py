"""From recordings to Kc and Bc: signals, model, genetic search, exact optimum, and what may be believed of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ga.evolution import Settings
from ga.exact import Optimum, least_absolute_deviations
from ga.models import Model
from ga.space import PAPER_BOUNDS, Bounds, bounds_from_data
from ga.trials import Trials, run_trials
from hil.errors import Untrustworthy, WrongUse
from hil.findings import Finding
from hil.inspection import recording_findings
from hil.intervals import Spread, spread
from hil.signals import Signals, prepare
from hil.stand import parse
from hil.store import Recording

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
    model: str
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
    """How to search. bounds: the parameters whose range was given, SI. seconds and more are the trials' own."""

    preset: str
    settings: Settings
    trials: int
    seed: int
    workers: int
    bounds: Mapping[str, tuple[float, float]]


def identify(
    paths: list[Path], model: Model, search: Search, progress: Callable[[float], None] | None = None
) -> Identification:
    """Fit `model` to the recordings, pooled.

    progress is called with the fraction of the search that is done. Raises WrongUse, and Untrustworthy where the
    recordings cannot be used at all; what is doubtful but usable is in the findings.
    """
    began = time.perf_counter()
    signals, findings = load(paths)
    columns = model.columns(signals.time, signals.dtheta, signals.dtheta_dot)
    bounds = _bounds(model, search, columns, signals.torque)
    try:
        search.settings.population_for(len(model.parameters))
    except ValueError as error:
        raise WrongUse(f"--population: {error}") from None
    searching = time.perf_counter()
    trials = run_trials(
        columns,
        signals.torque,
        bounds,
        search.settings,
        trials=search.trials,
        seed=search.seed,
        workers=search.workers,
        progress=progress,
    )
    searched = time.perf_counter()
    optimum = _exact(columns, signals.torque)
    errors = spread(lambda: [(columns, signals.torque)], optimum.genes)
    estimates = _estimates(model, bounds, trials, optimum, errors)
    fitness = float(trials.fitness.min())
    gap = optimum.relative_gap(fitness)
    findings += _result_findings(model, estimates, columns, errors, gap)
    return Identification(
        recordings=tuple(paths),
        model=model.name,
        preset=search.preset,
        seed=search.seed,
        estimates=estimates,
        fitness=fitness,
        optimum=optimum.fitness,
        relative_gap=gap,
        samples=len(signals),
        trials=trials,
        seconds=time.perf_counter() - began,
        search_seconds=searched - searching,
        holdout=_hold_out(columns, signals.torque),
        findings=tuple(findings),
        signals=signals,
    )


def load(paths: list[Path]) -> tuple[Signals, list[Finding]]:
    """The signals of all recordings, one after the other, and what is to be said of them. Raises as `prepare`."""
    parts: list[Signals] = []
    findings: list[Finding] = []
    for path in paths:
        with Recording(path) as recording:
            stand = parse(recording.stand_toml, f"{path}: stand_toml").stand if recording.stand_toml else None
            parts.append(prepare(recording, stand))
            findings += recording_findings(recording, parts[-1])
    return _joined(parts), findings


def _joined(parts: list[Signals]) -> Signals:
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    return Signals(
        time=np.concatenate([part.time for part in parts]),
        torque=np.concatenate([part.torque for part in parts]),
        dtheta=np.concatenate([part.dtheta for part in parts]),
        dtheta_dot=np.concatenate([part.dtheta_dot for part in parts]),
        lost=sum(part.lost for part in parts),
        not_numbers=sum(part.not_numbers for part in parts),
        near_gaps=sum(part.near_gaps for part in parts),
        coarse_clock=any(part.coarse_clock for part in parts),
        band=(min(part.band[0] for part in parts), max(part.band[1] for part in parts)),
        rate_window=max(part.rate_window for part in parts),
        torque_from=first.torque_from if len({part.torque_from for part in parts}) == 1 else "mixed",
    )


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


def _exact(columns: Array, torque: Array) -> Optimum:
    try:
        return least_absolute_deviations(columns, torque)
    except RuntimeError as error:
        raise Untrustworthy(f"no exact optimum could be proven ({error}): leave a term out of --model") from error


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


def _hold_out(columns: Array, torque: Array) -> Holdout:
    fold = np.arange(len(torque)) * _FOLDS // len(torque)
    out = fold % 5 == 2
    genes = _exact(columns[~out], torque[~out]).genes
    left = torque[out] - columns[out] @ genes
    scale = float(np.std(torque[out]))
    return Holdout(float(np.mean(np.abs(left))), float(np.sqrt(np.mean(left**2))) / scale if scale > 0.0 else np.nan)
