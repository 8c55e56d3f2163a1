"""`hil demo`: the main job on the simulated servo."""

from __future__ import annotations

from pathlib import Path

from hil.cli import options
from hil.cli.identify import identify
from hil.cli.record import record
from hil.cli.terminal import out


def demo(output: options.Folder = Path("hil-demo")) -> None:
    """Run the main job on the simulated servo: record a chirp, identify, write the report."""
    from hil.recording.output import check_output, next_free

    path = next_free(output)
    page = path.with_suffix(".html")
    check_output(page, force=False)
    out("Recording a 20 s chirp, 0.1 to 15 Hz, on the simulated joint ...")
    record(backend="sim", note="hil demo", output=path)
    out("Identifying ...")
    identify([path], report=page)
    out(f"The recording is {path}; look at it with: hil inspect {path}")
    out("Its true values are in its /truth group: Kc 17.75 mN m/rad, Bc 0.19 mN m s/rad.")
