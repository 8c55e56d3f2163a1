"""How benchmarks/real_ramps.py judges its rows; the ramps themselves take half an hour."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


@pytest.fixture(scope="module")
def script() -> Iterator[ModuleType]:
    folder = str(Path(__file__).parent.parent.parent / "benchmarks")
    sys.path.insert(0, folder)
    yield importlib.import_module("real_ramps")
    sys.path.remove(folder)


def row(number: int, **other: Any) -> dict[str, Any]:
    usual = {
        "file": "a",
        "number": number,
        "status": 0,
        "model": "linear",
        "Kc": 200.0,
        "unexplained": 0.05,
        "codes": [],
    }
    return usual | other


def test_ramps_of_one_model_and_one_stiffness_miss_no_bar(script: ModuleType) -> None:
    found = script.groups([row(101, Kc=205.0), row(0), row(100)])
    assert list(found) == ["a, play", "a, stiffness"]
    assert script.misses(found) == []
    expected = "| stiffness (2) | 0 | 1 of 1 | 1 of 1 | 1.02 (1) | 1.02 (1) | 5.0 |"
    assert script.summary("stiffness", [found["a, stiffness"]]) == expected


def test_every_bar_that_is_missed_is_said_with_its_number(script: ModuleType) -> None:
    rows = [row(100), row(101, model="linear+offset", Kc=300.0, unexplained=0.3), row(102, unexplained=0.3)]
    assert script.misses(script.groups(rows)) == [
        "the same model in 0% of the files, not in 80%",
        "Kc differs 1.50 times (median of 1), more than 1.05",
        "30.0% of the torque's spread is unexplained (median), more than 8 %",
        "ramps with more than 8 % unexplained and no misfit: 2",
    ]


def test_a_kc_that_is_refused_is_counted_and_not_compared(script: ModuleType) -> None:
    found = script.groups([row(100), row(101, Kc=900.0, status=1), row(102, Kc=205.0)])
    assert script.misses(found) == []
    expected = "| stiffness (3) | 1 | 1 of 1 | 2 of 2 | 1.02 (1) | 4.50 (1) | 5.0 |"
    assert script.summary("stiffness", [found["a, stiffness"]]) == expected
    alone = script.summary("stiffness", [[row(100), row(101, Kc=240.0, model="linear+offset", status=1)]])
    assert alone == "| stiffness (2) | 1 | 0 of 1 | 0 of 1 | - | 1.20 (1) | 5.0 |"


def test_the_page_shows_every_ramp_in_its_order(script: ModuleType) -> None:
    odd = row(0, status=1, Kc=None, unexplained=None, model="", codes=["misfit-untested"])
    text = script.page([row(101, status=1, codes=["misfit"]), odd, row(100)])
    assert text.splitlines()[-3:] == [
        "| a | 0 | none | refused (none) | - | untested |",
        "| a | 100 | linear | 200 | 5.0 | no |",
        "| a | 101 | linear | refused (200) | 5.0 | yes |",
    ]


def test_a_ramp_that_is_flagged_or_refused_is_not_silent(script: ModuleType) -> None:
    rows = [row(100), row(101), row(102, unexplained=0.3, codes=["misfit"]), row(103, unexplained=0.3, status=1)]
    assert script.misses(script.groups(rows)) == ["17.5% of the torque's spread is unexplained (median), more than 8 %"]
