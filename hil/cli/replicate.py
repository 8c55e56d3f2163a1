"""`hil replicate`: the paper's experiment on the simulated stand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import exit_interrupted, note, out, print_diagnostics, print_json


def replicate(
    evaluations: Annotated[int, typer.Option(min=1, help="For each trial; the paper has 200000000.")] = 2_000_000,
    trials: Annotated[int, typer.Option(min=1, help="Independent searches.")] = 30,
    seed: options.Seed = options.DEFAULT_SEED,
    workers: options.Workers = options.ALL_CORES,
    checkpoint: options.Checkpoint = None,
    output: options.Folder = Path("hil-replicate"),
    as_json: options.Json = False,
) -> None:
    """Repeat the paper's experiment on the simulated stand: Table 1 and Figure 8.

    Ctrl-C saves the search to the output folder (or to --checkpoint); the same command resumes it.
    """
    from hil.identification.replicate import replicate as run_replication
    from hil.recording.output import check_folder
    from hil.report.replication import as_json as to_json
    from hil.report.replication import replication_lines, write_page

    check_folder(output)
    saved = checkpoint or output / f"search-{trials}x{evaluations}-seed{seed}.npz"
    with progress() as show:
        done = run_replication(
            output,
            evaluations=evaluations,
            trials=trials,
            seed=seed,
            workers=workers,
            checkpoint=saved,
            progress=show,
        )
    interrupted = done.identification.trials.interrupted
    if checkpoint is None and not interrupted:
        saved.unlink(missing_ok=True)
    recording = done.identification.recordings[0]
    page = recording.with_suffix(".html")
    write_page(done, page)
    if as_json:
        print_json(to_json(done))
    else:
        for line in replication_lines(done):
            out(line)
        out(
            f"{done.identification.trials.made:.3g} evaluations in {done.identification.search_seconds:.1f} s: "
            f"{done.evaluations_per_second:.3g} per second, {done.ratio_to_numpy:.0f} times NumPy on one core"
        )
    note(f"wrote {recording} and {page} (Figure 8)")
    print_diagnostics(done.identification.diagnostics)
    if interrupted:
        exit_interrupted(saved)
