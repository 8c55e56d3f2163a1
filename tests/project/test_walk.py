"""A short form of benchmarks/walk.py: random commands end in sentences."""

from __future__ import annotations

import importlib
import random
import sys
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


@pytest.mark.study
def test_a_short_walk_ends_in_sentences(walk: Any, files: Path, tmp_path: Path) -> None:
    for number in range(24):
        drawn = walk.drawn(random.Random(number), files, CHEAP)  # noqa: S311 - no secret
        ended, reason = walk.walked(drawn, files, tmp_path / str(number))
        assert not reason, (drawn, ended)


def test_tables_drawn_at_random_are_read_right_or_refused(walk: Any, tmp_path: Path) -> None:
    odd_files = sys.modules[walk.make_files.__module__]
    drawn = [odd_files.draw(seed) for seed in range(30)]
    found = [odd_files.judged(one, tmp_path / "a.csv") for one in drawn]
    assert [one.words for one, said in zip(drawn, found, strict=True) if said == "wrong"] == []
    assert found.count("right") > 15
    assert all(said == "refused" for one, said in zip(drawn, found, strict=True) if not one.true)
