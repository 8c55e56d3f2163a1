"""`hil demo`: the main job on the simulated servo."""

from __future__ import annotations

from pathlib import Path

from drivers.servo import Quantity
from hil.cli.identify import identify_and_show, search_of
from hil.cli.options import DEFAULT_RATE, DEFAULT_SEED, Folder, excitation_of, stand_of
from hil.cli.record import check_outcome, outcome_line
from hil.cli.terminal import out, say


def demo(output: Folder = Path("hil-demo")) -> None:
    """Run the main job on the simulated servo: record a chirp, identify, write the report."""
    from hil.acquisition.run import run
    from hil.recording.output import check_output, next_free
    from hil.report.identification import page_files

    stand = stand_of("sim", None)
    path = next_free(output)
    for later in page_files(path.with_suffix(".html")):
        check_output(later, force=False)
    out("Recording a 20 s chirp, 0.1 to 15 Hz, on the simulated joint ...")
    path, outcome = run(
        stand,
        excitation_of(stand, "chirp", Quantity.TORQUE),
        rate=DEFAULT_RATE,
        seed=DEFAULT_SEED,
        note="hil demo",
        command_line="hil demo",
        output=path,
        alarm=say,
    )
    out(outcome_line(path, outcome))
    check_outcome(outcome)
    out("Identifying ...")
    identify_and_show([path], None, search_of(), path.with_suffix(".html"))
    out(f"The recording is {path}; look at it with: hil inspect {path}")
    out("Its true values are in its /truth group: Kc 17.75 mN m/rad, Bc 0.19 mN m s/rad.")
