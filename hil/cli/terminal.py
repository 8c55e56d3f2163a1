"""What every command shares of the terminal: its options, JSON, findings, a progress bar."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from hil.findings import Finding

DONE, UNTRUSTWORTHY, WRONG_USE, STAND_FAILED, LIMIT_REACHED = 0, 1, 2, 3, 4
INTERRUPTED = 130

Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, all else on standard error.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite the output.")]
Output = Annotated[Path | None, typer.Option("-o", "--output", help="Where to write it.")]


def print_json(table: dict[str, Any]) -> None:
    """Put one JSON object on standard output; a NaN in it is a fault, since JSON has none."""
    print(json.dumps(table, indent=2, allow_nan=False, default=str))


def say(text: str) -> None:
    """Put a line on standard error, where it does not get into anybody's data."""
    print(text, file=sys.stderr)


def tell(findings: tuple[Finding, ...]) -> None:
    """Say every finding, with its code."""
    for finding in findings:
        say(f"{'problem' if finding.fatal else 'note'} [{finding.code}]: {finding.message}")


def command_line() -> str:
    """The command as it was typed, kept in the file that it makes."""
    return shlex.join(["hil", *sys.argv[1:]])


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None] | None]:
    """A progress bar with the time left, where standard error is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)
