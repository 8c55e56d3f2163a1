"""Many independent searches of the same data, on all cores, and what they say together (the paper's Table 1)."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.evolution import Population, Settings, advance, begin
from ga.fitness import Samples, pack

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from ga.space import Bounds

POINTS_PER_DECADE: Final = 20
"""Points of the history in each factor of ten of generations."""

_CHUNK: Final = 400_000_000
"""Numbers read in one call of a compiled loop, some 40 ms: how long Ctrl-C waits."""

_POLL: Final = 0.1
"""s between two reports of progress."""


@dataclass(frozen=True, eq=False)
class History:
    """The best fitness so far against the generation, at log-spaced generations (the paper's Figure 8).

    generation: (m,), from 0, the initial population, on. fitness: (trials, m), N m; a trial that its stop rule ended
    keeps its last value from there on.
    """

    generation: NDArray[np.int64]
    fitness: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trials:
    """The outcome of the trials.

    genes: (trials, p), the best chromosome of each, SI. fitness: (trials,), N m. evaluations: of all trials together.
    generations: (trials,).
    """

    genes: NDArray[np.float64]
    fitness: NDArray[np.float64]
    evaluations: int
    generations: NDArray[np.int64]
    history: History

    @property
    def best(self) -> NDArray[np.float64]:
        """The genes (p,) of the best trial."""
        return np.asarray(self.genes[int(np.argmin(self.fitness))])

    @property
    def mean(self) -> NDArray[np.float64]:
        """The mean (p,) over the trials."""
        return np.asarray(self.genes.mean(axis=0))

    @property
    def std(self) -> NDArray[np.float64]:
        """The standard deviation (p,) over the trials, with n - 1; NaN for a single trial."""
        if len(self.genes) < 2:
            return np.full(self.genes.shape[1], np.nan)
        return np.asarray(self.genes.std(axis=0, ddof=1))

    def scaled(self, share: float) -> Trials:
        """The same with every fitness times `share`, for data whose rows stand for 1/share times as many."""
        history = replace(self.history, fitness=self.history.fitness * share)
        return replace(self, fitness=self.fitness * share, history=history)


@dataclass(frozen=True, eq=False)
class _Run:
    """What all trials share."""

    samples: Samples
    bounds: Bounds
    settings: Settings
    grid: NDArray[np.int64]
    cancelled: threading.Event


@dataclass(eq=False)
class _Trial:
    """One search under way, with the history it leaves."""

    population: Population
    record: NDArray[np.float64]
    finished: bool = False


def run_trials(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    bounds: Bounds,
    settings: Settings,
    *,
    trials: int,
    seed: int,
    workers: int,
    progress: Callable[[float], None] | None = None,
) -> Trials:
    """Search `trials` times for the genes of columns (n, p) that fit torque (n,), N m, best.

    Each trial has its own generator, seeded from (seed, trial): the result does not depend on `workers`, the number of
    threads. `progress` is called in this thread, several times a second, with the part done, 0 to 1. Ctrl-C ends the
    run within a few tens of milliseconds with KeyboardInterrupt.
    Raises ValueError where the data are not finite or empty, or where a number or the bounds do not fit.
    """
    if trials < 1 or workers < 1:
        raise ValueError(f"{trials} trials with {workers} workers: give 1 or more of each")
    run = _Run(pack(columns, torque), bounds, settings, _grid(settings.generations), threading.Event())
    running = [
        _Trial(begin(run.samples, bounds, settings, seed, trial), np.full(len(run.grid), np.nan))
        for trial in range(trials)
    ]
    with ThreadPoolExecutor(workers) as pool:
        try:
            futures = [pool.submit(_search, run, trial) for trial in running]
            _watch(futures, running, settings, progress)
        finally:
            run.cancelled.set()  # only an interrupted run has anything left to cancel
    return _outcome(running, run.grid)


def _grid(generations: int) -> NDArray[np.int64]:
    decades = np.log10(generations)
    points = np.logspace(0.0, decades, int(np.ceil(decades * POINTS_PER_DECADE)) + 1)
    return np.unique(np.concatenate([[0], np.rint(points), [generations]]).astype(np.int64))


def _search(run: _Run, trial: _Trial) -> None:
    population = trial.population
    children = 1 if run.settings.scheme == "steady-state" else 5 * run.bounds.low.size
    chunk = max(1, _CHUNK // (run.samples.blocks.size * children))
    for point, generation in enumerate(run.grid):
        while population.generation < generation and not population.stopped:
            if run.cancelled.is_set():
                return
            until = min(int(generation), population.generation + chunk)
            advance(run.samples, run.bounds, run.settings, population, until)
        trial.record[point] = population.best_fitness[0]
    trial.finished = True


def _watch(
    futures: list[Future[None]],
    running: list[_Trial],
    settings: Settings,
    progress: Callable[[float], None] | None,
) -> None:
    """Wait for the trials, telling of their progress; what went wrong in one is raised here."""
    pending: set[Future[None]] = set(futures)
    while pending:
        done, pending = wait(pending, timeout=_POLL)
        for future in done:
            future.result()
        if progress is not None:
            parts = [1.0 if t.finished else t.population.generation / settings.generations for t in running]
            progress(sum(parts) / len(parts))


def _outcome(running: list[_Trial], grid: NDArray[np.int64]) -> Trials:
    generations = np.array([t.population.generation for t in running], dtype=np.int64)
    last = int(np.searchsorted(grid, generations.max())) + 1
    return Trials(
        genes=np.stack([t.population.best for t in running]),
        fitness=np.array([t.population.best_fitness[0] for t in running]),
        evaluations=sum(t.population.evaluations for t in running),
        generations=generations,
        history=History(np.minimum(grid[:last], generations.max()), np.stack([t.record[:last] for t in running])),
    )
