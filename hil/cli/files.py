"""`hil inspect`, `hil view`, `hil import`, `hil export`, `hil recover`: the commands that work on files."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import UNTRUSTWORTHY, command_line, detail, note, out, out_section, print_diagnostics, print_json
from hil.errors import WrongUse

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
    from hil.report.inspection import as_json as to_json
    from hil.report.inspection import inspection_section
    from hil.report.pictures.files import check_pictures, save_picture
    from hil.signals.inspection import inspect as look

    if verify and (first, last) != (None, None):
        raise WrongUse("--verify checks the whole file: leave out --from and --to")
    if verify:
        _verify(recording, as_json=as_json)
        return
    if plot is not None:
        drawn = plot / f"{recording.stem}.png"
        check_pictures(plot, [drawn.name], force=force)
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
        out_section(inspection_section(seen))
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
        intact, rows, damage = recording.verify(), len(recording), recording.damage
        damaged = recording.damaged
    if as_json:
        table = {"schema": "hil-verify/1", "recording": str(path), "intact": intact, "samples": rows}
        print_json(table | {"damaged": damaged})
    else:
        out(f"{path}: {rows} samples, " + ("as they were written" if intact else "not as they were written"))
    print_diagnostics(_damage(path, damage, trusted=intact or bool(damage)))
    if not intact:
        raise typer.Exit(UNTRUSTWORTHY)


def import_data(
    source: Annotated[Path, typer.Argument(help="CSV, .xlsx, .parquet, .h5, .mat, .npz, JSON, .tdms; a ROS bag.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The recording to write.")] = None,
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
    rate: options.EvenRate = None,
    topic: Annotated[str | None, typer.Option(help="A bag's topic; a workbook's sheet.")] = None,
    joint: Annotated[
        str | None, typer.Option(help="The joint's name in the joint states, and in a hand's file.")
    ] = None,
    where: Annotated[list[str] | None, typer.Option(metavar="FILTER", help="Rows to keep: 'nr==100'.")] = None,
    first: Annotated[str | None, typer.Option("--from", help="First time, as the file has it: 12.5, 12:30:00.")] = None,
    last: Annotated[str | None, typer.Option("--to", help="Last time.")] = None,
    join: Annotated[Path | None, typer.Option(help="A second file of the run, such as the torque cell's.")] = None,
    join_time: Annotated[str | None, typer.Option(help="Column of its time [default: as --time].")] = None,
    shared_clock: Annotated[bool, typer.Option("--shared-clock", help="Both files have one clock.")] = False,
    stand: options.StandFile = None,
    look: Annotated[bool, typer.Option("--look", help="Only show what is understood of the file.")] = False,
    force: options.Force = False,
) -> None:
    """Make a recording from a table of another program, or from a file of hil export; without -o show the table."""
    columns = (
        _columns("time", (time_unit, 1.0), time=time)
        | _columns("torque", (torque_unit, torque_scale, torque_code), torque=torque, motor_torque=motor_torque)
        | _columns("dtheta", (dtheta_unit, dtheta_scale, dtheta_code), dtheta=dtheta, motor_position=motor_position)
        | _columns("dtheta-dot", (dtheta_dot_unit, dtheta_dot_scale), dtheta_dot=dtheta_dot)
        | _columns("command", (command_unit, command_scale), command=command)
    )
    target = None if look or output is None else _checked(output, [source, stand, join], force=force)
    second = None if join is None else (join, join_time, shared_clock)
    more = {"rate": rate, "topic": topic, "joint": joint}
    done = _imported(source, target, columns, where or (), second, stand, more, between=(first, last), force=force)
    if target is not None and done is not None:
        _say_imported(target, done)


def _imported(
    source: Path,
    output: Path | None,
    columns: Mapping[str, Column],
    where: Sequence[str],
    join: tuple[Path, str | None, bool] | None,
    stand: Path | None,
    more: dict[str, Any],
    **written: Any,
) -> Imported | None:
    """Import a file; without `output` print what is understood of it. Raises WrongUse, whose message ends with that."""
    from hil.exchange.importer import import_table
    from hil.exchange.join import Join
    from hil.exchange.row_filter import RowFilter

    more["where"] = [RowFilter.parse(text) for text in where]
    more |= {"join": None if join is None else Join(*join), "stand": None}
    if stand is not None:
        more |= _stand_and_joint(stand, source, more["joint"])
    if output is None:
        out("\n".join(_looked(source, columns, more)))
        return None
    try:
        return import_table(source, output, columns, command_line=command_line(), **more, **written)
    except WrongUse as error:
        lines = list[str]()
        with suppress(WrongUse):
            lines = _looked(source, columns, more, refused=True)
        raise WrongUse("\n".join([str(error), *lines])) from None


def _stand_and_joint(path: Path, source: Path, joint: str | None) -> dict[str, Any]:
    """Return the stand, and the joint to look for in the source: only the file of a hand and a bag have joints."""
    from hil.exchange.readers.bags import is_bag
    from hil.hand.file import is_hand, load_stand
    from hil.recording.input import read_text
    from hil.stand.file import LARGEST

    of_a_hand = is_hand(read_text(path, largest=LARGEST))
    stand = load_stand(path, joint if of_a_hand else None)
    return {"stand": stand, "joint": None if of_a_hand and not is_bag(source) else joint}


def _looked(
    source: Path, columns: Mapping[str, Column], more: Mapping[str, Any], *, refused: bool = False
) -> list[str]:
    """Return what is understood of a file, in lines."""
    from hil.exchange.look import look

    return look(source, columns, refused=refused, **more)


def _checked(output: Path, inputs: Sequence[Path | None], *, force: bool) -> Path:
    """Return the recording to write. Raises WrongUse if it may not be written."""
    from hil.recording.output import check_output, check_recording_name, check_unfinished, recording_path

    check_output(output := recording_path(output), force=force, inputs=[one for one in inputs if one is not None])
    check_unfinished(check_recording_name(output))
    return output


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
    source: Annotated[
        Path, typer.Argument(help="A recording; for a model a result of identify --json; a hand's folder.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".csv, .csv.gz, .parquet, .mat, .mcap; .xml, .urdf, .sdf, .h, .json.")
    ],
    form: Annotated[
        str | None,
        typer.Option("--format", help="csv, parquet, mat, mcap; mujoco, urdf, sdf, c, json [default: the name's]."),
    ] = None,
    into: Annotated[
        Path | None, typer.Option("--into", help="The hand's own MuJoCo model or URDF, for the folder of hil hand.")
    ] = None,
    first: options.From = None,
    last: options.To = None,
    force: options.Force = False,
) -> None:
    """Write a recording as a table, or its coupling as a model: MuJoCo, URDF, SDF, C or JSON; a hand into its model.

    hil export run1.h5 -o run1.csv; hil export run1.h5 -o finger.xml; hil export hand --into hand.xml -o identified.xml
    """
    from hil.exchange.exporter import TABLES, export, format_of
    from hil.recording.interval import between
    from hil.recording.output import check_output

    chosen = format_of(output, form)
    check_output(output, force=force, inputs=[source, *([] if into is None else [into])])
    if source.is_dir():
        _export_hand(source, into, output, chosen, force=force)
    elif into is not None:
        raise WrongUse(f"{source} is no folder of hil hand, and only a hand is exported into a model: leave out --into")
    elif chosen in TABLES:
        [part] = between([source], first, last)
        out(f"{output}: {export(part, output, force=force)} rows")
    else:
        _export_coupling(source, output, chosen, (first, last), force=force)


def _export_hand(folder: Path, into: Path | None, output: Path, form: str, *, force: bool) -> None:
    """Write the hand in a folder of results; a motor without a trusted Kc and Bc is left out, with exit status 1."""
    from hil.exchange.hands import formats

    motors, missing = formats.known(folder)
    said = formats.write(motors, into, output, form, force=force)
    out(f"{output}: {len(motors)} motors of {len(motors) + len(missing)}")
    print_diagnostics([*missing, *said])
    if missing:
        raise typer.Exit(UNTRUSTWORTHY)


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
    print_diagnostics(_damage(part, done.damage, trusted=done.trusted))
    if not done.trusted:
        raise typer.Exit(UNTRUSTWORTHY)


def _damage(path: Path, damage: str, *, trusted: bool) -> list[Diagnostic]:
    """Return the diagnostics of a file. damage: its `Recording.damage`. trusted: whether its SHA-256 is as it was
    written.
    """
    from hil.diagnostics import Diagnostic

    found = []
    if damage:
        found.append(Diagnostic("damaged-rows", f"{path}: {damage}"))
    if not trusted:
        message = (
            f"{path} is not as it was written (its SHA-256 differs), so no Kc or Bc can be identified from it: use "
            "another copy"
        )
        found.append(Diagnostic("changed", message, is_error=True))
    return found
