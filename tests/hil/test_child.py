"""Processes that hil starts: its own modules run in them, and nothing from the working directory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import hil
from hil.child import command

ROOT = Path(hil.__file__).resolve().parents[1]
MODULES = ("h5py", "numpy", "rich", "runpy", "hil")


def planted(folder: Path) -> Path:
    """Put a module that leaves a mark beside the user under every name that hil imports."""
    for name in MODULES:
        (folder / f"{name}.py").write_text(f"open({str(folder / 'mark')!r}, 'w').close()\n")
    return folder / "mark"


@pytest.mark.parametrize("path", [[""], ["here"]], ids=["empty entry", "cwd"])
def test_nothing_from_the_working_directory_runs_in_a_process_of_hils(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: list[str]
) -> None:
    mark = planted(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path) if entry == "here" else entry for entry in path] + sys.path)
    monkeypatch.setenv("PYTHONPATH", f"{os.pathsep}{tmp_path}")
    subprocess.run(command("hil.recording.channels"), check=True)
    assert not mark.exists()


@pytest.mark.study
def test_a_run_with_a_live_view_takes_nothing_from_the_working_directory(tmp_path: Path) -> None:
    mark = planted(tmp_path)
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); sys.stderr.isatty = lambda: True\n"
        "from hil.cli.app import run; sys.exit(run(sys.argv[1:]))"
    )
    words = ["record", "--backend", "sim", "--duration", "0.5", "--fade", "0.1", "-o", "a.h5"]
    subprocess.run([sys.executable, "-P", "-c", code, *words], check=True, cwd=tmp_path, capture_output=True)
    assert (tmp_path / "a.h5").exists()
    assert not mark.exists()


def test_a_process_of_hils_finds_the_same_hil_and_its_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "shown.py").write_text(
        "import json, sys, hil; print(json.dumps([__name__, sys.argv[1:], hil.__file__]))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    for place in (tmp_path.parent, ROOT):
        monkeypatch.chdir(place)
        ended = subprocess.run(command("shown", "a b", "-c"), check=True, capture_output=True, text=True)
        assert json.loads(ended.stdout) == ["__main__", ["a b", "-c"], str(ROOT / "hil" / "__init__.py")]


def test_a_process_starts_where_the_working_directory_was_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    ended = subprocess.run(command("json.tool"), check=True, input="[1]", capture_output=True, text=True)
    assert json.loads(ended.stdout) == [1]
