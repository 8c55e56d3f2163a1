"""`hil identify`: find Kc and Bc in recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli import options
from hil.cli.many.each import identify_each, meets, refuse_with_each
from hil.cli.progress import progress
from hil.cli.terminal import (
    UNTRUSTWORTHY,
    command_line,
    detail,
    exit_interrupted,
    note,
    out,
    out_section,
    print_diagnostics,
    print_json,
    say,
)
from hil.errors import WrongUse, decimal_comma, unknown
from hil.report.expected import Expected, expectation, missed
from hil.units import SI

if TYPE_CHECKING:
    from hil.api.results import IdentificationResult
    from hil.identification.result import Identification

Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose",
        help="Also show every parameter, numbers for a controller, model selection, repeatability, K'(f), B'(f).",
    ),
]


Expect = Annotated[
    list[str] | None,
    typer.Option(help="Kc=VALUE:PERCENT% (or Bc): exit status 1 if the value or its interval is outside."),
]
_DIMENSIONS = {"Kc": ("stiffness",), "Bc": ("damping",)}  # of --bounds; others have units of their own


def identify(
    recordings: Annotated[list[Path], typer.Argument(help="One or more recordings, pooled.")],
    first: options.From = None,
    last: options.To = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="auto: model selection; or terms joined with +, as in linear+offset (see --list-models); or "
            "FILE.py:NAME [default: auto; linear with --preset paper, --bounds, --checkpoint or --fixture]."
        ),
    ] = None,
    preset: Annotated[str, options.searched("default, or paper: the genetic algorithm as printed.")] = "default",
    generations: Annotated[int | None, options.searched("In each trial [default: the preset's].", least=1)] = None,
    population: Annotated[int | None, options.searched("Chromosomes [default: the preset's].", least=3)] = None,
    mutation: Annotated[float | None, options.searched("Probability (0.1: Algorithm 1).", least=0, most=1)] = None,
    selection: Annotated[str | None, options.searched("How parents are selected; see docs/paper.md.")] = None,
    weights: Annotated[str | None, options.searched("Those of equation 6; see docs/paper.md.")] = None,
    replacement: Annotated[str | None, options.searched("Which individual is replaced; see docs/paper.md.")] = None,
    trials: options.Trials = None,
    bounds: options.Bounds = None,
    seed: options.Seed = options.DEFAULT_SEED,
    workers: options.Workers = options.ALL_CORES,
    each: Annotated[
        bool, typer.Option("--each", help="Identify each recording on its own, several at a time, instead of pooling.")
    ] = False,
    checkpoint: options.Checkpoint = None,
    fixture: options.Fixture = None,
    report: Annotated[Path | None, typer.Option(help="Also write a report (HTML).")] = None,
    plot: options.Plot = None,
    force: options.Force = False,
    require: Annotated[str, typer.Option(help="Kc, Bc or both: what must be trusted for exit status 0.")] = "both",
    expect: Expect = None,
    as_json: options.Json = False,
    verbose: Verbose = False,
    list_models: options.ListModels = False,
) -> None:
    """Find the stiffness Kc and damping Bc of the coupling in one or more recordings."""
    del list_models  # is done before anything else is asked for
    required, expected = _required(require), [expectation(text) for text in expect or ()]
    common: dict[str, Any] = {"preset": preset, "trials": trials, "seed": seed, "workers": workers}
    common |= {"start": first, "end": last}
    common |= {"bounds": dict(_bounds(text) for text in bounds or ()), "fixture": fixture}
    alone: dict[str, Any] = {"generations": generations, "population": population, "mutation": mutation}
    alone |= {"selection": selection, "weights": weights, "replacement": replacement, "checkpoint": checkpoint}
    if each:
        refuse_with_each(alone | {"report": report, "plot": plot, "expect": expect})
        identify_each(recordings, model, common, required, as_json=as_json)
        return
    options.check_report(report, recordings, force=force)
    _check_others(checkpoint, plot, recordings, force=force)
    from hil.api.analysis import identify as identify_recordings

    with _failure_published(report, force=force, as_json=as_json), progress() as show:
        found = identify_recordings(recordings, model, progress=show, **(common | alone))
    publish(found, report, plot, as_json=as_json, verbose=verbose, force=force)
    _end(found, checkpoint, required, expected)


def _check_others(checkpoint: Path | None, plot: Path | None, inputs: list[Path], *, force: bool) -> None:
    """Raise WrongUse if the checkpoint or the folder of pictures cannot be written."""
    from hil.recording.output import check_output
    from hil.report.pictures import result
    from hil.report.pictures.files import check_pictures

    if checkpoint is not None:
        check_output(checkpoint, force=True, inputs=inputs)
    if plot is not None:
        check_pictures(plot, [f"{name}.png" for name in result.NAMES], force=force)


def _end(
    found: IdentificationResult, checkpoint: Path | None, required: tuple[str, ...], expected: Sequence[Expected]
) -> None:
    """End the command with the exit status that follows from the result."""
    if found.interrupted:
        exit_interrupted(checkpoint)
    wrong = missed(found.identification, expected)
    for sentence in wrong:
        say(f"error: {sentence}")
    if wrong or not meets(found, required):
        raise typer.Exit(UNTRUSTWORTHY)


def _required(require: str) -> tuple[str, ...]:
    """Return the parameters that --require names, which must be trusted for exit status 0. Raises WrongUse."""
    known = {"Kc": ("Kc",), "Bc": ("Bc",), "both": ("Kc", "Bc")}
    if require not in known:
        raise unknown("--require", require, known)
    return known[require]


@contextmanager
def _failure_published(report: Path | None, *, force: bool, as_json: bool) -> Iterator[None]:
    """If the block raises NoResult, print the JSON object and write the report with the reason."""
    from hil.api.results import NoResult

    try:
        yield
    except NoResult as failure:
        if as_json:
            print_json(failure.as_json())
        if report is not None:
            note(f"wrote {failure.report(report, command_line(), force=force)}")
        raise


def publish(
    found: IdentificationResult,
    report: Path | None = None,
    plot: Path | None = None,
    *,
    as_json: bool = False,
    verbose: bool = False,
    force: bool = False,
) -> None:
    """Print the result, then write its report (HTML) and its pictures (PNG). Raises WrongUse."""
    if as_json:
        print_json(found.as_json())
    else:
        _show_answer(found.identification)
    print_diagnostics(found.diagnostics)
    if not as_json:
        _show_work(found.identification, verbose=verbose)
    if report is not None:
        note(f"wrote {found.report(report, command_line(), force=force)}")
    if plot is not None:
        for path in found.save_plots(plot, force=force):
            note(f"wrote {path}")


def _show_answer(found: Identification) -> None:
    from hil.report.identification import headline

    out(headline(found))


def _show_work(found: Identification, *, verbose: bool) -> None:
    """Print how the result was obtained: three lines, or with `verbose` tables and more lines."""
    from hil.report import identification as report
    from hil.report.controller import controller_section

    if not verbose:
        for line in report.summary_lines(found):
            detail(line)
        return
    out_section(report.estimates_section(found))
    if found.steps:
        out_section(report.model_selection_section(found))
    out_section(controller_section(found, milli=report.milli(found)))
    out_section(report.repeatability_section(found))
    if bands := report.bands_section(found):
        out_section(bands)
    for line in report.identification_lines(found):
        detail(line)


def _bounds(text: str) -> tuple[str, tuple[float, float]]:
    name, _, span = text.partition("=")
    dimensions = _DIMENSIONS.get(name.strip(), tuple(SI))
    try:
        low, high = options.span_of(span, *dimensions)
    except WrongUse:
        example = ": write NAME=LOW:HIGH in SI, such as Kc=0.01:5, or with a unit as in Kc=10:30mN*m/rad"
        raise WrongUse(f"--bounds {text!r}{decimal_comma(text) or example}") from None
    return name.strip(), (low, high)
