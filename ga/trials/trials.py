"""Many independent searches of the same data, on all cores."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from functools import partial
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
"""Points of the history in each factor of ten of generations."""

_CHUNK: Final = 400_000_000
"""Numbers read in one call of a compiled loop, some 40 ms: how long Ctrl-C waits."""

_CHILD: Final = 200
"""Numbers that a child is worth when the engine does not look at every sample: what else there is to do for it."""

_TYPICAL: Final = 1000
"""Generations after which the stop rule has ended nearly every search of the `default` preset."""

_SHORT: Final = 3_000_000
"""Generations by which the duration of many more is judged."""

_POLL: Final = 0.1
"""s between two reports of progress."""


@dataclass(frozen=True, eq=False)
class _Run:
    """The state that all trials share. grid: generations of the history. engines: those that no thread uses now."""

    engines: SimpleQueue[Engine]
    bounds: Bounds
    settings: Settings
    grid: NDArray[np.int64]
    cancelled: threading.Event


@dataclass(eq=False)
class _Trial:
    """One search under way, with the history it leaves. kept: a copy as of the end of a chunk, whole at any time."""

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
    """Search `trials` times for the genes of columns (n, p) that fit torque (n,), N m, best.

    Each trial has its own generator, seeded from (seed, trial): the result does not depend on `workers`, the number of
    threads. start: where an informed search begins, where the rows stand for others and cannot determine it (Reduced).
    `progress` is called in this thread, several times a second, with the part done, 0 to 1.

    Ctrl-C ends the run within some tenths of a second with KeyboardInterrupt. Where `stop` is given it is asked as
    often; once it returns True, or at Ctrl-C, the result so far is returned, marked as interrupted.

    checkpoint: a file that keeps the state, written `every` so many seconds and at the end, whatever ends the run. If
    it is there already, the search goes on from it and ends in the same bits as if it had not been cut short.

    Raises ValueError where the data are not finite or empty, or where a number or the bounds do not fit;
    WrongCheckpoint, a ValueError, where the file is of another run; OSError where it cannot be read or written.
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
    running = _begun(run, engine, start, seed, trials) if state is None else _resumed(state)
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
    again = partial(begin, engine, bounds, settings, seed, start=start)
    return _outcome(running, run.grid, before, time.process_time() - began, again)


def duration(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    bounds: Bounds,
    settings: Settings,
    *,
    trials: int,
    workers: int,
) -> float:
    """Return how long `trials` searches of a child a generation will take, s, judged by a short one for each worker.

    It overestimates: the first generations are the slowest.
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
    """Return where the search begins, None for a uniform population."""
    if settings.start == "uniform":
        return None
    return start_of(columns, torque, bounds) if start is None else within(start, bounds)


def _expected(settings: Settings, p: int) -> int:
    """The number of evaluations that a search will come to, roughly."""
    if settings.scheme == "steady-state":
        return settings.generations
    return 5 * p * min(settings.generations, settings.generations if settings.tolerance is None else _TYPICAL)


def _begun(run: _Run, engine: Engine, start: Start | None, seed: int, trials: int) -> list[_Trial]:
    """The trials at their first generation."""
    running = []
    for i in range(trials):
        population = begin(engine, run.bounds, run.settings, seed, i, start=start)
        record = np.full(len(run.grid), np.nan)
        record[0] = population.best_fitness[0]
        running.append(_Trial(population, record, (population.copied(), record.copy())))
    return running


def _resumed(state: SearchState) -> list[_Trial]:
    return [
        _Trial(population, record, (population.copied(), record.copy()))
        for population, record in zip(state.populations, state.records, strict=True)
    ]


def _grid(generations: int) -> NDArray[np.int64]:
    decades = np.log10(generations)
    points = 10.0 ** np.linspace(0.0, decades, int(np.ceil(decades * POINTS_PER_DECADE)) + 1)
    grid = np.rint(points).astype(np.int64)
    grid[-1] = generations
    return np.concatenate([[0], grid[np.diff(grid, prepend=0) > 0]])


def _all(run: _Run, engine: Engine, running: list[_Trial], workers: int, watch: _Watch) -> None:
    """Run all trials until they end or must stop, in threads, or in this thread if there is one worker."""
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
    """Run the trial to its end. Yield some times a second, each time with a whole copy of its state kept."""
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
    """Progress, stop request and checkpoint of running trials. asked, kept: s, when it last looked and last saved."""

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


def _outcome(
    running: list[_Trial],
    grid: NDArray[np.int64],
    before: int,
    seconds: float,
    again: Callable[[int], Population],
) -> Trials:
    """The outcome. again: returns the first population of a trial, which its search has overwritten."""
    generations = np.array([t.population.generation for t in running], dtype=np.int64)
    fitness = np.array([t.population.best_fitness[0] for t in running])
    last = int(np.searchsorted(grid, generations.max())) + 1
    record = np.stack([t.record[:last] for t in running])
    evaluations = sum(t.population.evaluations for t in running)
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
        populations=Populations(again(int(fitness.argmin())).genes, running[int(fitness.argmin())].population.genes),
    )
