"""The random walk through the command line: what it counts as a breach, and a short walk."""

from __future__ import annotations

import importlib
import random
import sys
import time
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
CHEAP = ("inspect", "import", "export", "recover", "record", "calibrate torque", "stand new", "campaign")


@pytest.fixture(scope="module")
def walk() -> Any:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return importlib.import_module("walk")
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def files(walk: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk") / "files"
    walk.make_files(folder, few=True)
    return folder


def step(walk: Any, *words: str) -> Any:
    return walk.Step(list(words), 80, "utf-8", closed_pipe=False, home=True, humble=False)


def test_a_copy_of_the_process_reports_its_status_and_words(walk: Any) -> None:
    def work() -> int:
        sys.stdout.write("answer\n")
        sys.stderr.write("why\n")
        return 2

    ended = walk.in_a_copy(work)
    assert (ended.status, ended.out, ended.err, ended.interrupted) == (2, "answer\n", "why\n", False)


def test_a_copy_that_hangs_gets_ctrl_c(walk: Any) -> None:
    def work() -> int:
        try:
            time.sleep(60.0)
        except KeyboardInterrupt:
            return 130
        return 0

    ended = walk.in_a_copy(work, patience=1.0)
    assert (ended.status, ended.interrupted) == (130, True)
    assert walk.breach(step(walk, "inspect"), ended) == "HANGS"


def test_a_copy_gets_no_more_memory_than_it_may_have(walk: Any) -> None:
    ended = walk.in_a_copy(lambda: len(bytearray(1 << 30)) & 0, memory=1 << 28)
    assert "MemoryError" in ended.err
    assert walk.breach(step(walk, "inspect"), ended)


@pytest.mark.parametrize(
    "said",
    [
        "this is a fault in hil itself",
        "Input should be greater than 0 [type=greater_than]",
        "[Errno 2] No such file or directory: 'a'",
        "Invalid value for '<list[Path]>'",
        "folder/.hil-0123456789abcdef.h5 cannot be written",
        "RuntimeWarning: overflow encountered in square",
    ],
)
def test_words_of_other_programs_are_a_breach(walk: Any, said: str) -> None:
    def work() -> int:
        sys.stderr.write(said)
        return 2

    assert walk.breach(step(walk, "inspect"), walk.in_a_copy(work)).startswith("SAYS")


def test_a_refusal_without_a_word_is_a_breach(walk: Any) -> None:
    assert walk.breach(step(walk, "inspect"), walk.in_a_copy(lambda: 2)) == "SAYS NOTHING"


def test_a_short_walk_ends_in_sentences(walk: Any, files: Path, tmp_path: Path) -> None:
    for number in range(24):
        drawn = walk.drawn(random.Random(number), files, CHEAP)  # noqa: S311 - no secret
        ended, reason = walk.walked(drawn, files, tmp_path / str(number))
        assert not reason, (drawn, ended)
