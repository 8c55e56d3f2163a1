"""Identify several recordings separately, in this process or in many processes, with equal results."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ga.model.separable import SeparableModel
from hil.errors import Untrustworthy
from hil.identification.fitting.solution import Search
from hil.identification.fixture import identify_without_fixture
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.identification.user_model import of_package
from hil.recording.ahead import Progress
from hil.recording.interval import Given
from hil.workers.sharing import shared

_WORTH = 10.0  # s that the other recordings would take as long as this one, from which processes are started for them
_FEWEST = 3  # tasks that are spread


@dataclass(frozen=True, slots=True)
class Task:
    """One identification to be done.

    recordings: the recordings, or parts of them, to pool. model: the model to fit; None for model selection. search:
    the settings of the search. fixture: the empty rig's recording.
    """

    recordings: tuple[Given, ...]
    model: SeparableModel | None
    search: Search
    fixture: Path | None = None


Result = Identification | Untrustworthy
"""An identification, or the reason why there is none."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C ended the work. results: of the tasks that were complete, by the number of the task."""

    def __init__(self, results: dict[int, Result]) -> None:
        super().__init__()
        self.results = results


def identified(task: Task, progress: Progress | None = None) -> Result:
    """Return the result of a task. Raises WrongUse."""
    if task.model is not None:
        of_package(task.model.name)  # another process has to load the terms of other packages too
    try:
        if task.fixture is None:
            return identify(task.recordings, task.model, task.search, progress)
        return identify_without_fixture(task.recordings, task.fixture, task.model, task.search, progress)
    except Untrustworthy as error:
        return error


def identify_each(tasks: Sequence[Task], progress: Progress | None = None) -> list[Result]:
    """Return the result of each task, in the order of the tasks.

    The first task's setting `workers` limits how many tasks run at a time. Other processes are started
    if the remaining tasks take long enough, as estimated while the first task runs. Raises WrongUse, and Interrupted
    after Ctrl-C.
    """
    found: dict[int, Result] = {}
    try:
        _identify_each(tasks, progress, found)
    except KeyboardInterrupt:
        raise Interrupted(found) from None
    return [found[at] for at in range(len(tasks))]


def _identify_each(tasks: Sequence[Task], progress: Progress | None, found: dict[int, Result]) -> None:
    """Run the tasks in this process and in others, and store the results in `found`."""
    if not tasks:
        return
    workers, count, began = tasks[0].search.workers, len(tasks), time.perf_counter()
    if workers == 1 or count < _FEWEST:
        does = _whole if count > 1 else identified
        for at, task in enumerate(tasks):
            found[at] = does(task, _share(progress, at, count))
        return
    alone, delay = [by_itself(task) for task in tasks], _WORTH / (count - 1)

    def here(at: int) -> Result:
        is_first = time.perf_counter() - began < delay  # all cores are its own until the others come
        return _whole(tasks[at] if is_first else alone[at], _share(progress, at, count))

    def on_done(done: int) -> None:
        if progress is not None:
            progress(f"identified {done} of {count}", done / count)

    shared(_whole, alone, others=min(workers, count) - 1, delay=delay, here=here, found=found, on_done=on_done)


def by_itself(task: Task) -> Task:
    """Return a task that uses one core."""
    return replace(task, search=replace(task.search, workers=1))


def _whole(task: Task, progress: Progress | None = None) -> Result:
    """Return the result of a task. Raises KeyboardInterrupt if Ctrl-C ended the task's search, so that the other tasks
    end too.
    """
    found = identified(task, progress)
    if isinstance(found, Identification) and found.trials.interrupted:
        raise KeyboardInterrupt
    return found


def _share(progress: Progress | None, index: int, count: int) -> Progress | None:
    if progress is None:
        return None
    report = progress
    return lambda what, done: report(f"{index + 1} of {count}: {what}", (index + done) / count)
