"""Identify three recordings by the executor of another engine; as a program, print the results before and after a loss.

A program of its own, because these engines leave threads and processes to the end of theirs.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import hil as api


class Unlucky(Executor):
    """An executor in which a process dies at the second job, as `die` has it; the others are done by `executor`."""

    def __init__(self, executor: Executor, die: Callable[[Executor], Future[Any]]) -> None:
        self._executor, self._die, self._jobs = executor, die, 0

    def submit(self, function: Any, /, *arguments: Any, **named: Any) -> Future[Any]:
        self._jobs += 1
        return self._die(self._executor) if self._jobs == 2 else self._executor.submit(function, *arguments, **named)


def table(one: Any) -> dict[str, Any]:
    return {name: value for name, value in one.as_json().items() if name not in {"seconds", "recordings"}}


def identified(paths: list[Path], executor: Executor | None) -> list[Any]:
    """The first by its relative path, the second by its bytes, the third by its path."""
    given = [Path(os.path.relpath(paths[0])), paths[1].read_bytes(), paths[2]]
    found: list[Any] = api.identify_each(given, "linear", trials=1, workers=1, executor=executor)
    assert [one.identification.recordings[0] for one in found[::2] if not isinstance(one, api.NoResult)] == given[::2]
    return found


@contextmanager
def engine(name: str) -> Iterator[Callable[[], Executor]]:
    """Yield a function that returns an executor: a pool of processes, or workers of Dask, reached over TLS."""
    if name == "pool":
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            yield lambda: pool
        return
    distributed: Any = import_module("distributed")

    security = distributed.Security.temporary()
    settings = {"protocol": "tls", "security": security, "host": "127.0.0.1", "dashboard_address": None}
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, **settings) as cluster,
        distributed.Client(cluster, security=security) as client,
    ):
        assert cluster.scheduler_address.startswith("tls://127.0.0.1:")
        yield client.get_executor


def main(name: str, paths: list[Path]) -> None:
    with engine(name) as executor:
        whole = identified(paths, executor())
        lost = identified(paths, Unlucky(executor(), lambda on: on.submit(os.abort)))
    sys.stdout.write(json.dumps([[table(one) for one in found] for found in (whole, lost)]))


if __name__ == "__main__":
    main(sys.argv[1], [Path(path) for path in sys.argv[2:]])
