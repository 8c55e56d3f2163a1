"""`hil design`: what a profile would tell, and the one that would tell most, before the motor moves."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.record import _band, _limit_of, _quantity, _stand_of, checked_rate
from hil.cli.terminal import Json, out, out_table, print_json, tell

if TYPE_CHECKING:
    from rich.table import Table

    from hil.experiment_design.assessment import Assessment, Task


def design(
    backend: Annotated[str | None, typer.Option(help="A built-in stand: sim.")] = None,
    stand: Annotated[Path | None, typer.Option(help="The stand file (stand.toml).")] = None,
    kc: Annotated[float | None, typer.Option(help="Rough stiffness, N m/rad; the simulated one's own.")] = None,
    bc: Annotated[float | None, typer.Option(help="Rough damping, N m s/rad; the simulated one's own.")] = None,
    torque_noise: Annotated[float | None, typer.Option(help="N m at the joint; else as [sim.sensors] says.")] = None,
    profile: Annotated[str, typer.Option(help="The profile to judge; see hil record --list-profiles.")] = "chirp",
    amplitude: Annotated[float | None, typer.Option(help="N m or rad at the joint; a fifth of its limit.")] = None,
    band: Annotated[str | None, typer.Option(help="Hz, LOW:HIGH or one frequency.")] = None,
    duration: Annotated[float | None, typer.Option(help="s; 20 unless a file says.")] = None,
    rate: Annotated[float, typer.Option(help="Samples a second.")] = 500.0,
    quantity: Annotated[str, typer.Option(help="What is commanded: torque or position.")] = "torque",
    setpoints: Annotated[Path | None, typer.Option(help="The CSV of --profile file: time (s), set-point.")] = None,
    model: Annotated[str, typer.Option(help="The terms to be told, as in hil identify.")] = "linear",
    as_json: Json = False,
) -> None:
    """Predict how well a profile would tell Kc and Bc, and find the profile that tells them best."""
    from hil.acquisition import excitation
    from hil.experiment_design import diagnostics
    from hil.experiment_design.assessment import assess, check_limits, task_of
    from hil.experiment_design.search import SEED, best

    opened = _stand_of(backend, stand)
    task = task_of(
        opened,
        kc=kc,
        bc=bc,
        torque_noise=torque_noise,
        model=model,
        quantity=_quantity(quantity),
        rate=checked_rate(rate),
    )
    made = excitation.make(
        profile,
        task.quantity,
        amplitude=amplitude,
        default_amplitude=_limit_of(opened, quantity) / 5.0,
        duration=duration,
        band=None if band is None else _band(band),
        rate=rate,
        seed=SEED,
        setpoints=setpoints,
    )
    given = assess(task, made)
    check_limits(task, given)
    judged = {"given": given, "best": best(task, made.duration)}
    words = "--backend sim" if stand is None else f"--stand {shlex.quote(str(stand))}"
    stated = (
        torque_noise is not None or stand is None or opened.stand.backend == "sim" or "[sim.sensors]" in opened.text
    )
    general = diagnostics.task_diagnostics(task, noise_stated=stated)
    if as_json:
        print_json(diagnostics.as_json(task, judged, general, words))
    else:
        _show(task, judged, words)
    tell(tuple(general + [diagnostic for one in judged.values() for diagnostic in diagnostics.diagnostics(task, one)]))


def _show(task: Task, judged: dict[str, Assessment], stand: str) -> None:
    from hil.experiment_design.diagnostics import command

    out_table(_errors(task, judged))
    out_table(_limits(task, judged))
    out(
        "Standard errors are those of the least absolute deviations of hil identify; least squares would reach the\n"
        "Cramer-Rao bound, 1.25 times less in white noise. Four times the duration halves them; heating is not judged."
    )
    for name, one in judged.items():
        out(f"{name}, limited by {one.limited_by}:\n  {command(one, stand, task.rate)}")


def _errors(task: Task, judged: dict[str, Assessment]) -> Table:
    from rich.box import SIMPLE
    from rich.table import Table

    from hil.experiment_design.diagnostics import named
    from hil.report.identification import people_unit

    table = Table(title=f"{'+'.join(task.terms)}: predicted standard errors", box=SIMPLE, pad_edge=False)
    table.add_column("", no_wrap=True)
    for name, one in judged.items():
        table.add_column(f"{name}: {named(one.profile)}", justify="right")
    table.add_column("")
    for index, parameter in enumerate(judged["given"].parameters):
        factor, unit = people_unit(parameter.unit, milli=task.limits[1] < 1.0)
        cells = []
        for one in judged.values():
            error, rough = one.parameters[index].error, one.parameters[index].rough
            part = f" ({error / rough:.2%})" if rough and parameter.name in {"Kc", "Bc"} else ""
            cells.append(f"{error * factor:.3g}{part}" if error < float("inf") else "cannot be told")
        table.add_row(parameter.name, *cells, unit)
    return table


def _limits(task: Task, judged: dict[str, Assessment]) -> Table:
    from rich.box import SIMPLE
    from rich.table import Table

    from hil.experiment_design.assessment import LIMITED, UNITS

    table = Table(title="predicted peaks, and their part of the limit", box=SIMPLE, pad_edge=False)
    for heading in ("", *judged, "limit", ""):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for index, name in enumerate(LIMITED):
        cells = [f"{one.peaks.in_order[index]:.3g} ({one.shares[index]:.0%})" for one in judged.values()]
        table.add_row(name, *cells, f"{task.limits[index]:g}", UNITS[index])
    return table
