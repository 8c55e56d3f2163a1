"""`hil identify`: find Kc and Bc in recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ga.model.terms import MEANINGS, SYNTAX
from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import (
    UNTRUSTWORTHY,
    exit_interrupted,
    out,
    out_table,
    print_diagnostics,
    print_json,
    say,
)
from hil.errors import Untrustworthy, WrongUse

if TYPE_CHECKING:
    from ga.evolution.evolution import Settings
    from hil.identification.identify import Search
    from hil.identification.result import Identification


def identify(
    recordings: Annotated[list[Path], typer.Argument(help="One or more recordings, pooled.")],
    model: Annotated[
        str | None,
        typer.Option(
            help=f"auto: model selection; or {SYNTAX} ({MEANINGS}); or FILE.py:NAME [default: auto; linear with "
            "--preset paper, --bounds, --checkpoint or --fixture]."
        ),
    ] = None,
    preset: Annotated[str, typer.Option(help="default, or paper: the genetic algorithm as printed.")] = "default",
    trials: Annotated[
        int | None, typer.Option(min=1, help="Independent searches [default: 30; 5 with nonlinear parameters].")
    ] = None,
    generations: Annotated[int | None, typer.Option(min=1, help="Of each trial [default: the preset's].")] = None,
    population: Annotated[int | None, typer.Option(min=3, help="Chromosomes [default: the preset's].")] = None,
    mutation: Annotated[float | None, typer.Option(min=0.0, max=1.0, help="Probability (0.1: Algorithm 1).")] = None,
    selection: Annotated[str | None, typer.Option(help="A reading of the paper; see docs/paper.md.")] = None,
    weights: Annotated[str | None, typer.Option(help="Of equation 6; see docs/paper.md.")] = None,
    replacement: Annotated[
        str | None, typer.Option(help="Which individual the offspring replaces; see docs/paper.md.")
    ] = None,
    bounds: Annotated[list[str] | None, typer.Option(help="NAME=LOW:HIGH in SI; repeat for several.")] = None,
    seed: options.Seed = options.DEFAULT_SEED,
    workers: options.Workers = options.ALL_CORES,
    checkpoint: options.Checkpoint = None,
    fixture: Annotated[
        Path | None, typer.Option(help="A recording of the empty rig, to subtract the fixture's compliance.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Also write a page (HTML) and its picture (PNG).")] = None,
    force: options.Force = False,
    as_json: options.Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Also show the optimiser's repeatability.")] = False,
) -> None:
    """Find the stiffness Kc and damping Bc of the coupling in one or more recordings."""
    from hil.identification.identify import Search
    from hil.recording.output import check_output
    from hil.report.page import page_files

    if report is not None:
        for path in page_files(report):
            check_output(path, force=force, inputs=recordings)
    # bounds and checkpoints belong to one model, and a fixture is subtracted from apparent stiffness and damping
    fixed = preset == "paper" or bool(bounds) or checkpoint is not None or fixture is not None
    readings = {"selection": selection, "weights": weights, "replacement": replacement}
    sizes = {"generations": generations, "population": population, "mutation": mutation}
    search = Search(
        preset=preset,
        settings=_settings(preset, {name: value for name, value in (readings | sizes).items() if value is not None}),
        trials=trials,
        seed=seed,
        workers=workers,
        bounds=dict(_bounds(text) for text in bounds or ()),
        checkpoint=checkpoint,
    )
    found = _identified(recordings, model or ("linear" if fixed else "auto"), search, fixture, as_json=as_json)
    _publish(found, report, as_json=as_json, verbose=verbose)
    if found.trials.interrupted:
        exit_interrupted(checkpoint)
    if not found.trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)


def _publish(found: Identification, report: Path | None, *, as_json: bool, verbose: bool) -> None:
    from hil.report.identification import as_json as to_json
    from hil.report.page import write_page

    if as_json:
        print_json(to_json(found))
    else:
        _show(found, verbose=verbose)
    if report is not None:
        for path in write_page(found, report):
            say(f"wrote {path}")
    print_diagnostics(found.diagnostics)


def _identified(
    recordings: list[Path], model: str, search: Search, fixture: Path | None, *, as_json: bool
) -> Identification:
    """Search with a progress bar. Raises Untrustworthy, after the JSON object that says why."""
    from hil.identification.fixture import identify_without_fixture
    from hil.identification.identify import identify as identify_recordings
    from hil.report.identification import unusable_json

    chosen = options.model_of(model)
    try:
        with progress() as show:
            if fixture is None:
                return identify_recordings(recordings, chosen, search, show)
            return identify_without_fixture(recordings, fixture, chosen, search, show)
    except Untrustworthy as error:
        if as_json:
            name = model if chosen is None else chosen.name
            print_json(unusable_json(recordings, name, search.preset, search.seed, str(error)))
        raise


def _show(found: Identification, *, verbose: bool) -> None:
    from hil.report.identification import (
        estimates_table,
        headline,
        identification_lines,
        model_selection_table,
        repeatability_table,
    )

    out(headline(found))
    out_table(estimates_table(found))
    if found.steps:
        out_table(model_selection_table(found))
    if verbose:
        out_table(repeatability_table(found))
        _show_dynamic_stiffness(found)
    for line in identification_lines(found):
        out(line)


def _show_dynamic_stiffness(found: Identification) -> None:
    from hil.report.formatting import people_unit
    from hil.report.identification import milli
    from hil.report.lack_of_fit import distortion_lines, dynamic_stiffness_table

    if found.dynamic_stiffness is None:
        return
    factor, stiffness = people_unit("N*m/rad", milli=milli(found))
    damping = people_unit("N*m*s/rad", milli=milli(found))[1]
    out_table(dynamic_stiffness_table(found.dynamic_stiffness, factor, stiffness, damping))
    for line in distortion_lines(found.dynamic_stiffness):
        out(line)


def _settings(preset: str, given: dict[str, Any]) -> Settings:
    from dataclasses import replace

    from ga.evolution.evolution import PRESETS

    if preset not in PRESETS:
        raise WrongUse(f"unknown --preset {preset!r}: known are {', '.join(PRESETS)}")
    try:
        return replace(PRESETS[preset], **given)
    except ValueError as error:
        raise WrongUse(str(error)) from None


def _bounds(text: str) -> tuple[str, tuple[float, float]]:
    name, _, span = text.partition("=")
    try:
        low, high = (float(part) for part in span.split(":"))
    except ValueError:
        raise WrongUse(f"--bounds {text!r}: write NAME=LOW:HIGH in SI, such as Kc=0.01:5") from None
    return name.strip(), (low, high)
