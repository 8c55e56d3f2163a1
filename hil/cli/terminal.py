"""What every command shares of the terminal: its options, JSON, diagnostics, how to go on."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TextIO

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from hil.diagnostics import Diagnostic

DONE, UNTRUSTWORTHY, WRONG_USE, STAND_FAILED, LIMIT_REACHED = 0, 1, 2, 3, 4
INTERRUPTED = 130
LARGEST_SEED = 2**63 - 1
"""What an attribute of a recording holds."""

Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, all else on standard error.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite the output.")]
Checkpoint = Annotated[
    Path | None, typer.Option(help="A file that keeps the state of the search; goes on from it where it is there.")
]
Output = Annotated[Path | None, typer.Option("-o", "--output", help="Where to write it.")]


def out(text: str) -> None:
    """Put text on standard output."""
    _write(text, sys.stdout)


def say(text: str) -> None:
    """Put a line on standard error, where it does not get into anybody's data."""
    _write(text, sys.stderr)


def _write(text: str, stream: TextIO) -> None:
    """Print; once nobody reads any more (`hil inspect a.h5 | head -1`), drop what is left and go on."""
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def columns() -> int:
    """Characters that fit on a line of standard output; 80 where it is no terminal."""
    from rich.console import Console

    return Console().width


def out_table(table: Table) -> None:
    """Put a table on standard output."""
    from rich.console import Console

    console = Console()
    with console.capture() as drawn:
        console.print(table)
    out(drawn.get().rstrip("\n"))


def print_json(table: dict[str, Any]) -> None:
    """Put one JSON object on standard output; a NaN in it is a fault, since JSON has none."""
    out(json.dumps(table, indent=2, allow_nan=False, default=str))


def tell(diagnostics: Sequence[Diagnostic]) -> None:
    """Say every diagnostic, with its code."""
    for diagnostic in diagnostics:
        say(f"{diagnostic.severity} [{diagnostic.code}]: {diagnostic.message}")


def tell_interrupted(checkpoint: Path | None) -> NoReturn:
    """Say how to go on with a search that was interrupted, and end with its status."""
    if checkpoint is None:
        say("interrupted: nothing was kept to go on from; with --checkpoint FILE the search could be gone on with")
    else:
        say(f"interrupted: {checkpoint} keeps the search; go on with: {command_line()}")
    raise typer.Exit(INTERRUPTED)


def command_line() -> str:
    """The command as it was typed, kept in the file that it makes."""
    return shlex.join(["hil", *sys.argv[1:]])
