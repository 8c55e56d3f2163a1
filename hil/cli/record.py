"""`hil record`: from the words of the command to a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.terminal import (
    LARGEST_SEED,
    STAND_FAILED,
    UNTRUSTWORTHY,
    Force,
    Json,
    Output,
    command_line,
    out,
    print_json,
    say,
    tell,
)
from hil.errors import WrongUse

if TYPE_CHECKING:
    from drivers.servo import Quantity
    from hil.acquisition.excitation import Profile
    from hil.acquisition.recorder import Outcome
    from hil.diagnostics import Diagnostic
    from hil.stand.file import Stand

_FAST_PART = 1e6  # 1/s; from there on a simulated second takes about as long as a real one


def record(
    backend: Annotated[str | None, typer.Option(help="A built-in stand: sim.")] = None,
    stand: Annotated[Path | None, typer.Option(help="The stand file (stand.toml).")] = None,
    profile: Annotated[str, typer.Option(help="What the motor is asked to do; see --list-profiles.")] = "chirp",
    amplitude: Annotated[float | None, typer.Option(help="N m or rad at the joint; a fifth of its limit.")] = None,
    band: Annotated[str | None, typer.Option(help="Hz, LOW:HIGH or one frequency.")] = None,
    duration: Annotated[float | None, typer.Option(help="s; 20 unless a file says.")] = None,
    rate: Annotated[float, typer.Option(help="Samples a second.")] = 500.0,
    quantity: Annotated[str, typer.Option(help="What is commanded: torque or position.")] = "torque",
    soft: Annotated[float, typer.Option(help="s of soft start and soft stop.")] = 1.0,
    setpoints: Annotated[Path | None, typer.Option(help="The CSV of --profile file: time (s), set-point.")] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=LARGEST_SEED, help="Of all that is random: the simulator, a PRBS.")
    ] = 1,
    realtime: Annotated[bool, typer.Option("--realtime", help="Simulate in wall time.")] = False,
    note: Annotated[str, typer.Option(help="A remark kept in the file.")] = "",
    output: Output = None,
    force: Force = False,
    as_json: Json = False,
    list_profiles: Annotated[bool, typer.Option("--list-profiles", help="Explain the profiles.")] = False,
    list_backends: Annotated[bool, typer.Option("--list-backends", help="Explain the backends.")] = False,
) -> None:
    """Drive the motor against the locked joint and record torque, deflection and rate."""
    from hil.acquisition import excitation
    from hil.acquisition.run import run
    from hil.diagnostics import lateness
    from hil.recording.output import check_target
    from hil.stand.devices import BACKENDS

    if list_profiles:
        for name, kind in excitation.KINDS.items():
            out(f"{name:10} {kind.explanation}")
        return
    if list_backends:
        for name, device in BACKENDS.items():
            out(f"{name:10} {device.explanation}")
        return
    opened = _stand_of(backend, stand)
    made = excitation.make(
        profile,
        _quantity(quantity),
        amplitude=amplitude,
        default_amplitude=_limit_of(opened, quantity) / 5.0,
        duration=duration,
        band=None if band is None else _band(band),
        rate=checked_rate(rate),
        soft=soft,
        seed=seed,
        setpoints=setpoints,
    )
    _check_amplitude(opened, made)
    foreseen = _foreseen(opened, made)
    tell(foreseen)
    if output is not None:
        check_target(output, force=force, inputs=[path for path in (stand, setpoints) if path is not None])
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
    if as_json:
        print_json(
            {
                "schema": "hil-record/1",
                "recording": str(path) if outcome.samples else None,
                "samples": outcome.samples,
                "lost": outcome.lost,
                "late": outcome.late,
                "saturated": outcome.saturated,
                "end_reason": outcome.end_reason,
                "warnings": [one.as_json() for one in (*foreseen, *lateness(outcome.late, outcome.samples))],
            }
        )
    else:
        out(told(path, outcome))
    answer_for(outcome)


def told(path: Path, outcome: Outcome) -> str:
    """One line on how a run went."""
    if not outcome.samples:
        return f"nothing was recorded ({outcome.end_reason})"
    return f"{path}: {outcome.samples} samples, {outcome.lost} lost, {outcome.late} late ({outcome.end_reason})"


def answer_for(outcome: Outcome) -> None:
    """Raise what a run that did not go as planned ends the command with.

    That the torque may be on was said when it was found; it is said again, where the eye ends.
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
    found = lateness(outcome.late, outcome.samples)
    tell(found)
    if any(diagnostic.is_error for diagnostic in found):
        raise typer.Exit(UNTRUSTWORTHY)


def _stand_of(backend: str | None, path: Path | None) -> Stand:
    from hil.stand.devices import check_backend
    from hil.stand.file import SIMULATED, load, parse

    if path is not None and backend is not None:
        raise WrongUse("give --backend or --stand, not both: a stand file names its own backend")
    if path is not None:
        return load(path)
    if backend is None:
        raise WrongUse("which stand? --backend sim for the simulated one, --stand stand.toml for your own")
    if check_backend(backend) != "sim":
        raise WrongUse(f"backend {backend!r} needs a stand file, with its limits and its port: --stand stand.toml")
    return parse(SIMULATED)


def _foreseen(stand: Stand, profile: Profile) -> list[Diagnostic]:
    """What is to be said before anything moves.

    A simulated stand takes its time where it has a fast part: the steps of the integrator follow that.
    """
    from drivers.servo import Quantity
    from hil.diagnostics import Diagnostic, driven_by_position

    found = []
    if stand.stand.torque_source == "motor" and profile.quantity is Quantity.POSITION:
        found.append(driven_by_position(is_error=False))
    if stand.stand.backend != "sim":
        return found
    from sim_backend.plant import constants, fastest_rate

    rate = fastest_rate(constants(stand.simulated()))
    if rate > _FAST_PART:
        said = (
            f"a part of the simulated stand moves at {rate / 6283.0:.0f} kHz, so that every simulated second takes "
            f"about {rate:.0e} steps: for less, lower fixture.stiffness or raise the inertias"
        )
        found.append(Diagnostic("slow-simulation", said))
    return found


def _quantity(name: str) -> Quantity:
    from drivers.servo import Quantity

    try:
        return Quantity(name)
    except ValueError:
        raise WrongUse(f"unknown --quantity {name!r}: known are torque, position") from None


def _limit_of(stand: Stand, quantity: str) -> float:
    limits = stand.checked_limits()
    return limits.torque if quantity == "torque" else limits.deflection


def checked_rate(rate: float) -> float:
    """`rate` Hz, within what a loop on this side of a bus can be asked for. Raises WrongUse."""
    if not 20.0 <= rate <= 10_000.0:
        raise WrongUse(
            f"--rate {rate:g}: it must lie between 20 and 10000 Hz; a drive that is asked less often takes its host "
            "for dead and turns the torque off"
        )
    return rate


def _check_amplitude(stand: Stand, profile: Profile) -> None:
    limit = _limit_of(stand, profile.quantity.value)
    unit = "N m" if profile.quantity.value == "torque" else "rad"
    if profile.amplitude > limit:
        raise WrongUse(
            f"--amplitude {profile.amplitude:g} {unit} is beyond the stand's limit of {limit:g} {unit}: "
            "lower it; no option raises a limit"
        )


def _band(text: str) -> tuple[float, float]:
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if len(parts) not in {1, 2}:
        raise WrongUse(f"--band {text!r}: write LOW:HIGH in Hz, such as 0.1:15, or one frequency")
    return parts[0], parts[-1]
