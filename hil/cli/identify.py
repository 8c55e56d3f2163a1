"""`hil identify`: from the words of the command to a result on the terminal."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.progress import progress
from hil.cli.terminal import (
    LARGEST_SEED,
    UNTRUSTWORTHY,
    Checkpoint,
    Force,
    Json,
    columns,
    out,
    out_table,
    print_json,
    say,
    tell,
    tell_interrupted,
)
from hil.errors import Untrustworthy, WrongUse

if TYPE_CHECKING:
    from ga.evolution.evolution import Settings
    from hil.identification.identify import Search
    from hil.identification.model_choice import Coupling
    from hil.identification.result import Identification


def identify(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings, pooled.")],
    model: Annotated[
        str | None,
        typer.Option(
            help="auto, linear[+offset][+drift][+coulomb][+cubic][+inertia][+backlash][+slack][+skew] or FILE.py:NAME; "
            "auto unless --preset paper, --bounds, --checkpoint or --fixture is given."
        ),
    ] = None,
    preset: Annotated[str, typer.Option(help="default, or paper: the genetic algorithm as printed.")] = "default",
    trials: Annotated[int | None, typer.Option(min=1, help="Independent searches; 30, or 5 for a shape.")] = None,
    generations: Annotated[int | None, typer.Option(min=1, help="Of each trial; the preset's own otherwise.")] = None,
    population: Annotated[int | None, typer.Option(min=3, help="Chromosomes; the preset's own otherwise.")] = None,
    mutation: Annotated[float | None, typer.Option(min=0.0, max=1.0, help="Probability (0.1: Algorithm 1).")] = None,
    selection: Annotated[str | None, typer.Option(help="A reading of the paper; see docs/paper.md.")] = None,
    weights: Annotated[str | None, typer.Option(help="Of equation 6; see docs/paper.md.")] = None,
    replacement: Annotated[str | None, typer.Option(help="What a child replaces; see docs/paper.md.")] = None,
    bounds: Annotated[list[str] | None, typer.Option(help="NAME=LOW:HIGH in SI; may be repeated.")] = None,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Of the search.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; all cores otherwise.")] = None,
    checkpoint: Checkpoint = None,
    fixture: Annotated[
        Path | None, typer.Option(help="A recording of the empty rig, whose compliance is taken off Kc and Bc.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Also write a page (HTML) and its picture.")] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Find the stiffness Kc and damping Bc of the coupling in one or more recordings."""
    from hil.identification.identify import Search
    from hil.recording.output import check_target
    from hil.report.identification import page_files

    if report is not None:
        for path in page_files(report):
            check_target(path, force=force, inputs=recordings)
    # a search that is directed is of one model, and a fixture is taken off apparent stiffness and damping
    named = preset == "paper" or bool(bounds) or checkpoint is not None or fixture is not None
    chosen = chosen_model(model or ("linear" if named else "auto"))
    readings = {"selection": selection, "weights": weights, "replacement": replacement}
    sizes = {"generations": generations, "population": population, "mutation": mutation}
    given = {name: value for name, value in (readings | sizes).items() if value is not None}
    search = Search(
        preset=preset,
        settings=_settings(preset, given),
        trials=trials,
        seed=seed,
        workers=workers or os.cpu_count() or 1,
        bounds=dict(_bounds(text) for text in bounds or ()),
        checkpoint=checkpoint,
    )
    identify_and_show(recordings, chosen, search, report, fixture=fixture, as_json=as_json)


def identify_and_show(
    recordings: list[Path],
    model: Coupling | None,
    search: Search,
    report: Path | None,
    *,
    fixture: Path | None = None,
    as_json: bool,
) -> None:
    """Search with a progress bar, print the result, write the page where one is asked for.

    Raises typer.Exit where the search was interrupted or the result must not be trusted.
    """
    from dataclasses import replace

    from hil.identification import identify as engine
    from hil.identification.fixture import check_rig, without_fixture
    from hil.report.identification import as_json as to_json
    from hil.report.identification import unusable_json, write_page

    beside = [] if fixture is None else check_rig(recordings, fixture, model)

    try:
        with progress() as done:
            found = engine.identify(recordings, model, search, done)
            if fixture is not None:
                rig = engine.identify([fixture], model, replace(search, checkpoint=None), done)
                found = without_fixture(replace(found, diagnostics=(*found.diagnostics, *beside)), rig)
    except Untrustworthy as error:
        if as_json:
            name = "auto" if model is None else model.name
            print_json(unusable_json(recordings, name, search.preset, search.seed, str(error)))
        raise
    if as_json:
        print_json(to_json(found))
    else:
        _show(found)
    if report is not None:
        for path in write_page(found, report):
            say(f"wrote {path}")
    tell(found.diagnostics)
    if found.trials.interrupted:
        tell_interrupted(search.checkpoint)
    if not found.trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)


def _show(found: Identification) -> None:
    from hil.report.identification import identification_lines, identification_tables, ladder_table

    if found.rungs:
        out_table(ladder_table(found))
    for table in identification_tables(found, columns()):
        out_table(table)
    for line in identification_lines(found):
        out(line)


def chosen_model(name: str) -> Coupling | None:
    """The model of that name, None for the one that the ladder chooses. Raises WrongUse."""
    from ga.model.terms import parse

    if name == "auto":
        return None
    if ".py:" in name:
        from hil.identification.user_model import load

        return load(name)
    try:
        return parse(name)
    except ValueError as error:
        raise WrongUse(f"--model {name!r}: {error}") from None


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
