"""`hil record`: drive the motor through an excitation and record it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivers.servo import Quantity
from hil.cli import options
from hil.cli.terminal import STAND_FAILED, UNTRUSTWORTHY, command_line, out, print_diagnostics, print_json, say
from hil.errors import WrongUse

if TYPE_CHECKING:
    from hil.acquisition.excitation import Profile
    from hil.acquisition.recorder import Outcome
    from hil.diagnostics import Diagnostic
    from hil.stand.file import Stand

_FAST_MODE = 1e6  # rad/s; above this a simulated second takes about as long as a real one


def record(
    backend: options.Backend = None,
    stand: options.StandFile = None,
    profile: options.Kind = "chirp",
    amplitude: options.Amplitude = None,
    band: options.Band = None,
    duration: options.Duration = None,
    rate: options.Rate = options.DEFAULT_RATE,
    mode: options.Mode = Quantity.TORQUE,
    fade: Annotated[float, typer.Option(help="s over which the excitation fades in and out.")] = 1.0,
    setpoints: options.Setpoints = None,
    seed: options.Seed = options.DEFAULT_SEED,
    realtime: Annotated[bool, typer.Option("--realtime", help="Simulate in real time.")] = False,
    note: Annotated[str, typer.Option(help="A remark to keep in the recording.")] = "",
    output: options.Output = None,
    force: options.Force = False,
    as_json: options.Json = False,
    list_profiles: Annotated[bool, typer.Option("--list-profiles", help="List the excitations.")] = False,
    list_backends: Annotated[bool, typer.Option("--list-backends", help="List the backends.")] = False,
) -> None:
    """Drive the motor against the locked joint and record torque, deflection and rate."""
    from hil.acquisition.excitation import make
    from hil.acquisition.run import run
    from hil.recording.output import check_output

    if list_profiles or list_backends:
        _list_kinds(profiles=list_profiles)
        return
    opened = options.stand_of(backend, stand)
    made = make(
        profile,
        mode,
        amplitude=amplitude,
        default_amplitude=options.limit_of(opened, mode) / 5.0,
        duration=duration,
        band=options.band_of(band),
        rate=options.checked_rate(rate),
        fade=fade,
        seed=seed,
        setpoints=setpoints,
    )
    _check_amplitude(opened, made)
    foreseen = _foreseen(opened, made)
    print_diagnostics(foreseen)
    if output is not None:
        check_output(output, force=force, inputs=[path for path in (stand, setpoints) if path is not None])
    path, outcome = run(
        opened,
        made,
        rate=rate,
        seed=seed,
        realtime=realtime,
        note=note,
        command_line=command_line(),
        output=output,
        force=force,
        alarm=say,
    )
    try:
        print_json(_json(path, outcome, foreseen)) if as_json else out(_outcome_line(path, outcome))
    finally:
        _check_outcome(outcome)


def _json(path: Path, outcome: Outcome, foreseen: list[Diagnostic]) -> dict[str, Any]:
    from hil.diagnostics import lateness

    return {
        "schema": "hil-record/1",
        "recording": str(path) if outcome.samples else None,
        "samples": outcome.samples,
        "lost": outcome.lost,
        "late": outcome.late,
        "missed": outcome.missed,
        "saturated": outcome.saturated,
        "end_reason": outcome.end_reason,
        "warnings": [one.as_json() for one in (*foreseen, *lateness(outcome.late, outcome.samples))],
    }


def _outcome_line(path: Path, outcome: Outcome) -> str:
    """Return one line on how a run went."""
    if not outcome.samples:
        return f"nothing was recorded ({outcome.end_reason})"
    return f"{path}: {outcome.samples} samples, {outcome.lost} lost, {outcome.late} late ({outcome.end_reason})"


def _check_outcome(outcome: Outcome) -> None:
    """Raise the error or the exit status of a run that did not go as planned.

    An alarm (the torque may still be on) was printed when it was raised; it is printed again as the last line.
    """
    from drivers.servo import DriverError, LinkLost
    from hil.diagnostics import lateness

    if outcome.alarm:
        say(f"hil: {outcome.error}")
        say(outcome.alarm)
        raise typer.Exit(STAND_FAILED)
    if isinstance(outcome.error, OSError) and not isinstance(outcome.error, DriverError):
        raise LinkLost(f"the link failed: {outcome.error}") from outcome.error
    if outcome.error is not None:
        raise outcome.error
    if outcome.signal:
        raise typer.Exit(128 + outcome.signal)
    late = lateness(outcome.late, outcome.samples)
    print_diagnostics(late)
    if any(diagnostic.is_error for diagnostic in late):
        raise typer.Exit(UNTRUSTWORTHY)


def _list_kinds(*, profiles: bool) -> None:
    from hil.acquisition.excitation import EXCITATIONS
    from hil.stand.devices import BACKENDS

    for name, kind in (EXCITATIONS if profiles else BACKENDS).items():
        out(f"{name:10} {kind.explanation}")


def _foreseen(stand: Stand, profile: Profile) -> list[Diagnostic]:
    """Return the warnings that are known before anything moves."""
    from hil.diagnostics import Diagnostic, driven_by_position
    from hil.stand.devices import restrictions

    found = []
    if stand.stand.torque_source == "motor" and profile.mode is Quantity.POSITION:
        found.append(driven_by_position(is_error=False))
    table = stand.devices.get(str(stand.stand.backend))
    found += [Diagnostic("restricted-drive", text) for text in restrictions(table, stand.stand.torque_source)]
    if stand.stand.backend != "sim":
        return found
    from sim_backend.plant import constants, fastest_rate

    rate = fastest_rate(constants(stand.simulated()))  # the integrator's steps follow the fastest mode
    if rate > _FAST_MODE:
        found.append(
            Diagnostic(
                "slow-simulation",
                f"the fastest mode of the simulated stand lies at {rate / 6283.0:.0f} kHz, so that every simulated "
                f"second takes about {rate:.0e} steps: lower fixture.stiffness or raise the inertias",
            )
        )
    return found


def _check_amplitude(stand: Stand, profile: Profile) -> None:
    limit = options.limit_of(stand, profile.mode)
    unit = "N m" if profile.mode is Quantity.TORQUE else "rad"
    if profile.amplitude > limit:
        raise WrongUse(
            f"--amplitude {profile.amplitude:g} {unit} is beyond the stand's limit of {limit:g} {unit}: "
            "lower it; no option raises a limit"
        )
