"""`hil report`: many recordings in one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import UNTRUSTWORTHY, command_line, out, say


def report(
    recordings: Annotated[list[Path], typer.Argument(help="The recordings, each identified on its own.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The page to write (HTML).")],
    model: options.Model = "auto",
    seed: options.Seed = options.DEFAULT_SEED,
    workers: options.Workers = options.ALL_CORES,
    force: options.Force = False,
) -> None:
    """Join many recordings in one page: Kc and Bc of each, its fit, and the warnings."""
    from hil.api.analysis import identify_each
    from hil.api.results import NoResult
    from hil.recording.output import check_output
    from hil.report.html_page import check_page_name
    from hil.report.joined_page import Entry, verdict, write_page

    check_output(check_page_name(output), force=force, inputs=recordings)
    with progress() as show:
        found = identify_each(recordings, model, seed=seed, workers=workers, progress=show)
    entries = [
        Entry(path, None, str(one), one.as_json()) if isinstance(one, NoResult) else Entry(path, one.identification)
        for path, one in zip(recordings, found, strict=True)
    ]
    write_page(entries, output, command_line(), force=force)
    out(verdict(entries))
    say(f"wrote {output}")
    if not all(entry.trusted for entry in entries):
        raise typer.Exit(UNTRUSTWORTHY)
