"""Run many independent searches of the same data, on all cores."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from queue import SimpleQueue
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.evolution.evolution import Settings, advance, begin
from ga.evolution.population import Population, Record
from ga.fitness.dense import Samples
from ga.fitness.engine import Engine, engine_for, fork
from ga.start import Start, start_of, within
from ga.trials.checkpoint import SearchState, belonging, load, save
from ga.trials.outcome import History, Populations, Trials

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from ga.bounds import Bounds

POINTS_PER_DECADE: Final = 20
"""The number of points of the history in each factor of ten of generations."""

_CHUNK: Final = 400_000_000
"""The amount of work in one call of a compiled loop, in numbers that it reads: about 40 ms, the longest time that
Ctrl-C waits.
"""

_CHILD: Final = 200
"""The work of a child besides its evaluation, in numbers read, for an engine that does not read every sample."""

_TYPICAL: Final = 1000
"""The number of generations after which the stop rule has ended nearly every search of the `default` preset."""

_SHORT: Final = 3_000_000
"""The number of generations of a short search from which the duration of a long search is predicted."""

_POLL: Final = 0.1
"""The time between two reports of progress, s."""


@dataclass(frozen=True, eq=False)
class _Run:
    """The state that all trials of a run share. grid: generations of the history. engines: the engines that no thread
    uses at present.
    """

    engines: SimpleQueue[Engine]
    bounds: Bounds
    settings: Settings
    grid: NDArray[np.int64]
    cancelled: threading.Event


@dataclass(eq=False)
class _Trial:
    """One search and its history. first: the genes of its first population. kept: a copy of search and history at the
    end of a chunk of work, which is always complete.
    """

    first: NDArray[np.float64]
    population: Population
    record: NDArray[np.float64]
    kept: tuple[Population, NDArray[np.float64]]
    finished: bool = False

    def keep(self) -> None:
        self.kept = (self.population.copied(), self.record.copy())


def run_trials(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    bounds: Bounds,
    settings: Settings,
    *,
    trials: int,
    seed: int,
    workers: int,
    start: Start | None = None,
    progress: Callable[[float], None] | None = None,
    stop: Callable[[], bool] | None = None,
    checkpoint: Path | None = None,
    every: float = 30.0,
) -> Trials:
    """Run `trials` searches for the genes that fit columns (n, p) to torque (n,), N m, best.

    Each trial has its own random generator, seeded from (seed, trial): the result does not depend on `workers`, the
    number of threads. start: the region in which an informed search begins if the rows are reduced (`Reduced.start`).
    progress: a function that is called in this thread, several times a second, with the fraction done, 0 to 1.

    Ctrl-C ends the run within some tenths of a second with KeyboardInterrupt. stop: a function that is called as often;
    the run ends once it returns True. With `stop`, the result so far is returned, also after Ctrl-C, marked as
    interrupted. checkpoint: a file in which the state is saved every `every` seconds and at the end, however the run
    ends. If the file exists already, the search continues from it and gives the same bits as without the interruption.

    Raises ValueError if data, a number or the bounds are not usable; WrongCheckpoint, a ValueError, if the file is of
    another run; OSError if the file cannot be read or written.
    """
    if trials < 1 or workers < 1:
        raise ValueError(f"{trials} trials with {workers} workers: give 1 or more of each")
    began = time.process_time()
    columns, torque = (np.require(array, np.float64, ["C", "W"]) for array in (columns, torque))  # as is compiled for
    start = _start(columns, torque, bounds, settings, start)
    engine = engine_for(columns, torque, bounds, _expected(settings, bounds.low.size), start)
    run = _Run(SimpleQueue(), bounds, settings, _grid(settings.generations), threading.Event())
    belongs = (
        belonging(columns, torque, bounds=bounds, settings=settings, seed=seed, trials=trials) if checkpoint else {}
    )
    state = load(checkpoint, belongs) if checkpoint and checkpoint.exists() else None
    first = partial(begin, engine, bounds, settings, seed, start=start)
    running = _begun(run, first, trials) if state is None else _resumed(first, state)
    before = 0 if state is None else sum(trial.population.evaluations for trial in running)

    def keep() -> None:
        if checkpoint:
            populations, records = zip(*(trial.kept for trial in running), strict=True)
            save(checkpoint, belongs, SearchState(list(populations), np.stack(records)))

    watch = _Watch(settings, progress, stop, keep, every)
    keep()  # an unwritable file is an error now, not after the first hour
    try:
        _all(run, engine, running, min(workers, trials), watch)
    except KeyboardInterrupt:
        if stop is None:
            raise
    finally:
        keep()
    return _outcome(running, run.grid, before, time.process_time() - began)


def duration(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    bounds: Bounds,
    settings: Settings,
    *,
    trials: int,
    workers: int,
) -> float:
    """Return the predicted duration of `trials` steady-state searches, s, from a short search by each worker.

    The prediction is too long: the first generations are the slowest.
    """
    short, at_once = replace(settings, generations=_SHORT), min(workers, trials)
    took = np.inf
    for _ in range(2):  # the first may have compiled
        began = time.perf_counter()
        done = run_trials(columns, torque, bounds, short, trials=at_once, seed=0, workers=at_once)
        took = min(took, (time.perf_counter() - began) / done.made)
        if took * done.made < 1.0:
            break
    return float(trials * settings.generations * took)


def _start(
    columns: NDArray[np.float64], torque: NDArray[np.float64], bounds: Bounds, settings: Settings, start: Start | None
) -> Start | None:
    """Return the region in which the search begins; None for a uniform first population."""
    if settings.start == "uniform":
        return None
    return start_of(columns, torque, bounds) if start is None else within(start, bounds)


def _expected(settings: Settings, p: int) -> int:
    """Return the approximate number of evaluations of a search with p genes."""
    if settings.scheme == "steady-state":
        return settings.generations
    return 5 * p * min(settings.generations, settings.generations if settings.tolerance is None else _TYPICAL)


def _begun(run: _Run, first: Callable[[int], Population], trials: int) -> list[_Trial]:
    """Return the trials with their first populations, evaluated. first: returns that of a trial."""
    running = []
    for i in range(trials):
        population, record = first(i), np.full(len(run.grid), np.nan)
        record[0] = population.best_fitness[0]
        running.append(_Trial(population.genes.copy(), population, record, (population.copied(), record.copy())))
    return running


def _resumed(first: Callable[[int], Population], state: SearchState) -> list[_Trial]:
    return [
        _Trial(first(i).genes, population, record, (population.copied(), record.copy()))
        for i, (population, record) in enumerate(zip(state.populations, state.records, strict=True))
    ]


@lru_cache(maxsize=8)
def _grid(generations: int) -> NDArray[np.int64]:
    decades = np.log10(generations)
    points = 10.0 ** np.linspace(0.0, decades, int(np.ceil(decades * POINTS_PER_DECADE)) + 1)
    grid = np.rint(points).astype(np.int64)
    grid[-1] = generations
    grid = np.concatenate([[0], grid[np.diff(grid, prepend=0) > 0]])
    grid.setflags(write=False)  # kept
    return grid


def _all(run: _Run, engine: Engine, running: list[_Trial], workers: int, watch: _Watch) -> None:
    """Run all trials until they end or must stop, in threads, or in this thread if there is only one worker."""
    if workers == 1:  # to start a thread takes longer than a search of the `default` preset
        for trial in running:
            for _ in _chunks(run, engine, trial):
                if watch.is_over(running):
                    return
        watch.report(running)
        return
    run.engines.put(engine)
    for _ in range(workers - 1):
        run.engines.put(fork(engine))
    with ThreadPoolExecutor(workers) as pool:
        try:
            watch.wait_for([pool.submit(_search, run, trial) for trial in running], running)
        finally:
            run.cancelled.set()  # only an interrupted run has anything left to cancel


def _search(run: _Run, trial: _Trial) -> None:
    engine = run.engines.get()
    try:
        for _ in _chunks(run, engine, trial):
            if run.cancelled.is_set():
                return
    finally:
        run.engines.put(engine)


def _chunks(run: _Run, engine: Engine, trial: _Trial) -> Iterator[None]:
    """Run the trial to its end. Yield some times a second, each time after a complete copy of its state was stored in
    the trial.
    """
    population = trial.population
    record = Record(np.append(run.grid, -1), trial.record)
    children = 1 if run.settings.scheme == "steady-state" else 5 * run.bounds.low.size
    size = engine.blocks.size if isinstance(engine, Samples) else _CHILD
    chunk = max(1, _CHUNK // (max(size, _CHILD) * children))
    while population.generation < run.settings.generations and not population.stopped:
        yield
        until = min(run.settings.generations, population.generation + chunk)
        advance(engine, run.bounds, run.settings, population, until, record=record)
        trial.keep()
    trial.finished = True


@dataclass
class _Watch:
    """Progress, stop request and checkpoint of running trials. asked, kept: times of the last check and save, s."""

    settings: Settings
    progress: Callable[[float], None] | None
    stop: Callable[[], bool] | None
    keep: Callable[[], None]
    every: float
    asked: float = field(default_factory=time.monotonic)
    kept: float = field(default_factory=time.monotonic)

    def wait_for(self, futures: list[Future[None]], running: list[_Trial]) -> None:
        """Wait until the trials end or must stop. Raises the error of a trial that failed."""
        pending: set[Future[None]] = set(futures)
        while pending:
            done, pending = wait(pending, timeout=_POLL)
            for future in done:
                future.result()
            if not pending:
                self.report(running)
            elif self.is_over(running):
                return

    def is_over(self, running: list[_Trial]) -> bool:
        """Report progress, ask to stop, and save, if it is time; return whether the trials must stop."""
        if time.monotonic() - self.asked < _POLL:
            return False
        self.report(running)
        if self.stop is not None and self.stop():
            return True
        if time.monotonic() - self.kept >= self.every:
            self.keep()
            self.kept = time.monotonic()
        self.asked = time.monotonic()
        return False

    def report(self, running: list[_Trial]) -> None:
        if self.progress is not None:
            parts = [1.0 if t.finished else t.population.generation / self.settings.generations for t in running]
            self.progress(sum(parts) / len(parts))


def _outcome(running: list[_Trial], grid: NDArray[np.int64], before: int, seconds: float) -> Trials:
    """Return the best chromosomes, the fitness and the history of the trials `running`, and the work of this run.

    grid: the generations at which the history has a point. before: the number of evaluations before this run. seconds:
    its processor time.
    """
    generations = np.array([t.population.generation for t in running], dtype=np.int64)
    fitness = np.array([t.population.best_fitness[0] for t in running])
    last = int(np.searchsorted(grid, generations.max())) + 1
    record = np.stack([t.record[:last] for t in running])
    evaluations = sum(t.population.evaluations for t in running)
    best = running[int(fitness.argmin())]
    return Trials(
        genes=np.stack([t.population.best for t in running]),
        fitness=fitness,
        evaluations=evaluations,
        generations=generations,
        # where a search was cut short, its record ends
        history=History(
            np.minimum(grid[:last], generations.max()), np.where(np.isnan(record), fitness[:, None], record)
        ),
        finished=np.array([t.finished for t in running]),
        made=evaluations - before,
        processor_seconds=seconds,
        populations=Populations(best.first, best.population.genes),
    )
