"""Tasks in processes of this computer: what they return, and what becomes of those whose process dies."""

from __future__ import annotations

import operator
import os
import signal
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.workers.processes import processes
from hil.workers.sharing import shared


def test_a_task_runs_in_another_process() -> None:
    with processes(1) as on:
        assert on.submit(os.getpid).result() != os.getpid()


@pytest.fixture
def marking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], int]:
    """A task that leaves a mark in a folder, and returns the process which did it; it fails where that is "bad"."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "marking.py").write_text(
        "import os, pathlib\n"
        "def it(folder):\n"
        "    (pathlib.Path(folder) / 'mark').touch()\n"
        "    return 1 // (not folder.endswith('bad')) and os.getpid()\n"
    )
    function: Callable[[str], int] = import_module("marking").it
    return function


def until_marked(folder: Path) -> Callable[[int], int]:
    """Tasks of this process, which last until another one has begun one."""

    def here(_at: int) -> int:
        deadline = time.monotonic() + 60.0
        while not (folder / "mark").exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        return os.getpid()

    return here


def test_others_take_tasks_while_this_process_is_at_its_first(tmp_path: Path, marking: Callable[[str], int]) -> None:
    done: list[int] = []
    tasks = [str(tmp_path)] * 6
    found = shared(marking, tasks, others=1, delay=0.0, here=until_marked(tmp_path), on_done=done.append)
    assert len(found) == 6
    assert os.getpid() in found
    assert len(set(found)) == 2
    assert done[-1] == 6


def test_work_that_is_done_before_the_delay_starts_no_process() -> None:
    assert shared(os.abort, range(5), others=1, delay=60.0, here=lambda at: at) == list(range(5))


def test_what_a_task_of_another_process_raises_is_raised(tmp_path: Path, marking: Callable[[str], int]) -> None:
    folder = tmp_path / "bad"
    folder.mkdir()
    with pytest.raises(ZeroDivisionError):
        shared(marking, [str(folder)] * 4, others=1, delay=0.0, here=until_marked(folder))


def test_a_task_raises_what_its_function_raises() -> None:
    with processes(1) as on:
        with pytest.raises(ZeroDivisionError):
            on.submit(operator.truediv, 1, 0).result()
        assert on.submit(operator.add, 1, 1).result() == 2  # and the process goes on


def test_a_process_that_dies_costs_its_task_a_retry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "dying_task.py").write_text(
        "import os, pathlib, signal\n"
        "def run(mark):\n"
        "    place = pathlib.Path(mark)\n"
        "    if not place.exists():\n"
        "        place.touch()\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return mark\n"
    )
    run = import_module("dying_task").run
    marks = [str(tmp_path / name) for name in ("a", "b")]
    with processes(2) as on:
        assert [future.result() for future in [on.submit(run, mark) for mark in marks]] == marks


@pytest.mark.study
def test_a_task_that_always_kills_its_process_is_given_up() -> None:
    with processes(1) as on, pytest.raises(WrongUse, match="3 processes died"):
        on.submit(os.abort).result()


def test_nobody_waits_for_the_tasks_of_processes_that_are_not_needed_any_more() -> None:
    with processes(1) as on:
        running = on.submit(signal.pause)
        waiting = on.submit(signal.pause)
    assert waiting.cancelled()
    with pytest.raises(WrongUse):
        running.result()
