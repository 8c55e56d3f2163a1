"""What the pages show is true: every block runs as pasted (study); its options, links and codes exist (quick)."""

from __future__ import annotations

import re
import shlex
from dataclasses import fields
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import typer

from drivers.commander.config import CommanderConfig
from drivers.feetech.config import FeetechConfig
from drivers.loadcell.config import LoadCellConfig
from hil.cli.app import app

from .pages import BEFORE, ROOT, Reader, blocks, has_a_drive, notebook_program, page_names, read
from .source import texts

PAGES = page_names()


@pytest.mark.study
@pytest.mark.timeout(1800)  # all commands of a page, twice
@pytest.mark.parametrize("page", [page for page in PAGES if not has_a_drive(page)])
def test_every_block_of_a_page_runs_as_pasted_and_pasted_again(page: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    reader.paste(BEFORE.get(page, ""))
    for _ in range(2):
        read(reader, page)


@pytest.mark.study
def test_the_notebook_runs_from_its_first_cell_to_its_last_twice(tmp_path: Path) -> None:
    (tmp_path / "first_steps.py").write_text(notebook_program(), encoding="utf-8")
    reader = Reader(tmp_path)
    for _ in range(2):
        printed = reader.paste("python first_steps.py")
        assert "Kc = 17." in printed


# -- quick: nothing is run ---------------------------------------------------------------------------------------------


@cache
def options_of(command: tuple[str, ...]) -> frozenset[str]:
    """The options of a command of hil. Raises KeyError where there is no such command."""
    found: Any = typer.main.get_command(app)
    for word in command:
        found = found.commands[word]
    assert not hasattr(found, "commands"), f"hil {' '.join(command)} is a group of commands"
    return frozenset(chain.from_iterable(option.opts for option in found.params)) | {"--help", "--quiet", "--debug"}


def unknown_words(line: str) -> list[str]:
    """The command or the options of a line `hil ...` that do not exist."""
    words = shlex.split(line, comments=True)[1:]
    group = words[:1] in (["stand"], ["calibrate"])
    command = tuple(words[: 2 if group else 1])
    if not words or words[0].startswith("-"):
        return []
    try:
        known = options_of(command)
    except KeyError:
        return [" ".join(command)]
    given = [word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)]
    return [option for option in given if option not in known]


@pytest.mark.parametrize("page", PAGES)
def test_every_command_and_option_that_a_page_shows_exists(page: str) -> None:
    commands = [
        found
        for block in blocks(page)
        for line in block.commands
        for found in re.findall(r"(?:^|[ (/])(hil [a-z][^)&|]*)", line)
    ]
    assert {line: unknown for line in commands if (unknown := unknown_words(line))} == {}


def anchors(page: Path) -> set[str]:
    """The names by which the headings of a page can be linked to."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", re.sub(r"\[(.+?)\]\(.+?\)", r"\1", text).lower()).strip().replace(" ", "-")
        for text in headings
    }


@pytest.mark.parametrize(
    "page", ["README.md", "CONTRIBUTING.md", *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]
)
def test_every_link_of_a_page_leads_somewhere(page: str) -> None:
    text = re.sub(r"```.*?```|`[^`\n]*`", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    dead = []
    for link in re.findall(r"\]\((?!https?:|mailto:)([^)\s]+)\)", text):
        name, _, anchor = link.partition("#")
        target = (ROOT / page).parent / name if name else ROOT / page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dead.append(link)
    assert dead == []


def test_the_table_of_symptoms_has_every_code_and_no_other() -> None:
    text = (ROOT / "docs" / "symptoms.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([a-z-]+)` \|", text, re.MULTILINE)
    assert len(listed) == len(set(listed))
    written = re.compile(r'\bDiagnostic\(\s*"([a-z-]+)"')  # without a parser of Python, which takes 2 s
    assert set(listed) == {code for module in texts().values() for code in written.findall(module)}


@pytest.mark.parametrize(
    ("page", "table"), [("feetech.md", FeetechConfig), ("serial.md", CommanderConfig), ("serial.md", LoadCellConfig)]
)
def test_every_key_of_a_drive_is_on_its_page(page: str, table: Any) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    keys = {field.name for field in fields(table)} - {"port"}
    assert {key for key in keys if f"| `{key}` |" not in text} == set()
