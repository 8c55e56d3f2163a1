"""Identify recordings where another program's executor runs its work: on a cluster, or in a pool of processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from hil.errors import Untrustworthy, WrongUse
from hil.identification.each import Interrupted, Result, Task, by_itself, identified
from hil.identification.result import Identification
from hil.recording.ahead import Progress
from hil.recording.interval import Given, Part, path_of
from hil.workers.processes import processes


class _Submits(Protocol):
    def submit(self, function: Any, /, *arguments: Any) -> Future[Any]: ...


Job = tuple[Task, bytes | None]
"""A task with one recording, and the content of that recording; None if it is read from its path."""


def identify_on(executor: Executor, jobs: Sequence[Job], progress: Progress | None = None) -> list[Result]:
    """Return the result of each job, in the order of the jobs, as the processes of an executor compute it.

    A job whose process is lost is Untrustworthy. The jobs that a broken executor did not complete are done by processes
    of this computer. Raises WrongUse, and Interrupted after Ctrl-C.
    """
    found: dict[int, Result] = {}
    try:
        left = _gather(executor, jobs, range(len(jobs)), found, progress)
        if left:
            with processes(min(jobs[0][0].search.workers, len(left))) as others:
                _gather(others, jobs, left, found, progress)
    except KeyboardInterrupt:
        raise Interrupted(found) from None
    return [found[at] for at in range(len(jobs))]


def _gather(
    executor: _Submits, jobs: Sequence[Job], wanted: Sequence[int], found: dict[int, Result], progress: Progress | None
) -> list[int]:
    """Store the results of the wanted jobs in `found`; return the jobs that a broken executor did not do."""
    futures: dict[Future[Any], int] = {}
    try:
        for at in wanted:
            futures[_submitted(executor, jobs[at])] = at
        for future in as_completed(futures):
            try:
                is_result, answer = future.result()
            except BrokenExecutor:
                continue
            except Exception as error:  # noqa: BLE001 - each executor has errors of its own
                is_result, answer = True, _lost(jobs[futures[future]][0], error)
            if not is_result:
                raise answer
            found[futures[future]] = answer
            if progress is not None:
                progress(f"identified {len(found)} of {len(jobs)}", len(found) / len(jobs))
    finally:
        for future in futures:
            future.cancel()
    return [at for at in wanted if at not in found]


def _submitted(executor: _Submits, job: Job) -> Future[Any]:
    try:
        return executor.submit(answered, *job, Path.cwd())
    except BrokenExecutor as error:
        failed: Future[Any] = Future()
        failed.set_exception(error)
        return failed
    except RuntimeError as error:
        raise WrongUse(f"the executor takes no work ({error}): give one that has not been shut down") from error


def _lost(task: Task, error: Exception) -> Untrustworthy:
    return Untrustworthy(
        f"{path_of(task.recordings[0])}: the process that identified it was lost ({type(error).__name__}: {error}), so "
        "Kc and Bc are unknown: identify it by itself, or give its process more memory"
    )


def answered(task: Task, content: bytes | None, folder: Path) -> tuple[bool, Any]:
    """Return True and the result of a task, or False and the error: an error that is raised is one of the executor.

    content: of the task's recording; None if it is read from its path. folder: to which relative paths refer. The
    result names the task's path.
    """
    try:
        with _placed(task, content, folder) as there:
            found = identified(by_itself(there))
    except Exception as error:  # noqa: BLE001 - the caller gets it
        return False, error
    names = [tuple(map(path_of, one.recordings)) for one in (there, task)]
    if isinstance(found, Identification):
        return True, replace(found, recordings=names[1])
    text = str(found)
    for place, name in zip(*names, strict=True):
        text = text.replace(str(place), str(name))
    return True, Untrustworthy(text)


@contextmanager
def _placed(task: Task, content: bytes | None, folder: Path) -> Iterator[Task]:
    """Yield a task whose recording is a file here: that of its path, or a new one with the content."""
    [given] = task.recordings
    task = replace(task, fixture=task.fixture and folder / task.fixture)
    with TemporaryDirectory(prefix="hil-") as made:
        path = folder / path_of(given)
        if content is not None:
            path = Path(made) / path.name
            path.write_bytes(content)
        moved: Given = given._replace(path=path) if isinstance(given, Part) else path
        yield replace(task, recordings=(moved,))
