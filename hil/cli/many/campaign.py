"""`hil campaign` and `hil hand`: record, identify and report many joints one after the other."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli import options
from hil.cli.progress import progress
from hil.cli.terminal import (
    UNTRUSTWORTHY,
    asking,
    command_line,
    note,
    out,
    out_section,
    print_diagnostics,
    print_json,
    say,
)

if TYPE_CHECKING:
    from hil.campaign.journal import Journal
    from hil.campaign.plan import Plan

DryRun = Annotated[bool, typer.Option("--dry-run", help="Show what would be recorded, with durations.")]
Model = Annotated[str | None, typer.Option(help="Instead of the plan's model; a plan cannot name FILE.py:NAME.")]


def campaign(
    plan: Annotated[Path, typer.Argument(help="The plan (TOML): joints, profiles, pretensions and repeats.")],
    dry_run: DryRun = False,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing: joints and pretensions are set by someone else.")] = (
        False
    ),
    model: Model = None,
    workers: options.Workers = options.ALL_CORES,
    as_json: options.Json = False,
) -> None:
    """Record many joints one after the other, identify all, and write one report.

    After an interruption or a failure, the same command resumes and repeats nothing. If a joint fails, the failure is
    noted and the next joint follows. Exit status 1: a recording has no result, or a joint no Kc or Bc. Ctrl-C ends all.
    """
    from hil.campaign.plan import load

    _conducted(load(plan, model), dry_run=dry_run, yes=yes, workers=workers, as_json=as_json)


def hand(
    hand: Annotated[Path, typer.Argument(help="The file of the hand (TOML): what its joints share, and each joint.")],
    dry_run: DryRun = False,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing: all joints are locked.")] = False,
    model: Model = None,
    workers: options.Workers = options.ALL_CORES,
    as_json: options.Json = False,
) -> None:
    """Record every joint of a hand, identify all, and write one table, hand.json and a report.

    Before each joint you are asked to lock it. After an interruption or a failure, the same command resumes and repeats
    nothing. If a joint fails, the failure is noted and the next joint follows. Exit status 1: a recording has no
    result, or a joint no Kc or Bc. Ctrl-C ends all.
    """
    from hil.campaign.plan import of_hand

    _conducted(of_hand(hand, model), dry_run=dry_run, yes=yes, workers=workers, as_json=as_json)


def _conducted(loaded: Plan, *, dry_run: bool, yes: bool, workers: int, as_json: bool) -> None:
    from hil.campaign import conduct, table
    from hil.campaign.journal import Journal
    from hil.campaign.results import results
    from hil.report.formatting import Section

    journal = Journal(loaded)
    if dry_run:
        _show_plan(loaded, journal)
        return
    desk = conduct.Desk(say, lambda text: _ask(text, yes=yes), asking(yes=yes))
    try:
        conduct.record_all(loaded, journal, desk)  # without a bar: the live view has the terminal
    except conduct.Stopped as stopped:
        say(str(stopped))
        raise typer.Exit(128 + stopped.signal) from None
    with progress() as show:
        conduct.identify_all(loaded, journal, replace(desk, progress=show), workers=workers)
    found = results(loaded, journal)
    if as_json:
        print_json(table.as_json(loaded, found))
    else:
        out(table.verdict(found))
        out_section(Section(loaded.settings.name, table.table(found)))
    note(f"wrote {table.write_results(loaded, found, command_line())}")
    print_diagnostics(table.diagnostics(found))
    if not found.complete:
        raise typer.Exit(UNTRUSTWORTHY)


def _show_plan(plan: Plan, journal: Journal) -> None:
    due = [run for run in plan.runs if not journal.is_done(run)]
    minutes = plan.seconds(plan.runs) / 60.0
    out(f"{len(due)} of {len(plan.runs)} recordings to make; all together take {minutes:.1f} minutes")
    for run in plan.runs:
        state = "to do" if run in due else "done"
        out(f"{state:6} {run.profile.duration:6g} s  {run.path}" + (f"  first: {run.asks}" if run.asks else ""))


def _ask(text: str, *, yes: bool) -> None:
    say(text)
    if not yes and sys.stdin is not None and sys.stdin.isatty():
        typer.prompt("Press Enter to go on", default="", show_default=False, err=True)
