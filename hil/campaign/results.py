"""The results of a campaign: Kc and Bc of every joint, whether they repeat, whether they drift, and which are
outliers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

import numpy as np

from hil.campaign.journal import Journal, kept_result
from hil.campaign.plan import Plan, Run
from hil.diagnostics import Diagnostic
from hil.identification.result import interval
from hil.recording.reader import Recording
from hil.uncertainty.random_effects import Drift, between, drift

PARAMETERS = ("Kc", "Bc")
_NORMAL = 1.959964  # half a 95 % interval in standard errors
_CHANCE = 0.05
_STANDS_OUT = 3.5  # modified z-score (Iglewicz and Hoaglin 1993)
_MAD = 0.6745  # of a normal distribution, in standard deviations
_FEWEST = 5  # values among which one can stand out


@dataclass(frozen=True, slots=True)
class Value:
    """The value of one parameter with its 95 % interval, SI."""

    value: float
    ci95: tuple[float, float]
    unit: str

    @property
    def error(self) -> float:
        """The standard error, computed from half the 95 % interval; never zero."""
        return max((self.ci95[1] - self.value) / _NORMAL, 1e-9 * abs(self.value), math.ulp(0.0))


@dataclass(frozen=True, slots=True)
class Measured:
    """A run with the parameters that may be trusted. failure: why there is no recording or no result, otherwise "".
    created: date of the recording. diagnostics: the warnings and errors of its result.
    """

    run: Run
    values: Mapping[str, Value]
    failure: str = ""
    created: str = ""
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class Outlier:
    """Why a value is an outlier among the joints of a hand.

    median: of all joints' values, SI. score: modified z-score of the ratio of value to median.
    """

    median: float
    score: float


@dataclass(frozen=True, slots=True)
class Line:
    """The results of one joint at one pretension with one profile: a line of the report.

    measured: the runs. values: each parameter, pooled over the runs. repeats: for each parameter, whether the runs
    agree within their own errors; None if that cannot be decided. stands_out: the parameters that are outliers in the
    hand.
    """

    joint: str
    profile: str
    pretension: str
    measured: tuple[Measured, ...]
    values: Mapping[str, Value]
    repeats: Mapping[str, bool | None]
    stands_out: Mapping[str, Outlier] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The names of joint, pretension and profile, joined with commas."""
        return ", ".join(part for part in (self.joint, self.pretension, self.profile) if part)


@dataclass(frozen=True, slots=True)
class Results:
    """The results of a campaign.

    lines: in the plan's order. failed: the runs without a result. drifts: for each parameter, the drift per hour over
    the drift checks, and the mean value.
    """

    lines: tuple[Line, ...]
    failed: tuple[Measured, ...]
    drifts: Mapping[str, tuple[Drift, float]]

    @property
    def complete(self) -> bool:
        """Return whether every run has a result."""
        return not self.failed


def results(plan: Plan, journal: Journal) -> Results:
    """Return the results of all runs of a plan that are done so far."""
    measured = [_measured(plan, run, journal) for run in plan.runs]
    keys = list(dict.fromkeys(_key(run) for run in plan.runs if not run.is_check))
    lines = [_line(key, [one for one in measured if _key(one.run) == key and not one.run.is_check]) for key in keys]
    checks = [one for one in measured if _key(one.run) == keys[0]]
    drifts = {name: found for name in PARAMETERS if (found := _drift(name, checks)) is not None}
    failed = tuple(one for one in measured if one.failure)
    return Results(tuple(marked(lines)), failed, drifts if any(one.run.is_check for one in checks) else {})


def _key(run: Run) -> tuple[str, str, str]:
    return run.joint.name, run.profile.name, run.pretension


def _measured(plan: Plan, run: Run, journal: Journal) -> Measured:
    if not journal.is_done(run):
        why = journal.failure(run)
        return Measured(run, {}, f"{why}; the same command records it again" if why else "not recorded yet")
    found = kept_result(run, plan.settings.model, plan.settings.trials)
    if found is None:
        return Measured(run, {}, "not identified yet")
    values = {name: _value(one) for name, one in found["parameters"].items() if name in PARAMETERS and _usable(one)}
    reasons = "; ".join(dict.fromkeys(one["message"] for one in found["errors"]))
    with Recording(run.path) as recording:
        created = str(recording.attributes.get("created", ""))
    said = tuple(
        Diagnostic(one["code"], f"{run.name}: {one['message']}", one["parameter"], is_error=severity == "errors")
        for severity in ("errors", "warnings")
        for one in found[severity]
    )
    return Measured(run, values, "" if values else reasons or "neither Kc nor Bc may be trusted", created, said)


def _usable(one: dict[str, Any]) -> bool:
    return bool(one.get("trusted")) and None not in (one["value"], *one["ci95"])


def _value(one: dict[str, Any]) -> Value:
    return Value(one["value"], (one["ci95"][0], one["ci95"][1]), one["unit"])


def _line(key: tuple[str, str, str], measured: Sequence[Measured]) -> Line:
    values: dict[str, Value] = {}
    repeats: dict[str, bool | None] = {}
    for name in PARAMETERS:
        known = [one.values[name] for one in measured if name in one.values]
        repeats[name] = None
        if len(known) == 1:
            values[name] = known[0]
        elif known:
            pooled = between(np.array([one.value for one in known]), np.array([one.error for one in known]))
            half = pooled.ci95[1] - pooled.value
            values[name] = Value(pooled.value, interval(pooled.value, half, positive=True), known[0].unit)
            repeats[name] = pooled.p_alike >= _CHANCE
    return Line(*key, tuple(measured), values, repeats)


def marked(lines: Sequence[Line]) -> list[Line]:
    """Return the lines with outliers marked. A line is compared with the other lines of the same profile."""
    found = []
    for line in lines:
        out = {}
        for name in PARAMETERS:
            rivals = [one for one in lines if one.profile == line.profile and name in one.values]
            values = [one.values[name].value for one in rivals]
            score = scores(values)[rivals.index(line)] if line in rivals else 0.0
            if abs(score) > _STANDS_OUT:
                out[name] = Outlier(float(np.median(values)), score)
        found.append(replace(line, stands_out=out))
    return found


def scores(values: Sequence[float]) -> list[float]:
    """Return the modified z-score of each value's ratio to the median. All values are positive; fewer than five get
    scores of zero.
    """
    if len(values) < _FEWEST or min(values) <= 0.0:
        return [0.0] * len(values)
    away = np.log(values) - np.median(np.log(values))
    usual = float(np.median(np.abs(away)))
    return [_MAD * float(one) / usual if usual > 0.0 else 0.0 for one in away]


def _drift(name: str, checks: Sequence[Measured]) -> tuple[Drift, float] | None:
    """Return the drift of a parameter per hour over the drift checks, and the mean value; None for fewer than three
    checks.
    """
    known = [one for one in checks if name in one.values and one.created]
    if len(known) < 3:
        return None
    moments = [datetime.fromisoformat(one.created) for one in known]
    hours = np.array([(moment - moments[0]).total_seconds() / 3600.0 for moment in moments])
    if not np.ptp(hours) > 0.0:
        return None
    values = np.array([one.values[name].value for one in known])
    return drift(hours, values, np.array([one.values[name].error for one in known])), float(values.mean())
