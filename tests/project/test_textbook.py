"""The textbook: the effects of the records, on recordings that closed forms make (benchmarks/textbook.py)."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import hil
from ga.model.terms import TERMS


@pytest.fixture
def textbook(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("textbook")


def test_every_effect_has_a_law_that_makes_the_stated_part_of_the_torque(textbook: ModuleType) -> None:
    assert set(textbook.LAWS) == set(TERMS)
    p, furthest = textbook.example("cubic", "large"), np.abs(textbook.X).max()
    assert p["K3"] * furthest**3 == pytest.approx(0.4 * p["Kc"] * furthest)


def test_the_parameters_of_a_named_effect_are_in_their_intervals(textbook: ModuleType) -> None:
    found = textbook.judged(textbook.Row("cubic", "small", 1, "cell", 1), selected=False)
    assert found["off"] <= textbook.joint(found["term"])
    assert found["better"] == ""


@pytest.mark.study
def test_the_default_options_find_an_effect_of_plain_size(textbook: ModuleType) -> None:
    found = textbook.judged(textbook.Row("coulomb", "plain", 2, "cell", 1), with_name=False)
    assert (found["selected"], found["outcome"]) == ("linear+coulomb", "right")


@pytest.mark.study
def test_the_middle_of_a_gap_that_may_be_zero_is_not_identifiable(textbook: ModuleType) -> None:
    channels = textbook.channels(textbook.Row("deadband", "small", 4, "cell", 2))
    found = hil.identify(model="linear+offset+deadband", **{n: channels[n] for n in ("time", "torque", "dtheta")})
    assert [found[name].identifiable for name in ("Kc", "Bc", "gap", "centre")] == [True, True, False, False]


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_one_row_of_each_effect_keeps_the_bars_of_the_table(textbook: ModuleType) -> None:
    terms = [name for name in TERMS if name != "gear"]  # which takes as long as all others together
    rows = [textbook.judged(row) for row in textbook.rows_of(terms)[: len(terms)]]
    assert [row for row in rows if row["outcome"] == "wrong" or row["better"] or row["off"] > 3.0] == []
    assert sum(row["off"] > textbook.joint(row["term"]) for row in rows) <= 4  # of 30, of which one in twenty may
