"""The code blocks of the README, of the pages in docs/ and of the notebook, as a reader pastes them."""

from __future__ import annotations

import ast
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "examples" / "first_steps.ipynb"
_BLOCK = re.compile(r"(?:<!-- ([^>]+?) -->\n\s*)?^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_NAN = re.compile(r"\bnan\b")
_BUSY = 3.0
"""s of processor time that each busy program takes."""
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
