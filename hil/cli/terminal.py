"""The exit statuses, and printing to the terminal: text, tables, JSON, diagnostics."""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import typer

from hil.errors import Declined, WrongUse
from hil.printable import printable

if TYPE_CHECKING:
    from rich.table import Table

    from hil.diagnostics import Diagnostic
    from hil.report.formatting import Section

DONE, UNTRUSTWORTHY, WRONG_USE, STAND_FAILED, LIMIT_REACHED = 0, 1, 2, 3, 4
INTERNAL_ERROR, INTERRUPTED = 70, 130
_SPELLED = str.maketrans({"\u00b1": "+/-", "\u00b5": "u", "\u00b7": "*", "\u2026": "..."})
_LONGEST = 10_000  # characters of a line: the command to resume a search of many files has some thousand


def out(text: str, *, is_drawn: bool = False) -> None:
    """Print text to standard output. is_drawn: whether the text is already escaped. Raises WrongUse if the text cannot
    be written.
    """
    if error := _written(text, sys.stdout, is_drawn=is_drawn):
        raise WrongUse(f"standard output cannot be written ({error.strerror or error}): redirect it to a file")


class _Quiet:
    """The state of --quiet: whether the running command prints only the answer."""

    wanted = False


def be_quiet(wanted: bool) -> None:
    """Suppress the output of `detail` and `note`, tables and progress if `wanted`; otherwise enable it."""
    _Quiet.wanted = wanted
    logging.getLogger("ga").setLevel(logging.ERROR if wanted else logging.NOTSET)


def is_quiet() -> bool:
    """Return whether this command prints only the answer."""
    return _Quiet.wanted


def detail(text: str) -> None:
    """Print a line below the answer to standard output. Raises WrongUse if it cannot be written."""
    if not is_quiet():
        out(text)


def note(text: str) -> None:
    """Print a message about the work, apart from the answer, to standard error. Never raises."""
    if not is_quiet():
        say(text)


def say(text: str) -> None:
    """Print a line to standard error, so that it does not mix with the command's data. Never raises an error."""
    with suppress(Exception):
        _written("\n".join(map(_cut, text.split("\n"))), sys.stderr)


def _cut(line: str) -> str:
    """Return a line shortened to a length that a terminal can show: a name in a file may be a megabyte long."""
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]}... ({len(line) - _LONGEST} more characters)"


def _encodable(text: str, encoding: str | None) -> str:
    """Return text in which the characters that a terminal's encoding lacks are spelled out or escaped."""
    try:
        text.encode(encoding or "utf-8")
    except UnicodeEncodeError as error:
        return text.translate(_SPELLED).encode(error.encoding, "backslashreplace").decode(error.encoding)
    return text


def _written(text: str, stream: TextIO | None, *, is_drawn: bool = False) -> OSError | None:
    """Print to `stream`; return the error if the text cannot be written. stream: None if it was closed before the
    start.

    is_drawn: whether the text is already escaped and has colours. After an error the output is redirected to nowhere;
    otherwise the interpreter's last flush would fail too. A reader that has closed the pipe (`hil inspect a.h5 | head
    -1`) is no error.
    """
    if stream is None:
        return None
    try:
        print(_encodable(text if is_drawn else printable(text), stream.encoding), file=stream, flush=True)
    except OSError as error:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        return None if isinstance(error, BrokenPipeError) else error
    return None


def out_section(section: Section) -> None:
    """Print a section below the answer to standard output."""
    if section.rows and not is_quiet():
        _out_table(section)
    for line in section.lines:
        detail(line)


def _out_table(section: Section) -> None:
    """Print the table of a section; on a narrow terminal, where words would be broken, as records."""
    from rich.console import Console
    from rich.segment import Segments

    console = Console()
    widths = _widths(section.rows, console.width - 3 * len(section.rows[0]) - 1)
    if not widths:
        out("\n".join(_as_records(section.heading, section.rows)))
        return
    with console.capture() as drawn:
        parts = [one._replace(text=printable(one.text)) for one in console.render(_drawn(section, widths))]
        console.print(Segments(parts), end="")
    out(drawn.get().rstrip("\n"), is_drawn=True)


def _drawn(section: Section, widths: Sequence[int]) -> Table:
    """Return a table without ruled lines, or in a frame if it has no headings; a column with a heading is aligned to
    the right.
    """
    from rich.box import HEAVY_HEAD, SIMPLE
    from rich.table import Table
    from rich.text import Text

    headings, *rows = section.rows
    plain = any(headings)
    # Text, not markup: "[red]" in a file's name is no colour
    table = Table(
        title=Text(section.heading), box=SIMPLE if plain else HEAVY_HEAD, pad_edge=not plain, show_header=plain
    )
    for heading, width in zip(headings, widths, strict=True):
        table.add_column(heading, justify="right" if heading else "left", overflow="fold", width=width)
    for after, row in zip(reversed(range(len(rows))), rows, strict=True):
        table.add_row(*map(Text, row), end_section=0 < after == section.apart)
    return table


def _widths(rows: Sequence[Sequence[str]], room: int) -> list[int]:
    """Return the width of each column, so that all columns fit into `room` characters and no word is broken; [] if that
    is impossible.
    """
    cells = [[line for cell in column for line in cell.splitlines()] for column in zip(*rows, strict=True)]
    least = [max((len(word) for line in lines for word in line.split()), default=0) for lines in cells]
    widths = [max(map(len, lines), default=0) for lines in cells]
    while sum(widths) > room:
        spare = [width - word for width, word in zip(widths, least, strict=True)]
        if max(spare) <= 0:
            return []
        widths[spare.index(max(spare))] -= 1
    return widths


def _as_records(title: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a table for a narrow terminal: for each row, one line with heading and value for each column."""
    headings, *records = rows
    lines = [title] if title else []
    for first, *others in records:
        lines.append(f"{headings[0]}: {first}" if headings[0] else first)
        pairs = zip(headings[1:], others, strict=True)
        lines += [f"  {heading}: {cell}" if heading else f"  {cell}" for heading, cell in pairs if cell]
    return lines


def asking(*, yes: bool) -> Callable[[str], object] | None:
    """Return `ask_to_go_on`; None with --yes, and where nobody can answer, such as in a service."""
    return ask_to_go_on if _is_terminal(sys.stdin) and not yes else None


def ask_to_go_on(announcement: str) -> None:
    """Print what will happen, and wait for a yes. Raises Declined for any other answer, also if the input has ended."""
    stream = sys.stdout if _is_terminal(sys.stdout) and not _is_terminal(sys.stderr) else sys.stderr
    _written(announcement + ("\nGo on? [y/N]" if _is_terminal(sys.stdin) else ""), stream)
    answer = "" if sys.stdin is None else sys.stdin.readline()
    if answer.strip().lower() not in {"y", "yes"}:
        raise Declined("nothing was driven: answer y, or add --yes in a script")


def _is_terminal(stream: TextIO | None) -> bool:
    return stream is not None and stream.isatty()


def print_json(table: dict[str, Any]) -> None:
    """Print one JSON object to standard output. Raises ValueError for a NaN, which JSON cannot hold."""
    out(json.dumps(table, indent=2, allow_nan=False, default=str))


def print_diagnostics(diagnostics: Sequence[Diagnostic]) -> None:
    """Print every warning and error with its code to standard error."""
    for diagnostic in diagnostics:
        say(f"{diagnostic.severity} [{diagnostic.code}]: {diagnostic.message}")


def exit_interrupted(checkpoint: Path | None) -> NoReturn:
    """Print how to resume an interrupted search, and end the command with the exit status for that."""
    if checkpoint is None:
        say("interrupted: progress was not saved; use --checkpoint to be able to resume")
    else:
        say(f"interrupted: {checkpoint} holds the progress; resume with: {command_line()}")
    raise typer.Exit(INTERRUPTED)


def command_line() -> str:
    """Return the command as it was typed."""
    return shlex.join(["hil", *sys.argv[1:]])
