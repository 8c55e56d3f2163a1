"""`hil record`: drive the motor through an excitation and record it."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.servo import Quantity
from hil.cli import options
from hil.cli.terminal import UNTRUSTWORTHY, asking, command_line, detail, out, print_diagnostics, print_json, say
from hil.errors import WrongUse
from hil.printable import quoted

if TYPE_CHECKING:
    from hil.api.runs import Run
    from hil.stand.file import Stand


_ROUNDING = 1e-6  # s


def record(
    recording: Annotated[Path | None, typer.Argument(help="With --backend replay: the recording to play back.")] = None,
    backend: options.Backend = None,
    stand: options.StandFile = None,
    joint: options.Joint = None,
    profile: options.Kind = "chirp",
    amplitude: options.Amplitude = None,
    band: options.Band = None,
    duration: options.Duration = None,
    rate: options.Rate = options.DEFAULT_RATE,
    mode: options.Mode = Quantity.TORQUE,
    fade: options.Fade = 1.0,
    setpoints: options.Setpoints = None,
    seed: options.Seed = options.DEFAULT_SEED,
    realtime: Annotated[bool, typer.Option("--realtime", help="Simulate in real time.")] = False,
    faults: options.Faults = None,
    note: Annotated[str, typer.Option(help="A remark to keep in the recording.")] = "",
    output: options.Output = None,
    force: options.Force = False,
    no_guardian: options.NoGuardian = False,
    rerun: options.Rerun = "",
    yes: options.Unasked = False,
    as_json: options.Json = False,
    list_profiles: Annotated[bool, typer.Option("--list-profiles", help="List the excitations.")] = False,
    list_backends: Annotated[bool, typer.Option("--list-backends", help="List the backends.")] = False,
) -> None:
    """Drive the motor against the locked joint and record torque, deflection and rate."""
    if list_profiles or list_backends:
        _list_kinds(profiles=list_profiles)
        return
    from hil.api import runs

    if output is not None:
        _check_name(output, [stand, setpoints, faults], force=force)
    recorded = runs.record(
        _replayed(recording, backend, stand) if recording else options.stand_of(backend, stand, joint),
        profile,
        joint=joint,
        amplitude=options.amplitude_of(amplitude, mode),
        band=options.band_of(band),
        duration=_length(recording, rate) if recording and duration is None else duration,
        rate=rate,
        mode=mode,
        fade=fade,
        setpoints=setpoints,
        seed=seed,
        realtime=realtime,
        note=note,
        output=output,
        force=force,
        guardian=not no_guardian,
        faults=faults,
        rerun=rerun,
        command_line=command_line(),
        warn=print_diagnostics,
        alarm=say,
        agree=asking(yes=yes),
        ended=partial(_print, as_json=as_json),
    )
    _end(recorded)


def _check_name(output: Path, inputs: list[Path | None], *, force: bool) -> None:
    from hil.recording.output import check_output, recording_path

    check_output(recording_path(output), force=force, inputs=[path for path in inputs if path is not None])


def _end(run: Run) -> None:
    """End the command with the exit status that follows from the run."""
    if run.outcome.signal:
        raise typer.Exit(128 + run.outcome.signal)
    if not run.trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)


def _replayed(recording: Path, backend: str | None, stand: Path | None) -> Stand:
    from hil.stand.replay import replayed

    if recording.suffix == ".toml" and stand is None:
        raise WrongUse(f"{recording} looks like a stand file: hil record --stand {quoted(recording)}")
    if backend != "replay" or stand is not None:
        raise WrongUse(f"{recording}: a recording is played back with --backend replay, without --stand")
    return replayed(recording)


def _length(recording: Path, rate: float) -> float:
    """Return the duration, s, of a recording's rows when they are sent at `rate` Hz."""
    from hil.recording.reader import Recording

    with Recording(recording) as opened:
        return (len(opened) - 1) / rate


def _print(run: Run, *, as_json: bool) -> None:
    """Print a summary of a run, also of a run that was ended by a fault."""
    if as_json:
        print_json(run.as_json())
    else:
        _print_line(run)
    print_diagnostics([one for one in run.diagnostics if one.code in {"file-moved", "many-late", "over-limit"}])


def _print_line(run: Run) -> None:
    """Print the summary of a run in one line."""
    ended = run.outcome
    if not ended.samples:
        out(f"nothing was recorded ({ended.end_reason})")
    else:
        out(f"{run.path}: {ended.samples} samples, {ended.lost} lost, {ended.late} late ({ended.end_reason})")
        _print_lateness(run)


def _print_lateness(run: Run) -> None:
    """Print how late the set-points were sent. In virtual time there is no lateness, and nothing is printed."""
    from hil.report.formatting import engineering

    if run.lateness[2] > _ROUNDING or (run.outcome.missed and math.isfinite(run.lateness[2])):
        median, most, largest = (engineering(value, "s", 2) for value in run.lateness)
        missed = f"{run.outcome.missed} ticks missed"
        detail(f"set-points late by {median} (median), {most} (99 %), {largest} at most; {missed}")


def _list_kinds(*, profiles: bool) -> None:
    from hil.acquisition.excitation import EXCITATIONS
    from hil.stand.devices import listed

    for name, explanation in ((n, k.explanation) for n, k in EXCITATIONS.items()) if profiles else listed():
        out(f"{name:10} {explanation}")
