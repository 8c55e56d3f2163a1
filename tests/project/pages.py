"""The code blocks of the README, of the pages in docs/ and of the notebook, as a reader pastes them."""

from __future__ import annotations

import ast
import json
import os
import re
import signal
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "examples" / "first_steps.ipynb"
_BLOCK = re.compile(r"(?:<!-- ([^>]+?) -->\n\s*)?^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_NAN = re.compile(r"\bnan\b")
_BUSY = 3.0
"""s of processor time that each busy program takes."""
NOT_RUN = {
    "python3 -m venv": ".ci/run installs what it tests, and would install it again for each page",
    "```mermaid": "is a picture",
    "```text": "is an output, or needs root and an adapter, or would change this environment",
    "```cpp": "needs a board",
    "```matlab": "needs MATLAB",
    "```julia": "needs Julia",
    "from distributed import": "needs a cluster, and its keys; test_each.py has both",
    "docs/extending.md ```python": "are parts of a module; test_extending.py puts each in its place",
}
"""Blocks that are not run, by the beginning of their text, or by language, and why."""
_LATE = re.compile(r"^status [134] of: (?:\w+=\$\()?hil (?!identify)", re.MULTILINE)
"""Matches the output of a shell in which a command could not use the drive, or had late ticks. Both happen on a busy
machine: the kernel carries the bytes of a pty in a thread of normal priority, even if hil and the emulator have a high
one. Therefore a block with such output is pasted again, at most three times. If the fault is real, it fails each time.
"""
TRUTH = {
    "cia402": (36e-3, 0.385e-3, 1e-3),
    "commander": (17.75e-3, 0.19e-3, 1e-3),
    "dynamixel": (0.208, 2.23e-3, 0.02),
    "feetech": (1.176, 12.6e-3, 1e-3),
    "moteus": (2.0, 21.4e-3, 1e-3),
    "robstride": (5.6, 59.9e-3, 1e-3),
}
"""Kc and Bc of each emulated joint, SI, and what else makes Kc wrong, relative: its fixture takes 0.09 % off, and the
torque constant of the emulated DYNAMIXEL is 1.5 % below that of the table.
"""
_TROUBLE = {"lost-samples", "many-late"}  # of a machine that was busy after all
BEFORE = {"docs/file_format.md": "hil record --quiet --backend sim --duration 4 --fade 0.2 -o run1.h5"}
"""What a page's reader has in the folder, beside what the page lets them write."""
_STATUS = "trap 'echo \"status $? of: $BASH_COMMAND\" >&2; exit 1' ERR\nset -o pipefail\n"


class Block(NamedTuple):
    """A block of a page: the comment before it, its language, and its text."""

    mark: str
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """The lines of a shell, those behind $ in a transcript; none in another language."""
        lines = self.text.splitlines()
        if self.language == "console":
            return [line[2:] for line in lines if line.startswith("$ ")]
        return lines if self.language == "sh" else []

    @property
    def has_a_drive(self) -> bool:
        """Whether it starts an emulated drive, in real time."""
        return self.language == "sh" and "--background" in self.text


def has_a_drive(page: str) -> bool:
    return any(block.has_a_drive for block in blocks(page))


def page_names() -> list[str]:
    """Every page with a block, by its name from the root, the decisions left out."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    return [str(page.relative_to(ROOT)) for page in pages if blocks(str(page.relative_to(ROOT)))]


def blocks(page: str) -> list[Block]:
    """The blocks of a page from top to bottom."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [Block(*found.groups(default="")) for found in _BLOCK.finditer(text)]


def notebook_program() -> str:
    """The cells of the notebook as one program that shows what each of them ends with."""
    program = []
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            tree = ast.parse("".join(cell["source"]))
            if tree.body and isinstance(tree.body[-1], ast.Expr):
                shown = ast.parse("print(repr(shown))").body
                tree.body[-1:] = [ast.Assign([ast.Name("shown")], tree.body[-1].value, lineno=0), *shown]
            program.append(ast.unparse(tree))
    return "\n".join(program)


@dataclass
class Reader:
    """Someone who pastes into a shell in `folder`, where `hil` and `python` are those of this environment."""

    folder: Path

    def __post_init__(self) -> None:
        tools = self.folder / ".bin"
        tools.mkdir()
        self._write(tools / "hil", "-I -c 'from hil.cli.app import main; main()'")
        self._write(tools / "python", "")
        self._environment = os.environ | {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "80"}

    def paste(self, lines: str) -> str:
        """Return what the lines print; fails with the line that failed. What they left running ends with the shell."""
        with subprocess.Popen(
            ["bash", "-c", _STATUS + lines],
            cwd=self.folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as shell:
            try:
                printed, _ = shell.communicate(timeout=550.0)
            except BaseException:
                os.killpg(shell.pid, signal.SIGKILL)
                raise
        assert shell.returncode == 0, printed
        assert not _NAN.search(printed), printed
        return printed

    @staticmethod
    def _write(path: Path, words: str) -> None:
        path.write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n')
        path.chmod(0o755)


@contextmanager
def busy_machine() -> Iterator[None]:
    """Programs that want every core, for as much of it as a drive takes to be started, checked and recorded.

    They give way to the emulator, which stands for a drive with a computer of its own.
    """
    spin = f"import os, time\nos.nice(10)\nwhile time.process_time() < {_BUSY}: pass"
    loops = [subprocess.Popen([sys.executable, "-c", spin]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def reason_not_to_run(page: str, block: Block) -> str | None:
    starts = (block.text, f"```{block.language}", f"{page} ```{block.language}")
    return next((why for beginning, why in NOT_RUN.items() if any(s.startswith(beginning) for s in starts)), None)


def read(reader: Reader, page: str, *, busy: bool = False) -> None:
    """Paste every block of a page that can run here. busy: whether each drive is used while other programs run."""
    for block in blocks(page):
        if reason_not_to_run(page, block) is None:
            _read(reader, block, busy=busy)
            if block.has_a_drive and "hil identify" in block.text:
                _holds_the_truth(reader, block, "" if busy else (ROOT / page).read_text(encoding="utf-8"))


def _holds_the_truth(reader: Reader, block: Block, text: str) -> None:
    """Hold the intervals of a trusted result against the emulated joint, and its status against the page's text; with
    no text, late ticks may end it with status 1.

    One 95 % interval of twenty misses the truth, and a run of all pages has 28: each may miss by its half width.
    """
    (command,) = re.findall(r"^hil identify .*$", block.text, flags=re.M)
    printed = reader.paste(f"s=0; {command} --json 2>/dev/null >.json || s=$?; echo $s; cat .json")
    status, shown = printed.split("\n", 1)
    codes = {one["code"] for one in json.loads(shown)["warnings"]}
    assert status == "0" or not text or "ends with status 1" in text or codes & _TROUBLE, shown
    (name,) = re.findall(r"hil emulate (\w+)", block.text)
    kc, bc, error = TRUTH[name]
    for parameter, truth, wrong in (("Kc", kc, error), ("Bc", bc, 0.0)):
        one = json.loads(shown)["parameters"][parameter]
        low, high = one["ci95"]
        off = wrong * truth + 0.5 * (high - low)
        assert not one["trusted"] or low - off <= truth <= high + off, (name, parameter, one)


def _read(reader: Reader, block: Block, *, busy: bool) -> None:
    """Paste a block, and hold the output of a transcript against what it shows.

    `hil identify` may end with status 1 where a drive is used: a busy machine makes ticks late.
    """
    name = block.mark.removeprefix("write ")
    if name != block.mark:
        (reader.folder / name).write_text(block.text, encoding="utf-8")
    elif block.language == "toml":
        tomllib.loads(block.text)
    elif block.language == "console":
        for command, shown in zip(block.commands, re.split(r"^\$ .+\n", block.text, flags=re.M)[1:], strict=True):
            _assert_alike(shown, reader.paste(command))
    elif block.language == "python":
        (reader.folder / ".block.py").write_text(block.text, encoding="utf-8")
        reader.paste("python .block.py")
    elif block.has_a_drive:
        with busy_machine() if busy else nullcontext():
            _use_a_drive(reader, re.sub(r"^(hil identify .*)$", r"\1 || [ $? = 1 ]", block.text, flags=re.M))
    else:
        assert block.language == "sh", f"a block of {block.language} is neither run nor in NOT_RUN"
        reader.paste(block.text)


def _use_a_drive(reader: Reader, lines: str) -> None:
    for _ in range(3):
        try:
            reader.paste(lines)
        except AssertionError as error:
            if not _LATE.search(str(error)):
                raise
            warnings.warn(f"pasted again: {error}", stacklevel=2)
        else:
            return
    reader.paste(lines)


_NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_MACHINE = re.compile(
    r"optimiser gap \S+|\d+ evaluations in \S+ s|^(searching|compiling|loading|starting).*$", re.MULTILINE
)
"""What depends on the machine and the moment: the optimiser's last digits, times, and progress."""


def _lines(text: str) -> list[tuple[str, list[str]]]:
    """The words of every line, sorted, with its numbers: tables and messages come from two streams."""
    shown = [" ".join(line.split()) for line in _MACHINE.sub("...", text).splitlines() if line.strip(" .")]
    return sorted((_NUMBER.sub("#", line), _NUMBER.findall(line)) for line in shown)


def _assert_alike(shown: str, printed: str) -> None:
    """Words are equal and numbers within 1 % or the last digit shown: other processors round sums differently."""
    expected, found = _lines(shown), _lines(printed)
    assert [words for words, _ in expected] == [words for words, _ in found]
    for (words, numbers), (_, others) in zip(expected, found, strict=True):
        for number, other in zip(numbers, others, strict=True):
            digits = len(number.partition("e")[0].partition(".")[2])
            digit = 1.01 * 10.0**-digits if digits else 0.0
            assert float(other) == pytest.approx(float(number), rel=0.01, abs=digit), words
