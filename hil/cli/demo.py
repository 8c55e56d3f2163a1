"""`hil demo` and `hil replicate`: the main job, and the paper's experiment, on the simulated servo."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.identify import identify_and_show
from hil.cli.progress import progress
from hil.cli.record import answer_for, told
from hil.cli.terminal import LARGEST_SEED, Checkpoint, Json, out, print_json, say, tell, tell_interrupted


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="The folder to write into.")] = Path("hil-demo"),
) -> None:
    """Run the main job on the simulated servo: record a chirp, identify, write the report."""
    from drivers.servo import Quantity
    from ga.evolution.evolution import PRESETS
    from hil.acquisition import excitation
    from hil.acquisition.run import run
    from hil.identification.identify import Search
    from hil.recording.output import check_target, next_free
    from hil.report.identification import page_files
    from hil.stand.file import SIMULATED, parse

    stand = parse(SIMULATED)
    path = next_free(output)
    for made_later in page_files(path.with_suffix(".html")):
        check_target(made_later, force=False)
    made = excitation.make(
        "chirp",
        Quantity.TORQUE,
        amplitude=None,
        default_amplitude=stand.checked_limits().torque / 5.0,
        duration=20.0,
        band=None,
        rate=500.0,
        seed=1,
    )
    out("Recording a 20 s chirp, 0.1 to 15 Hz, on the simulated joint ...")
    path, outcome = run(
        stand, made, rate=500.0, seed=1, note="hil demo", command_line="hil demo", output=path, alarm=say
    )
    out(told(path, outcome))
    answer_for(outcome)
    search = Search("default", PRESETS["default"], trials=None, seed=0, workers=os.cpu_count() or 1, bounds={})
    out("Identifying ...")
    identify_and_show([path], None, search, path.with_suffix(".html"), as_json=False)
    out(f"The recording is {path}; look at it with: hil inspect {path}")
    out("Its true values are in its /truth group: Kc 17.75 mN m/rad, Bc 0.19 mN m s/rad.")


def replicate(
    evaluations: Annotated[int, typer.Option(min=1, help="Of each trial; the paper's is 200000000.")] = 2_000_000,
    trials: Annotated[int, typer.Option(min=1, help="Independent searches.")] = 30,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Of the simulated stand and of the search.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; all cores otherwise.")] = None,
    checkpoint: Checkpoint = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="The folder to write into.")] = Path("hil-replicate"),
    as_json: Json = False,
) -> None:
    """Repeat the paper's experiment on the simulated stand: Table 1 and Figure 8.

    Ctrl-C keeps the search in the output folder, where no --checkpoint says otherwise; the same command goes on with
    it.
    """
    from hil.identification import replicate as experiment

    kept = checkpoint or output / f"search-{trials}x{evaluations}-seed{seed}.npz"
    with progress() as note:
        done = experiment.replicate(
            output,
            evaluations=evaluations,
            trials=trials,
            seed=seed,
            workers=workers or os.cpu_count() or 1,
            checkpoint=kept,
            progress=note,
        )
    interrupted = done.identification.trials.interrupted
    if checkpoint is None and not interrupted:
        kept.unlink(missing_ok=True)
    recording = done.identification.recordings[0]
    picture = recording.with_suffix(".png")
    experiment.draw_convergence(done, picture)
    if as_json:
        print_json(experiment.as_json(done))
    else:
        for line in experiment.table(done):
            out(line)
        out(
            f"{done.identification.trials.made:.3g} evaluations in {done.identification.search_seconds:.1f} s: "
            f"{done.evaluations_per_second:.3g} a second, {done.ratio_to_numpy:.0f} times NumPy on one core"
        )
    say(f"wrote {recording} and {picture} (Figure 8)")
    tell(done.identification.diagnostics)
    if interrupted:
        tell_interrupted(kept)
