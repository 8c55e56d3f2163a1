"""`hil design`: predict the errors of Kc and Bc for an excitation, and find the best one, before the motor moves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from drivers.servo import Quantity
from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import out, out_section, print_diagnostics, print_json

if TYPE_CHECKING:
    from hil.api.planning import DesignResult


def design(
    backend: options.Backend = None,
    stand: options.StandFile = None,
    joint: options.Joint = None,
    kc: Annotated[
        float | None, options.measured("--kc", "stiffness", "A rough value, N m/rad [default: [sim.coupling]'s].")
    ] = None,
    bc: Annotated[
        float | None, options.measured("--bc", "damping", "A rough value, N m s/rad [default: [sim.coupling]'s].")
    ] = None,
    torque_noise: Annotated[
        float | None,
        options.measured(
            "--torque-noise", "torque", "Standard deviation, N m at the joint [default: [sim.sensors]'s]."
        ),
    ] = None,
    profile: options.Kind = "chirp",
    amplitude: options.Amplitude = None,
    band: options.Band = None,
    duration: options.Duration = None,
    rate: options.Rate = options.DEFAULT_RATE,
    mode: options.Mode = Quantity.TORQUE,
    setpoints: options.Setpoints = None,
    model: Annotated[
        str,
        typer.Option(
            help="The terms to estimate, as in linear+offset. auto: the common terms of hil identify, "
            "whose errors can be predicted; whichever of them it includes, the errors are at most these."
        ),
    ] = "auto",
    as_json: options.Json = False,
) -> None:
    """Predict the errors of Kc and Bc for an excitation, and find the excitation with the smallest errors."""
    from hil.api import planning

    with progress() as show:
        found = planning.design(
            options.stand_of(backend, stand, joint),
            profile,
            joint=joint,
            kc=kc,
            bc=bc,
            torque_noise=torque_noise,
            amplitude=options.amplitude_of(amplitude, mode),
            band=options.band_of(band),
            duration=duration,
            rate=rate,
            mode=mode,
            setpoints=setpoints,
            model=model,
            progress=show,
        )
    if as_json:
        print_json(found.as_json())
    else:
        out(str(found))
    print_diagnostics(found.diagnostics)
    if not as_json:
        _show_work(found)


def _show_work(found: DesignResult) -> None:
    """Print the tables below the answer, and the commands with which the excitations are recorded."""
    from hil.report.design import sections

    for section in sections(found.task, found.judged, found.stand):
        out_section(section)
