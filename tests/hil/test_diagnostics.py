"""What a warning or an error advises is something that whoever reads it can do."""

from __future__ import annotations

import ast
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse
from hil.diagnostics import again
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.recording.writer import Header, write

OPTION = re.compile(r"--(band|amplitude|profile|duration|rate|mode|fade)\b")
"""The options of `hil record` that say how the joint is driven and read."""

RECORDED = ("hil.signals", "hil.identification", "hil.report")
"""The packages that speak of a recording, which may have been imported."""


def folder(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def texts_outside(tree: ast.AST) -> list[str]:
    """The text in a module that no call of `again` has as an argument, without docstrings."""
    if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and tree.func.id == "again":
        return []
    if isinstance(tree, ast.Expr) and isinstance(tree.value, ast.Constant):
        return []
    if isinstance(tree, ast.Constant) and isinstance(tree.value, str):
        return [tree.value]
    return [text for child in ast.iter_child_nodes(tree) for text in texts_outside(child)]


def test_the_options_of_hil_record_are_left_out_for_who_has_another_recorder() -> None:
    assert again("move it faster", "--band", imported=False) == "move it faster (--band)"
    assert again("move it faster", "--band", imported=True) == "move it faster"


@pytest.mark.parametrize("package", RECORDED)
def test_a_message_about_a_recording_names_no_option_of_hil_record_but_by_again(package: str) -> None:
    named = [
        f"{path.name}: {text}"
        for path in sorted(folder(package).rglob("*.py"))
        for text in texts_outside(ast.parse(path.read_text(encoding="utf-8")))
        if OPTION.search(text)
    ]
    assert named == []


@pytest.mark.parametrize(
    ("kind", "model"),
    [
        ("imported", "linear"),
        ("sine", "linear+coulomb"),
        pytest.param("imported", "auto", marks=pytest.mark.study),
        pytest.param("sine", "auto", marks=pytest.mark.study),
    ],
)
def test_advice_about_a_slow_sine_is_in_words_and_names_options_where_there_are_any(
    tmp_path: Path, kind: str, model: str
) -> None:
    time, noise = np.arange(1000) / 50.0, 1e-4 * np.random.default_rng(0).standard_normal(1000)
    dtheta, rate = 0.2 * np.sin(0.3 * time), 0.06 * np.cos(0.3 * time)
    channels = {"time": time, "torque": 0.02 * dtheta + 2e-5 * rate + noise, "dtheta": dtheta}
    write(tmp_path / "a.h5", Header(profile={"kind": kind}, stand_toml=""), channels)
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    found = identify([tmp_path / "a.h5"], None if model == "auto" else parse(model), search)
    said = " ".join(one.message for one in found.diagnostics)
    assert bool(OPTION.search(said)) == (kind != "imported")
    assert re.search(r"Move the joint faster|Drive at several speeds", said)
