"""Run many independent searches for a model's nonlinear parameters; for each candidate the linear parameters are
computed exactly.

Each search uses the `default` scheme on some hundred rows, where an evaluation takes a fraction of a millisecond. It
ends when its population has gathered at one local minimum or, for a single parameter, when the best fitness no longer
falls. From there it descends, on more rows and then on all rows. Trials that reach the same local minimum give nearly
the same result; others differ.
"""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.bounds import Bounds
from ga.evolution.ask_tell import Search
from ga.evolution.evolution import Settings
from ga.model.separable import (
    FEW,
    Fit,
    Problem,
    compass_search,
    descend,
    fit,
    solve_or_none,
)
from ga.trials.outcome import History, Trials

if TYPE_CHECKING:
    from collections.abc import Callable

_TOLERANCE: Final = 1e-2
"""The relative spread of the population's fitness at which the population has gathered at one local minimum."""

_IDLE: Final = 10
_GAINED: Final = 1e-2
"""If the best fitness falls by less than the fraction _GAINED in _IDLE generations, a search for one parameter has
found its local minimum.

The descent from there needs no gathered population. A search for several parameters must first find the direction to a
narrow minimum, which may take longer.
"""

_POLL: Final = 0.1


@dataclass(eq=False)
class _Trial:
    """One running search. record: the best fitness of each generation, N m. seconds: processor time of the search's
    thread.
    """

    search: Search
    record: list[float] = field(default_factory=list)
    fit: Fit | None = None
    seconds: float = 0.0


def search_nonlinear(
    problem: Problem,
    settings: Settings,
    *,
    trials: int,
    seed: int,
    workers: int,
    progress: Callable[[float], None] | None = None,
) -> tuple[Trials, Fit]:
    """Run `trials` searches for the nonlinear parameters of a model.

    Returns the trials, whose genes are all parameters (p + q,), and the fit of the best trial, which is never worse
    than that of a grid of starting values. The result does not depend on `workers`. Ctrl-C ends the
    searches: the results so far are returned. Raises ValueError for settings that are not of the generational scheme.
    """
    sketch = problem.sketched(FEW)
    bounds = Bounds(problem.low, problem.high)
    settings = replace(settings, tolerance=max(settings.tolerance or 0.0, _TOLERANCE))
    seeds = np.random.SeedSequence([seed, trials]).generate_state(trials, np.uint32)
    running = [_Trial(Search(bounds, settings, seed=int(number))) for number in seeds]
    cancelled = threading.Event()
    with ThreadPoolExecutor(min(workers, trials)) as pool:
        futures = [pool.submit(_run, trial, problem, sketch, cancelled) for trial in running]
        try:
            _watch(futures, progress)
        except KeyboardInterrupt:
            pass  # the trials that are not finished show it
        finally:
            cancelled.set()
    begun = [trial for trial in running if trial.record]
    _polish([trial for trial in begun if trial.fit is not None], problem)
    return _outcome(begun, problem)


def _polish(finished: list[_Trial], problem: Problem) -> None:
    """Improve the best of the `finished` trials: descend from its local minimum, or from that of a grid of starting
    values if it is lower.
    """
    if finished:
        best = min(finished, key=lambda trial: trial.fit.fitness if trial.fit else np.inf)
        found = [compass_search(problem, best.fit)] if best.fit else []
        found += [fit(problem)] if problem.model.linear else []
        best.fit = min(found, key=lambda one: one.fitness)


def _watch(futures: list[Future[None]], progress: Callable[[float], None] | None) -> None:
    pending: set[Future[None]] = set(futures)
    while pending:
        done, pending = wait(pending, timeout=_POLL)
        for future in done:
            future.result()
        if progress is not None:
            progress(1.0 - len(pending) / len(futures))


def _run(trial: _Trial, problem: Problem, sketch: Problem, cancelled: threading.Event) -> None:
    search, near, began = trial.search, None, time.thread_time()
    while not (is_over := search.done or _is_idle(trial.record, len(problem.low))) and not cancelled.is_set():
        points = search.ask()
        fits = [solve_or_none(sketch, point, near) for point in points]
        near = min((fit for fit in (*fits, near) if fit), key=lambda fit: fit.fitness, default=None)
        search.tell(points, [fit.fitness if fit else np.inf for fit in fits])
        trial.record.append(search.best_fitness)
    if is_over:
        some = problem.sketched()
        trial.fit = compass_search(
            problem, descend(problem, compass_search(some, descend(some, search.best)).nonlinear)
        )
    trial.seconds = time.thread_time() - began


def _is_idle(record: list[float], count: int) -> bool:
    """Return whether the best fitness no longer falls. record: the best fitness of each generation.

    count: the number of parameters; always False for more than one.
    """
    return count == 1 and len(record) > _IDLE and record[-1 - _IDLE] <= (1.0 + _GAINED) * record[-1]


def _outcome(running: list[_Trial], problem: Problem) -> tuple[Trials, Fit]:
    fits = [trial.fit or problem.solve(trial.search.best) for trial in running]
    last = max(len(trial.record) for trial in running)
    record = np.array([trial.record + [trial.record[-1]] * (last - len(trial.record)) for trial in running])
    trials = Trials(
        genes=np.stack([fit.values for fit in fits]),
        fitness=np.array([fit.fitness for fit in fits]),
        evaluations=sum(trial.search.evaluations for trial in running),
        made=sum(trial.search.evaluations for trial in running),
        processor_seconds=sum(trial.seconds for trial in running),
        generations=np.array([len(trial.record) for trial in running], dtype=np.int64),
        history=History(np.arange(last), record),
        finished=np.array([trial.fit is not None for trial in running]),
    )
    return trials, min(fits, key=lambda fit: fit.fitness)
