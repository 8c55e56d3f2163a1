"""What the pages show is true: every block runs as pasted (study); its options, links and codes exist (quick)."""

from __future__ import annotations

import re
import shlex
import tomllib
import warnings
from contextlib import nullcontext
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

from .pages import ROOT, Block, Reader, blocks, busy_machine, notebook_program, page_names
from .source import modules

PAGES = page_names()
NOT_RUN = {
    "python3 -m venv": ".ci/run installs what it tests, and would install it again for each page",
    "```mermaid": "is a picture",
    "```text": "is an output, or needs root and an adapter, or would change this environment",
    "```cpp": "needs a board",
    "```matlab": "needs MATLAB",
    "```julia": "needs Julia",
    "docs/extending.md ```python": "are parts of a module; test_extending.py puts each in its place",
}
"""Blocks that are not run, by the beginning of their text, or by language, and why."""
LATE = re.compile(r"^status [13] of: (?:\w+=\$\()?hil (?!identify)", re.MULTILINE)
"""What a shell says of a command whose drive failed or had too many late ticks. An emulator behind a pty does so where
the kernel keeps its answer, in a thread that waits for a core like any program, however urgent the two ends are. Such a
block is pasted again, at most three times: what is broken fails each time."""
BEFORE = {"docs/file_format.md": "hil record --quiet --backend sim --duration 4 --fade 0.2 -o run1.h5"}
"""What a page's reader has in the folder, beside what the page lets them write."""


def reason_not_to_run(page: str, block: Block) -> str | None:
    starts = (block.text, f"```{block.language}", f"{page} ```{block.language}")
    return next((why for beginning, why in NOT_RUN.items() if any(s.startswith(beginning) for s in starts)), None)


@pytest.mark.study
@pytest.mark.timeout(1800)  # all commands of a page, twice, beside busy programs
@pytest.mark.filterwarnings("default:pasted again")
@pytest.mark.parametrize("page", PAGES)
def test_every_block_of_a_page_runs_as_pasted_and_pasted_again(page: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    reader.paste(BEFORE.get(page, ""))
    for busy in (False, True):
        for block in blocks(page):
            if reason_not_to_run(page, block) is None:
                read(reader, block, busy=busy)


def read(reader: Reader, block: Block, *, busy: bool) -> None:
    """Paste a block, and hold the output of a transcript against what it shows.

    Where ticks of a drive may be late, since the machine is busy, a result may be untrustworthy, status 1.
    """
    name = block.mark.removeprefix("write ")
    if name != block.mark:
        (reader.folder / name).write_text(block.text, encoding="utf-8")
    elif block.language == "toml":
        tomllib.loads(block.text)
    elif block.language == "console":
        for command, shown in zip(block.commands, re.split(r"^\$ .+\n", block.text, flags=re.M)[1:], strict=True):
            assert_alike(shown, reader.paste(command))
    elif block.language == "python":
        (reader.folder / ".block.py").write_text(block.text, encoding="utf-8")
        reader.paste("python .block.py")
    elif "--background" in block.text:
        with busy_machine() if busy else nullcontext():
            use_a_drive(reader, re.sub(r"^(hil identify .*)$", r"\1 || [ $? = 1 ]", block.text, flags=re.M))
    else:
        assert block.language == "sh", f"a block of {block.language} is neither run nor in NOT_RUN"
        reader.paste(block.text)


def use_a_drive(reader: Reader, lines: str) -> None:
    for _ in range(3):
        try:
            reader.paste(lines)
        except AssertionError as error:
            if not LATE.search(str(error)):
                raise
            warnings.warn(f"pasted again: {error}", stacklevel=2)
        else:
            return
    reader.paste(lines)


@pytest.mark.study
def test_the_notebook_runs_from_its_first_cell_to_its_last_twice(tmp_path: Path) -> None:
    (tmp_path / "first_steps.py").write_text(notebook_program(), encoding="utf-8")
    reader = Reader(tmp_path)
    for _ in range(2):
        printed = reader.paste("python first_steps.py")
        assert "Kc = 17." in printed


NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
MACHINE = re.compile(
    r"optimiser gap \S+|\d+ evaluations in \S+ s|^(searching|compiling|loading|starting).*$", re.MULTILINE
)
"""What depends on the machine and the moment: the optimiser's last digits, times, and progress."""


def lines(text: str) -> list[tuple[str, list[str]]]:
    """The words of every line, sorted, with its numbers: tables and messages come from two streams."""
    shown = [" ".join(line.split()) for line in MACHINE.sub("...", text).splitlines() if line.strip(" .")]
    return sorted((NUMBER.sub("#", line), NUMBER.findall(line)) for line in shown)


def assert_alike(shown: str, printed: str) -> None:
    """Words are equal and numbers within 1 % or the last digit shown: other processors round sums differently."""
    expected, found = lines(shown), lines(printed)
    assert [words for words, _ in expected] == [words for words, _ in found]
    for (words, numbers), (_, others) in zip(expected, found, strict=True):
        for number, other in zip(numbers, others, strict=True):
            digits = len(number.partition("e")[0].partition(".")[2])
            digit = 1.01 * 10.0**-digits if digits else 0.0
            assert float(other) == pytest.approx(float(number), rel=0.01, abs=digit), words


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
    assert set(listed) == {code for module in modules().values() for code in module.codes}


@pytest.mark.parametrize(
    ("page", "table"), [("feetech.md", FeetechConfig), ("serial.md", CommanderConfig), ("serial.md", LoadCellConfig)]
)
def test_every_key_of_a_drive_is_on_its_page(page: str, table: Any) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    keys = {field.name for field in fields(table)} - {"port"}
    assert {key for key in keys if f"| `{key}` |" not in text} == set()
