"""`hil demo`: the main job on the simulated servo."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.identification import identify_and_show


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="The folder to write into.")] = Path("hil-demo"),
) -> None:
    """Run the main job on the simulated servo: record a chirp, identify, write the report."""
    from drivers.servo import Quantity
    from ga.evolution import PRESETS
    from ga.models import parse as parse_model
    from hil import profiles
    from hil.identify import Search
    from hil.run import run
    from hil.stand import SIMULATED, parse
    from hil.target import next_free

    stand = parse(SIMULATED)
    path = next_free(output)
    made = profiles.make(
        "chirp",
        Quantity.TORQUE,
        amplitude=None,
        default_amplitude=stand.checked_limits().torque / 5.0,
        duration=20.0,
        band=None,
        rate=500.0,
        seed=1,
    )
    print("Recording a 20 s chirp, 0.1 to 15 Hz, on the simulated joint ...")
    path, outcome = run(stand, made, rate=500.0, seed=1, note="hil demo", command_line="hil demo", output=path)
    print(f"{path}: {outcome.samples} samples, {outcome.lost} lost")
    search = Search("default", PRESETS["default"], trials=30, seed=0, workers=os.cpu_count() or 1, bounds={})
    print("Identifying ...")
    identify_and_show([path], parse_model("linear"), search, path.with_suffix(".html"), as_json=False)
    print(f"The recording is {path}; look at it with: hil inspect {path}")
    print("Its true values are in its /truth group: Kc 17.75 mN m/rad, Bc 0.19 mN m s/rad.")
