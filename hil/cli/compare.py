"""`hil compare`: several recordings of one joint side by side."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.identify import chosen_model
from hil.cli.progress import progress
from hil.cli.terminal import UNTRUSTWORTHY, Force, Json, out, out_table, print_json, say, tell


def compare(
    recordings: Annotated[list[Path], typer.Argument(help="Two or more recordings of one joint on one stand.")],
    model: Annotated[str, typer.Option(help="As for hil identify; the same for all.")] = "linear",
    trials: Annotated[int, typer.Option(min=1, help="Independent searches of each recording.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the search.")] = 0,
    picture: Annotated[Path | None, typer.Option(help="Also draw the recordings side by side (PNG).")] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Say whether Kc and Bc repeat from recording to recording, and whether they drift."""
    from ga.evolution.evolution import PRESETS
    from hil.identification import compare as engine
    from hil.identification.identify import Search
    from hil.recording.output import check_target
    from hil.report.comparison import as_json as to_json
    from hil.report.comparison import comparison_table, draw

    if picture is not None:
        check_target(picture, force=force)
    chosen = chosen_model(model)
    workers = os.cpu_count() or 1
    search = Search("default", PRESETS["default"], trials=trials, seed=seed, workers=workers, bounds={})
    with progress() as done:
        found = engine.compare(recordings, chosen, search, done)
    if as_json:
        print_json(to_json(found))
    else:
        out_table(comparison_table(found))
        for parameter in found.parameters:
            out(parameter.verdict)
    if picture is not None:
        draw(found, picture)
        say(f"wrote {picture}")
    tell(found.diagnostics)
    if not found.trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)
