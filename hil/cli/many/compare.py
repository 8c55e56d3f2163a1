"""`hil compare`: several recordings of one joint side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import UNTRUSTWORTHY, command_line, note, out, out_section, print_diagnostics, print_json


def compare(
    recordings: Annotated[list[Path], typer.Argument(help="Two or more recordings of one joint on one stand.")],
    first: options.From = None,
    last: options.To = None,
    model: options.Model = "auto",
    trials: Annotated[int | None, typer.Option(min=1, help="Independent searches for each recording.")] = None,
    seed: options.Seed = options.DEFAULT_SEED,
    workers: options.Workers = options.ALL_CORES,
    report: Annotated[Path | None, typer.Option(help="Also write a report (HTML).")] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Check whether Kc and Bc repeat from recording to recording, and whether they drift."""
    from hil.api import analysis
    from hil.report.comparison import comparison_section

    options.check_report(report, recordings, force=force)
    with progress() as show:
        found = analysis.compare(
            recordings, start=first, end=last, model=model, trials=trials, seed=seed, workers=workers, progress=show
        )
    if as_json:
        print_json(found.as_json())
    else:
        out(str(found))
    print_diagnostics(found.diagnostics)
    if not as_json:
        out_section(comparison_section(found.comparison))
    if report is not None:
        note(f"wrote {found.report(report, command_line(), force=force)}")
    if not found.trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)
