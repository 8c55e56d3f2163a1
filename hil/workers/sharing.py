"""Share tasks between this process and other processes, which are started only if the work takes long."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

from hil.workers.processes import processes

_POLL = 0.2  # s between two reports, once this process has no task left


def shared(
    function: Callable[..., Any],
    tasks: Sequence[Any],
    *,
    others: int,
    delay: float,
    here: Callable[[int], Any],
    on_done: Callable[[int], object] = lambda _done: None,
    found: dict[int, Any] | None = None,
) -> list[Any]:
    """Return the results of `function` for each task, in the order of the tasks.

    here: function that does the task of a given number in this process. others: number of other processes, which start
    after `delay` s of work, so that they load while this process does the first tasks. on_done: called with the number
    of completed tasks. found: in which results are stored by number, also if an error ends the work. Raises the error
    of a task that fails; then no further task begins.
    """
    waiting, over = deque(range(len(tasks))), threading.Event()
    found = {} if found is None else found
    # the processes end first, or a task that has become useless would be waited for
    with ThreadPoolExecutor(others) as threads, processes(others) as on:

        def helped() -> None:
            if over.wait(delay):
                return
            for at in _taken(waiting):
                found[at] = on.submit(function, tasks[at]).result()

        helpers = [threads.submit(helped) for _ in range(others)]
        try:
            for at in _taken(waiting):
                found[at] = here(at)
                _raise_failed(helpers)
                on_done(len(found))
            over.set()
            while wait(helpers, timeout=_POLL).not_done:
                _raise_failed(helpers)
                on_done(len(found))
            _raise_failed(helpers)
        finally:
            waiting.clear()
            over.set()
    on_done(len(found))
    return [found[at] for at in range(len(tasks))]


def _taken(waiting: deque[int]) -> Iterator[int]:
    """Yield the lowest number of a task that has not begun yet, until all tasks have begun."""
    while waiting:
        try:
            yield waiting.popleft()
        except IndexError:  # another thread was faster
            return


def _raise_failed(helpers: Sequence[Future[None]]) -> None:
    for helper in helpers:
        if helper.done():
            helper.result()
