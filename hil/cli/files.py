"""`hil inspect`, `hil view`, `hil import`, `hil export`, `hil recover`: the commands that work on files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import UNTRUSTWORTHY, command_line, detail, note, out, out_table, print_diagnostics, print_json
from hil.errors import WrongUse

if TYPE_CHECKING:
    from hil.diagnostics import Diagnostic
    from hil.exchange.importer import Column, Imported


def inspect(
    recording: Annotated[Path, typer.Argument(help="A recording, finished or not.")],
    first: options.From = None,
    last: options.To = None,
    plot: options.Plot = None,
    force: options.Force = False,
    as_json: options.Json = False,
    verify: Annotated[bool, typer.Option("--verify", help="Only check that the file is as it was written.")] = False,
) -> None:
    """Summarise a recording and check its quality, after a check that the file is as it was written."""
    from hil.api.recordings import load
    from hil.recording.interval import between
    from hil.recording.output import check_output
    from hil.report.inspection import as_json as to_json
    from hil.report.inspection import inspection_table
    from hil.report.pictures.files import make_picture_folder, save_picture
    from hil.signals.inspection import inspect as look

    if verify and (first, last) != (None, None):
        raise WrongUse("--verify checks the whole file: leave out --from and --to")
    if verify:
        _verify(recording, as_json=as_json)
        return
    if plot is not None:
        drawn = plot / f"{recording.stem}.png"
        make_picture_folder(plot)
        check_output(drawn, force=force)
        save_picture(load(recording, start=first, end=last).plot(), drawn, force=force)
        note(f"wrote {drawn}")
    with progress() as show:
        [part] = between([recording], first, last)
        seen = look(part, show)
    if as_json:
        print_json(to_json(seen))
    else:
        out("usable" if seen.usable else "not usable")
    print_diagnostics(seen.diagnostics)
    if not as_json:
        out_table(inspection_table(seen))
    if not seen.usable:
        raise typer.Exit(UNTRUSTWORTHY)


def view(
    recording: Annotated[Path, typer.Argument(help="A recording, finished or not.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="A file .rrd in place of a window.")] = None,
    force: options.Force = False,
) -> None:
    """Open a recording in the window of Rerun, or write it into a file that Rerun opens (pip install 'hil[view]').

    Example: hil view run1.h5
    """
    from hil.api.recordings import load
    from hil.live import rerun

    place = rerun.WINDOW if output is None else str(output)
    loaded = load(recording)
    rerun.check(place, force=force)
    rerun.show(loaded.filled, place)
    out(f"{recording}: shown in {'a window of Rerun' if output is None else output}")


def _verify(path: Path, *, as_json: bool) -> None:
    from hil.recording.reader import Recording

    with Recording(path) as recording:
        intact, rows, damaged = recording.verify(), len(recording), recording.damaged
    if as_json:
        table = {"schema": "hil-verify/1", "recording": str(path), "intact": intact, "samples": rows}
        print_json(table | {"damaged": damaged})
    else:
        out(f"{path}: {rows} samples, " + ("as they were written" if intact else "not as they were written"))
    print_diagnostics(_damage(path, damaged, trusted=intact or bool(damaged)))
    if not intact:
        raise typer.Exit(UNTRUSTWORTHY)


def import_data(
    source: Annotated[Path, typer.Argument(help="CSV, .xlsx, .parquet, .h5, .mat, .npz, JSON, .tdms; a ROS bag.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The recording to write.")],
    time: Annotated[str | None, typer.Option(help="Column of the time; not needed for a file of hil export.")] = None,
    torque: Annotated[str | None, typer.Option(help="Column of the torque at the joint.")] = None,
    dtheta: Annotated[str | None, typer.Option(help="Column of the deflection, or 'motor/20 - joint'.")] = None,
    dtheta_dot: Annotated[str | None, typer.Option(help="Column of its rate [default: from the deflection].")] = None,
    motor_torque: Annotated[str | None, typer.Option(help="Column of the motor's torque (with --stand).")] = None,
    motor_position: Annotated[str | None, typer.Option(help="Column of the motor's position (with --stand).")] = None,
    command: Annotated[str | None, typer.Option(help="Column of the set-point; Kc and Bc are surer with it.")] = None,
    time_unit: Annotated[str | None, typer.Option(help="s, ms, us, ns [default: the heading's].")] = None,
    torque_unit: Annotated[str | None, typer.Option(help="N*m, mN*m, kgf*cm, ...; of either torque.")] = None,
    dtheta_unit: Annotated[str | None, typer.Option(help="rad, deg, rev; of deflection or motor position.")] = None,
    dtheta_dot_unit: Annotated[str | None, typer.Option(help="rad/s, deg/s, rev/s, rpm.")] = None,
    command_unit: Annotated[str | None, typer.Option(help="N*m, rad, A, V, ...: what was commanded.")] = None,
    torque_code: Annotated[str | None, typer.Option(help="Raw numbers: wrap=65536 (16 bits), sign=1024.")] = None,
    dtheta_code: Annotated[str | None, typer.Option(help="The same for the angle.")] = None,
    torque_scale: Annotated[float, typer.Option(help="Multiply the torque; -1 inverts its sign.")] = 1.0,
    dtheta_scale: Annotated[float, typer.Option(help="Multiply the deflection or the motor position.")] = 1.0,
    dtheta_dot_scale: Annotated[float, typer.Option(help="Multiply the rate.")] = 1.0,
    command_scale: Annotated[float, typer.Option(help="Multiply the set-point.")] = 1.0,
    topic: Annotated[str | None, typer.Option(help="A bag's topic; a workbook's sheet.")] = None,
    joint: Annotated[str | None, typer.Option(help="The joint's name in the joint states.")] = None,
    where: Annotated[list[str] | None, typer.Option(metavar="FILTER", help="Rows to keep: 'nr==100'.")] = None,
    first: Annotated[str | None, typer.Option("--from", help="First time, as the file has it: 12.5, 12:30:00.")] = None,
    last: Annotated[str | None, typer.Option("--to", help="Last time.")] = None,
    join: Annotated[Path | None, typer.Option(help="A second file of the run, such as the torque cell's.")] = None,
    join_time: Annotated[str | None, typer.Option(help="Column of its time [default: as --time].")] = None,
    shared_clock: Annotated[bool, typer.Option("--shared-clock", help="Both files have one clock.")] = False,
    stand: options.StandFile = None,
    force: options.Force = False,
) -> None:
    """Make a recording from a table of another program, or from a file of hil export."""
    from hil.exchange.importer import import_table
    from hil.exchange.join import Join
    from hil.exchange.row_filter import RowFilter
    from hil.recording.output import check_output, check_recording_name, check_unfinished, recording_path
    from hil.stand.file import load

    inputs = [one for one in (source, stand, join) if one is not None]
    check_output(output := recording_path(output), force=force, inputs=inputs)
    check_unfinished(check_recording_name(output))
    done = import_table(
        source,
        output,
        _columns("time", (time_unit, 1.0), time=time)
        | _columns("torque", (torque_unit, torque_scale, torque_code), torque=torque, motor_torque=motor_torque)
        | _columns("dtheta", (dtheta_unit, dtheta_scale, dtheta_code), dtheta=dtheta, motor_position=motor_position)
        | _columns("dtheta-dot", (dtheta_dot_unit, dtheta_dot_scale), dtheta_dot=dtheta_dot)
        | _columns("command", (command_unit, command_scale), command=command),
        [RowFilter.parse(text) for text in where or ()],
        topic=topic,
        joint=joint,
        join=None if join is None else Join(join, join_time, shared_clock),
        between=(first, last),
        stand=None if stand is None else load(stand),
        command_line=command_line(),
        force=force,
    )
    _say_imported(output, done)


def _say_imported(output: Path, done: Imported) -> None:
    from hil.report.formatting import duration

    out(f"{output}: {done.samples} samples over {duration(done.duration)}; {done.ranges}")
    if done.units:
        detail("read " + ", ".join(f"{channel} in {unit}" for channel, unit in done.units.items()))
    if done.said:
        detail(done.said)
    print_diagnostics(done.diagnostics)


def _columns(
    option: str, given: tuple[str | None, float, *tuple[str | None, ...]], **names: str | None
) -> dict[str, Column]:
    """Return the column, with unit and scale, that each option names. Raises WrongUse for a unit without a column."""
    from hil.exchange.importer import Column

    found = {channel: Column(name, *given) for channel, name in names.items() if name is not None}
    if not found and {*given} != {None, 1.0}:
        columns = " or ".join(f"--{channel.replace('_', '-')}" for channel in names)
        raise WrongUse(f"--{option}-unit and --{option}-scale need a column: name it with {columns}")
    return found


def export_data(
    source: Annotated[Path, typer.Argument(help="A recording, or for a model also a result of identify --json.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".csv, .csv.gz, .parquet, .mat, .mcap; .xml, .urdf, .sdf, .h, .json.")
    ],
    form: Annotated[
        str | None,
        typer.Option("--format", help="csv, parquet, mat, mcap; mujoco, urdf, sdf, c, json [default: the name's]."),
    ] = None,
    first: options.From = None,
    last: options.To = None,
    force: options.Force = False,
) -> None:
    """Write a recording as a table, or its coupling as a model: MuJoCo, URDF, SDF, C or JSON.

    hil export run1.h5 -o run1.csv; hil export run1.h5 -o finger.xml
    """
    from hil.exchange.exporter import TABLES, export, format_of
    from hil.recording.interval import between
    from hil.recording.output import check_output

    chosen = format_of(output, form)
    check_output(output, force=force, inputs=[source])
    if chosen in TABLES:
        [part] = between([source], first, last)
        out(f"{output}: {export(part, output, force=force)} rows")
    else:
        _export_coupling(source, output, chosen, (first, last), force=force)


def _export_coupling(
    source: Path, output: Path, form: str, window: tuple[str | None, str | None], *, force: bool
) -> None:
    """Write the coupling from a result, or from a recording, which is identified first."""
    from hil.exchange.coupling import of_json, of_result
    from hil.exchange.exporter import export_coupling
    from hil.exchange.models import FORMATS

    if source.suffix.lower() == ".json":
        if window != (None, None):
            raise WrongUse(f"{source} is a result and has no rows: leave out --from and --to, or export the recording")
        found = of_result(source)
    else:
        from hil.api.analysis import identify

        with progress() as show:
            result = identify(source, start=window[0], end=window[1], progress=show)
        found = of_json(result.as_json(), str(source))
    export_coupling(found, output, force=force)
    out(f"{output}: Kc {found.stiffness:.5g} N m/rad, Bc {found.damping:.5g} N m s/rad ({found.model})")
    if not FORMATS[form].complete:
        print_diagnostics(found.left_out())


def recover(
    part: Annotated[Path, typer.Argument(help="An unfinished recording: NAME.h5.part.")],
    output: options.Output = None,
    force: options.Force = False,
) -> None:
    """Turn an unfinished .part file into a recording; the .part file is kept."""
    from hil.recording.final import finalise
    from hil.recording.output import check_ended, check_output, check_recording_name, recording_path
    from hil.recording.rescue import place_for

    if output is None and part.suffix != ".part":
        raise WrongUse(f"{part} does not end in .part: name the output with -o")
    target = recording_path(output or place_for(part.with_suffix("")))
    check_output(target, force=force, inputs=[part])
    check_recording_name(target)
    check_ended(part)
    done = finalise(part, target, force=force)
    read_only = "" if output or target.parent == part.parent else ", in a folder that cannot be written"
    out(f"{target}: {done.samples} samples recovered; {part} is still there{read_only}")
    print_diagnostics(_damage(part, done.damaged, trusted=done.trusted))
    if not done.trusted:
        raise typer.Exit(UNTRUSTWORTHY)


def _damage(path: Path, rows: int, *, trusted: bool) -> list[Diagnostic]:
    """Return the diagnostics of a file with `rows` damaged rows. trusted: whether the file's SHA-256 is as it was
    written.
    """
    from hil.diagnostics import Diagnostic

    found = []
    if rows:
        found.append(Diagnostic("damaged-rows", f"{path}: {rows} rows were damaged on the disk and count as lost"))
    if not trusted:
        message = (
            f"{path} is not as it was written (its SHA-256 differs), so no Kc or Bc can be identified from it: use "
            "another copy"
        )
        found.append(Diagnostic("changed", message, is_error=True))
    return found
