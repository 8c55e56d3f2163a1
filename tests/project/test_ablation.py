"""The instrument that switches off one mechanism of the identification at a time (benchmarks/ablation.py)."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

import hil
from ga.model.terms import TERMS


@pytest.fixture
def ablation(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("ablation")


def test_every_mechanism_is_where_its_switch_says_and_every_common_term_has_one(ablation: ModuleType) -> None:
    for name in ablation.switches():
        with ablation.switched_off(name):
            pass
    common = {f"term {name}" for name, one in TERMS.items() if one.selection == "considered"}
    assert common <= set(ablation.switches())


def test_a_switch_changes_the_result_only_while_it_is_off(ablation: ModuleType) -> None:
    textbook = importlib.import_module("textbook")
    channels = textbook.channels(textbook.Row("linear", "plain", 1, "cell", 1))
    first = {name: channels[name][:1500] for name in ("time", "torque", "dtheta")}

    def width() -> float:
        return hil.identify(workers=1, **first)["Kc"].half_width

    before = width()
    with ablation.switched_off("averages over models"):
        assert width() < before
    assert width() == before
