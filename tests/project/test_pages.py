"""The pages of the documentation: their commands run, and their tables have every code that the program can say."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path

import pytest

import hil
from hil.cli.app import run

DOCS = Path(__file__).parent.parent.parent / "docs"
BLOCK = re.compile(r"<!-- (run|python|write (\S+)) -->\n```\w+\n(.+?)\n```", re.DOTALL)
WITH_COMMANDS = sorted(page.name for page in DOCS.glob("*.md") if BLOCK.search(page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_commands_of_a_page_run_from_top_to_bottom(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hil.report.html_page.svg", lambda _: "<svg/>")  # half of the time, and the README's is drawn
    for mark, written, text in BLOCK.findall((DOCS / page).read_text(encoding="utf-8")):
        if written:
            Path(written).write_text(text + "\n", encoding="utf-8")
            continue
        if mark == "python":
            exec(compile(text, page, "exec"), {})  # noqa: S102 - our own page
            continue
        for command in text.splitlines():
            assert run(shlex.split(command)[1:]) == 0, command


def test_the_pages_with_commands_are_found() -> None:
    assert "first_recording.md" in WITH_COMMANDS


def codes() -> set[str]:
    """The codes of all diagnostics: each is the first argument of a `Diagnostic(...)`."""
    found = set()
    for path in Path(hil.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Diagnostic":
                code = node.args[0] if node.args else None
                if isinstance(code, ast.Constant):
                    found.add(str(code.value))
    return found


def test_the_table_of_symptoms_has_every_code_and_no_other() -> None:
    text = (DOCS / "symptoms.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([a-z-]+)` \|", text, re.MULTILINE)
    assert len(listed) == len(set(listed))
    assert set(listed) == codes()
