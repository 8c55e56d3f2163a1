"""`hil design`: predict the errors of Kc and Bc for an excitation, and find the best one, before the motor moves."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from drivers.servo import Quantity
from hil.cli import options
from hil.cli.terminal import out, out_table, print_diagnostics, print_json


def design(
    backend: options.Backend = None,
    stand: options.StandFile = None,
    kc: Annotated[float | None, typer.Option(help="Rough stiffness, N m/rad [default: [sim.coupling]'s].")] = None,
    bc: Annotated[float | None, typer.Option(help="Rough damping, N m s/rad [default: [sim.coupling]'s].")] = None,
    torque_noise: Annotated[
        float | None, typer.Option(help="Standard deviation, N m at the joint [default: [sim.sensors]'s].")
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
            help="The terms to estimate, as in linear+offset. auto: all terms that hil identify considers and whose "
            "errors can be predicted; whichever it then includes, the errors are at most these."
        ),
    ] = "auto",
    as_json: options.Json = False,
) -> None:
    """Predict the errors of Kc and Bc for an excitation, and find the excitation with the smallest ones."""
    from hil.acquisition.excitation import make
    from hil.experiment_design import advice
    from hil.experiment_design.assessment import assess, check_limits, task_of
    from hil.experiment_design.search import best
    from hil.report.design import as_json as to_json
    from hil.report.design import design_lines, error_table, headline, limit_table

    opened = options.stand_of(backend, stand)
    made = make(
        profile,
        mode,
        amplitude=amplitude,
        default_amplitude=options.limit_of(opened, mode) / 5.0,
        duration=duration,
        band=options.band_of(band),
        rate=options.checked_rate(rate),
        seed=options.DEFAULT_SEED,
        setpoints=setpoints,
    )
    task = task_of(opened, kc=kc, bc=bc, torque_noise=torque_noise, model=model, mode=mode, rate=rate)
    given = assess(task, made)
    check_limits(task, given)
    judged = {"given": given, "best": best(task, made.duration)}
    words = "--backend sim" if stand is None else f"--stand {shlex.quote(str(stand))}"
    stated = torque_noise is not None or opened.stand.backend == "sim" or "[sim.sensors]" in opened.text
    general = advice.of_task(task, noise_stated=stated)
    if as_json:
        print_json(to_json(task, judged, general, words))
    else:
        out(headline(judged))
        out_table(error_table(task, judged))
        out_table(limit_table(task, judged))
        for line in design_lines(task, judged, words):
            out(line)
    print_diagnostics([*general, *(warning for one in judged.values() for warning in advice.of_profile(task, one))])
