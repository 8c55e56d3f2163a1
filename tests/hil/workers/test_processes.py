"""Tasks in processes of this computer: what they return, and what becomes of those whose process dies."""

from __future__ import annotations

import math
import operator
import os
import signal
from importlib import import_module
from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.workers.executor import results
from hil.workers.processes import processes


def test_results_come_in_the_order_of_the_tasks_from_other_processes() -> None:
    on_done: list[int] = []
    with processes(2) as on:
        assert results(on, math.factorial, [3, 1, 5], on_done.append) == [6, 1, 120]
        assert on.submit(os.getpid).result() != os.getpid()
    assert on_done[-1] == 3


def test_the_caller_helps_with_the_tasks_that_no_process_has_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "who_did.py").write_text(
        "import os, time\ndef it(_task):\n    time.sleep(0.05)\n    return os.getpid()\n"
    )
    it = import_module("who_did").it
    with processes(1) as on:
        found = results(on, it, range(40), helping=True)
    assert len(found) == 40
    assert {os.getpid()} < set(found)
    assert found[-1] == os.getpid() != found[0]


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
        assert results(on, run, marks) == marks


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
