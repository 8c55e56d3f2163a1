"""`hil hysteresis`: stiffness, lost motion, play and loss from slow torsion tests."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli import options
from hil.cli.terminal import command_line, detail, note, out, out_section, print_json
from hil.errors import WrongUse, decimal_comma

_PARTS = (
    "LOW:HIGH, N m or with a unit: where stiffness is taken; repeat for several [default: 0 to 15 and 15 to 100 %]."
)


def hysteresis(
    runs: Annotated[list[Path], typer.Argument(help="Recordings, or tables of torque and angle, of one joint.")],
    rated: Annotated[
        float | None, options.measured("--rated", "torque", "The gear's rated torque [default: the torque reached].")
    ] = None,
    part: Annotated[list[str] | None, typer.Option(metavar="LOW:HIGH", help=_PARTS)] = None,
    lost_motion: Annotated[
        float | None, options.measured("--lost-motion", "torque", "Its torque [default: 3 % of the rated torque].")
    ] = None,
    torque: Annotated[str | None, typer.Option(help="Column of the torque in a table.")] = None,
    dtheta: Annotated[str | None, typer.Option(help="Column of the angle in a table.")] = None,
    torque_unit: Annotated[str | None, typer.Option(help="N*m, mN*m, ... [default: the heading's].")] = None,
    dtheta_unit: Annotated[str | None, typer.Option(help="rad, deg, rev [default: the heading's].")] = None,
    report: Annotated[Path | None, typer.Option(help="Also write a report (HTML).")] = None,
    plot: Annotated[Path | None, typer.Option(help="Also draw the loops (PNG) into this folder.")] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Measure stiffness, lost motion, hysteresis, play and loss of slow torsion tests. Bc cannot come from them."""
    from hil.api.hysteresis import hysteresis as measure
    from hil.report.loops.hysteresis import marked, notes, tables
    from hil.report.pictures.files import check_pictures, save_picture

    options.check_report(report, runs, force=force)
    if plot is not None:
        check_pictures(plot, ["hysteresis.png"], force=force)
    found = measure(
        runs,
        rated=rated,
        parts=[_part(text) for text in part or ()],
        lost_motion=lost_motion,
        torque=torque,
        dtheta=dtheta,
        torque_unit=torque_unit,
        dtheta_unit=dtheta_unit,
    )
    if as_json:
        print_json(found.as_json())
    else:
        out(str(found))
        for table in tables(found.measures):
            out_section(table)
        for line in [*marked(found.measures), *notes(found.torque_scale)]:
            detail(line)
    if report is not None:
        note(f"wrote {found.report(report, command_line(), force=force)}")
    if plot is not None:
        save_picture(found.plot(), plot / "hysteresis.png", force=force)
        note(f"wrote {plot / 'hysteresis.png'}")


def _part(text: str) -> tuple[float, float]:
    """Return a part of the torque's range, N m. Raises WrongUse."""
    try:
        low, high = options.span_of(text, "torque")
    except WrongUse:
        low = high = 0.0
    if not 0.0 <= low < high:
        remedy = decimal_comma(text) or ": write LOW:HIGH in N m or with a unit, such as 0:7 or 2:7N*m"
        raise WrongUse(f"--part {text!r}{remedy}")
    return low, high
