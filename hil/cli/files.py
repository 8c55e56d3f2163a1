"""`hil inspect`, `hil import`, `hil recover`: what is done with files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.terminal import UNTRUSTWORTHY, Force, Json, Output, command_line, out, out_table, print_json, tell
from hil.errors import WrongUse


def inspect(
    recording: Annotated[Path, typer.Argument(help="A recording, finished or not.")], as_json: Json = False
) -> None:
    """Say what a recording holds and whether it can be used."""
    from hil.inspection import inspect as look
    from hil.report import inspection_json, inspection_table

    seen = look(recording)
    if as_json:
        print_json(inspection_json(seen))
    else:
        out_table(inspection_table(seen))
        out("usable" if seen.usable else "not usable")
    tell(seen.findings)
    if not seen.usable:
        raise typer.Exit(UNTRUSTWORTHY)


def import_data(
    source: Annotated[Path, typer.Argument(help="CSV or .csv.gz with a header line.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The recording to write.")],
    time: Annotated[str, typer.Option(help="Column of the time.")],
    torque: Annotated[str | None, typer.Option(help="Column of the torque at the joint.")] = None,
    dtheta: Annotated[str | None, typer.Option(help="Column of the deflection.")] = None,
    dtheta_dot: Annotated[str | None, typer.Option(help="Column of its rate; else from the deflection.")] = None,
    motor_torque: Annotated[str | None, typer.Option(help="Column of the motor's torque (with --stand).")] = None,
    motor_position: Annotated[str | None, typer.Option(help="Column of the motor's position (with --stand).")] = None,
    time_unit: Annotated[str, typer.Option(help="s, ms, us, ns.")] = "s",
    torque_unit: Annotated[str, typer.Option(help="N*m, mN*m, N*cm, kgf*cm, ...; of either torque.")] = "N*m",
    dtheta_unit: Annotated[str, typer.Option(help="rad, mrad, deg, rev; of deflection or motor position.")] = "rad",
    dtheta_dot_unit: Annotated[str, typer.Option(help="rad/s, deg/s, rev/s, rpm.")] = "rad/s",
    where: Annotated[list[str] | None, typer.Option(help="Keep rows: 'test_nr==100'; may be repeated.")] = None,
    stand: Annotated[Path | None, typer.Option(help="The stand file the data was made on.")] = None,
    force: Force = False,
) -> None:
    """Bring a CSV file into a recording."""
    from hil.importer import Column, Condition, import_csv
    from hil.stand import load
    from hil.target import check_part, check_target

    check_target(output, force=force, inputs=[source] if stand is None else [source, stand])
    check_part(output)
    named = {
        "time": (time, time_unit),
        "torque": (torque, torque_unit),
        "dtheta": (dtheta, dtheta_unit),
        "dtheta_dot": (dtheta_dot, dtheta_dot_unit),
        "motor_torque": (motor_torque, torque_unit),
        "motor_position": (motor_position, dtheta_unit),
    }
    count = import_csv(
        source,
        output,
        {channel: Column(name, unit) for channel, (name, unit) in named.items() if name is not None},
        [Condition.parse(text) for text in where or ()],
        stand=None if stand is None else load(stand),
        command_line=command_line(),
    )
    out(f"{output}: {count} samples")


def recover(
    part: Annotated[Path, typer.Argument(help="A recording that never ended: NAME.h5.part.")],
    output: Output = None,
    force: Force = False,
) -> None:
    """Turn a left-over .part into a finished recording; the .part is not touched."""
    from hil.part import finalise
    from hil.target import check_target

    if output is None and part.suffix != ".part":
        raise WrongUse(f"{part} does not end in .part: name the output with -o")
    target = output or part.with_suffix("")
    check_target(target, force=force, inputs=[part])
    rows = finalise(part, target)
    out(f"{target}: {rows} samples recovered; {part} is still there")
