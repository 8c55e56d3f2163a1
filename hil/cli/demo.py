"""`hil demo`: record, identify and report on the simulated servo."""

from __future__ import annotations

from pathlib import Path

import typer

from hil.cli import options
from hil.cli.identify import publish
from hil.cli.progress import progress
from hil.cli.record import record
from hil.cli.terminal import UNTRUSTWORTHY, detail, out
from hil.printable import quoted


def demo(output: options.Folder = Path("hil-demo")) -> None:
    """Run the main job on the simulated servo: record a chirp, identify, write the report, compare with the truth."""
    from hil.recording.output import check_output, next_free

    path = next_free(output)
    page = path.with_suffix(".html")
    check_output(page, force=False)
    detail("1 of 3: recording a 20 s chirp, 0.1 to 15 Hz, on the simulated joint; the first run compiles it first ...")
    from hil.api.analysis import identify
    from hil.api.recordings import load
    from hil.report.identification import truth_lines

    record(backend="sim", note="hil demo", output=path)
    detail("2 of 3: identifying stiffness and damping ...")
    with progress() as show:
        found = identify(path, progress=show)
    detail("3 of 3: writing the report ...")
    publish(found, page)
    for line in truth_lines(found.identification, load(path).truth):
        out(line)
    detail(f"The recording is {path}; look at it with: hil inspect {quoted(path)}")
    if not found.trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)
