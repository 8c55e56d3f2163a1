"""The notebook of first steps runs from its first cell to its last, without jupyter."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parents[2] / "examples" / "first_steps.ipynb"


@pytest.mark.skipif(not NOTEBOOK.exists(), reason="NOTEBOOK NOT RUN: the examples are only in a checkout")
def test_the_notebook_runs_and_its_interval_is_about_the_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hil.report.html_page.svg", lambda _: "<svg/>")
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    made: dict[str, Any] = {}
    for number, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), f"cell {number}", "exec"), made)  # noqa: S102 - our own notebook
    truth = made["recording"].truth
    assert made["result"]["Kc"].value == pytest.approx(truth["Kc"], rel=0.02)
    assert str(made["result"]) in (tmp_path / "first_steps.html").read_text(encoding="utf-8")
