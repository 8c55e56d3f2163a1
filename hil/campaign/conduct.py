"""Carry out a campaign: make the recordings that are missing, and identify the recordings without a result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.servo import DriverError
from hil.acquisition.heat import TooHot
from hil.acquisition.limits import LimitReached
from hil.api.analysis import identify_each
from hil.api.runs import Run as Recorded
from hil.api.runs import record, simulate
from hil.campaign.journal import Journal, keep_result, kept_result, note
from hil.campaign.plan import Plan, Run
from hil.errors import Declined, Untrustworthy, WrongUse
from hil.recording.output import check_folder, writing


@dataclass(frozen=True, slots=True)
class Desk:
    """The interface to the person at the stand, as functions.

    say: shows a line of text. ask: shows an instruction and returns when the person has followed it. agree: called
    before a real motor moves for the first time; raises to refuse. progress: gets the name of the identification's
    phase and the completed fraction. sleep: waits for the given time, s.
    """

    say: Callable[[str], object]
    ask: Callable[[str], object]
    agree: Callable[[str], object] | None = None
    progress: Callable[[str, float], None] = field(default=lambda _what, _done: None)
    sleep: Callable[[float], object] = time.sleep


class Stopped(Exception):
    """The person at the stand stopped the campaign. signal: number of the signal that ended the recording."""

    def __init__(self, signal: int) -> None:
        super().__init__("stopped: the same command resumes the campaign")
        self.signal = signal


def record_all(plan: Plan, journal: Journal, desk: Desk) -> None:
    """Make every recording of the plan that is missing. A failure is written into the journal, and the next recording
    follows.

    desk: the interface to the person at the stand. Raises Stopped if that person ends the campaign; raises DriverError
    if the torque of a drive may still be on, and then nothing else is recorded.
    """
    due = [run for run in plan.runs if not journal.is_done(run)]
    check_folder(plan.folder)
    with writing(plan.folder):
        plan.folder.mkdir(parents=True, exist_ok=True)
    for at, run in enumerate(due):
        if run.asks:
            desk.ask(run.asks)
        if at and plan.is_real(run.joint):
            _cool_down(plan.settings.cool_down, desk)
        alarms: list[str] = []
        try:
            ended = _recorded_when_cool(plan, run, alarms, desk)
        except Declined:
            raise
        except (WrongUse, Untrustworthy, DriverError, LimitReached) as error:
            journal.keep(run, str(error))
            desk.say(f"{plan.named(run)} failed: {error}")
            if alarms:
                desk.say("nothing else is driven: remove the cause; then the same command resumes")
                raise
            continue
        if ended.outcome.signal:
            journal.keep(run, "stopped on request")
            raise Stopped(ended.outcome.signal)
        journal.keep(run)
        left = f"; {plan.seconds(due[at + 1 :]) / 60.0:.1f} min left" if due[at + 1 :] else ""
        said = f"{ended.outcome.samples} samples, {ended.outcome.lost} lost{left}"
        turned = f"; {ended.outcome.neighbours}" if ended.outcome.neighbours else ""
        desk.say(f"{at + 1} of {len(due)}, {run.name}: {said}{turned}")
        for one in ended.diagnostics:
            if one.is_error:
                desk.say(f"{run.name}: {one.message}")


def _recorded_when_cool(plan: Plan, run: Run, alarms: list[str], desk: Desk) -> Recorded:
    """Record one run. If the heat limit refuses the run, wait until the motor is cool and try once more. alarms: alarms
    so far, in which new ones are stored. Raises TooHot if waiting does not help.
    """
    try:
        return _recorded(plan, run, alarms, desk)
    except TooHot as hot:
        if not math.isfinite(hot.rest):
            raise
        desk.say(f"{run.name}: the winding is too warm for it")
        _cool_down(hot.rest, desk)
        return _recorded(plan, run, alarms, desk)


def _recorded(plan: Plan, run: Run, alarms: list[str], desk: Desk) -> Recorded:
    profile, stand = run.profile, plan.stand_of(run.joint)
    common: dict[str, Any] = {
        "band": profile.band,
        "amplitude": profile.amplitude,
        "duration": profile.duration,
        "rate": profile.rate,
    }
    common |= {"mode": profile.mode, "fade": profile.fade, "seed": run.seed, "note": note(run)}
    # a recording of that name is of a run that failed, as the journal knows
    if stand == "sim":
        return simulate(run.path, profile.kind, sim=run.joint.sim, force=True, **common)

    def alarm(sentence: str) -> None:
        alarms.append(sentence)
        desk.say(sentence)

    return record(stand, profile.kind, output=run.path, force=True, alarm=alarm, agree=desk.agree, **common)


def _cool_down(seconds: float, desk: Desk) -> None:
    if seconds > 0.0:
        desk.say(f"cooling down for {seconds:.0f} s")
        desk.sleep(seconds)


def identify_all(plan: Plan, journal: Journal, desk: Desk, *, workers: int | None = None) -> None:
    """Identify every recording that has no result with the plan's model yet. Raises WrongUse."""
    model, trials = plan.settings.model, plan.settings.trials
    due = [run for run in plan.runs if journal.is_done(run) and kept_result(run, model, trials) is None]
    if not due:
        return
    paths = [run.path for run in due]
    found = identify_each(paths, model, trials=trials, workers=workers, progress=desk.progress)
    for run, one in zip(due, found, strict=True):
        keep_result(run, model, trials, one.as_json())
