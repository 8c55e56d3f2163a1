"""Recordings identified each on its own, here or spread over processes and computers, with the same bits."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hil.errors import Untrustworthy, WrongUse
from hil.identification.fixture import identify_without_fixture
from hil.identification.identify import Search, identify
from hil.identification.model_choice import Coupling
from hil.identification.result import Identification
from hil.identification.user_model import of_package
from hil.recording.ahead import Progress
from hil.workers.executor import executor, results

_WORTH = 10.0  # s that the other recordings must take, for processes to be started for them


@dataclass(frozen=True, slots=True)
class Task:
    """One identification: recordings, pooled, with a model (None: model selection). fixture: the empty rig's recording.

    folder: where the paths begin, on every computer.
    """

    recordings: tuple[Path, ...]
    model: Coupling | None
    search: Search
    fixture: Path | None = None
    folder: str = ""


Result = Identification | Untrustworthy
"""An identification, or why there is none."""


def identified(task: Task, progress: Progress | None = None) -> Result:
    """Return the result of a task. Raises WrongUse."""
    if task.folder and task.folder != os.getcwd():  # noqa: PTH109 - a string is what the task has
        try:
            os.chdir(task.folder)
        except OSError:
            raise WrongUse(
                f"a worker of the cluster has no folder {task.folder}: recordings must have the same path there"
            ) from None
    if task.model is not None:
        of_package(task.model.name)  # another process has to load the terms of other packages too
    try:
        if task.fixture is None:
            return identify(task.recordings, task.model, task.search, progress)
        return identify_without_fixture(task.recordings, task.fixture, task.model, task.search, progress)
    except Untrustworthy as error:
        return error


def identify_each(tasks: Sequence[Task], cluster: str | None = None, progress: Progress | None = None) -> list[Result]:
    """Return the result of each task, in their order.

    The search of the first task says how many may run at a time. cluster: the address of a Dask scheduler, or "local";
    None: processes of this computer, which are started where the tasks after one take long enough. Raises WrongUse.
    """
    found: list[Result] = []
    workers = tasks[0].search.workers if tasks else 1
    if cluster is None:
        found, tasks = _here(tasks, workers, progress)
    if not tasks:
        return found
    alone = [replace(task, search=replace(task.search, workers=1), folder=str(Path.cwd())) for task in tasks]
    done, count = len(found), len(found) + len(tasks)

    def on_done(more: int) -> None:
        if progress is not None:
            progress(f"identified {done + more} of {count}", (done + more) / count)

    others = min(workers, len(alone)) if cluster else workers - 1  # here this process is one of them
    with executor(others, cluster) as on:
        on_done(0)
        return [*found, *results(on, _whole, alone, on_done, helping=cluster is None)]


def _whole(task: Task, progress: Progress | None = None) -> Result:
    """Return the result of a task. Raises KeyboardInterrupt where Ctrl-C ended its search: it ends the others too."""
    found = identified(task, progress)
    if isinstance(found, Identification) and found.trials.interrupted:
        raise KeyboardInterrupt
    return found


def _here(tasks: Sequence[Task], workers: int, progress: Progress | None) -> tuple[list[Result], Sequence[Task]]:
    """Return the results of the tasks that this process does, and the tasks that are left for others."""
    found: list[Result] = []
    for index, task in enumerate(tasks):
        began = time.perf_counter()
        found.append((_whole if len(tasks) > 1 else identified)(task, _share(progress, index, len(tasks))))
        left = tasks[index + 1 :]
        if workers > 1 and len(left) > 1 and (time.perf_counter() - began) * len(left) > _WORTH:
            return found, left
    return found, ()


def _share(progress: Progress | None, index: int, count: int) -> Progress | None:
    if progress is None:
        return None
    report = progress
    return lambda what, done: report(f"{index + 1} of {count}: {what}", (index + done) / count)
