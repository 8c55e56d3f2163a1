"""A short form of benchmarks/anything.py: the whole program under random use."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

SHORT = [(seed, True) for seed in (103, 142)]
LONG = [pytest.param(seed, False, marks=pytest.mark.study) for seed in range(20)]


@pytest.fixture
def anything(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "benchmarks")
    return importlib.import_module("anything")


@pytest.mark.parametrize(("seed", "short"), [*SHORT, *LONG])
def test_a_use_at_random_breaches_nothing(anything: Any, tmp_path: Path, seed: int, short: bool) -> None:
    assert not anything.drawn_in(tmp_path, seed, short=short)["breach"]


def test_a_fault_is_a_breach(anything: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(anything, "run", lambda _words: 70)
    assert "status 70" in anything.drawn_in(tmp_path, 0, short=True)["breach"]
