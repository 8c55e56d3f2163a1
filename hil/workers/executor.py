"""One executor for local processes and for a Dask cluster, and a function that runs tasks in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol

from hil.workers.processes import processes


class Executor(Protocol):
    """The interface of an executor: a part of `concurrent.futures.Executor`."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Run a function in another process and return its future result. The function must be importable by its
        name.
        """
        ...


def executor(count: int, cluster: str | None) -> AbstractContextManager[Executor]:
    """Return an executor of `count` local processes; or of a Dask cluster, if `cluster` is the address of a scheduler
    or "local".

    Raises WrongUse on entry if no scheduler answers at that address.
    """
    if cluster is None:
        return processes(count)
    from hil.workers.cluster import dask_executor

    return dask_executor(cluster, count)


def results(
    on: Executor,
    function: Callable[..., Any],
    tasks: Sequence[Any],
    on_done: Callable[[int], object] = lambda _done: None,
) -> list[Any]:
    """Return the results of `function` for each task, in the order of the tasks.

    on: the executor. on_done: called with the number of completed tasks. Raises what a task raises; the remaining tasks
    are then cancelled.
    """
    futures = [on.submit(function, task) for task in tasks]
    with _cancelled(futures):
        pending = set(futures)
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
            on_done(len(futures) - len(pending))
        return [future.result() for future in futures]


@contextmanager
def _cancelled(futures: Sequence[Future[Any]]) -> Iterator[None]:
    try:
        yield
    finally:
        for future in futures:
            future.cancel()
