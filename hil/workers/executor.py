"""One executor for local processes and for a Dask cluster, and tasks run on it in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol

from hil.workers.processes import processes


class Executor(Protocol):
    """A part of `concurrent.futures.Executor`."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Return the future result of a function that another process can import by its name."""
        ...


def executor(count: int, cluster: str | None) -> AbstractContextManager[Executor]:
    """Return an executor of `count` processes here, or on a Dask cluster: the address of its scheduler, or "local".

    Raises WrongUse on entry where no such scheduler answers.
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
    """Return the results of a function of each task, in their order; on_done: is called with how many are done.

    Raises what a task raises; the others are then cancelled.
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
