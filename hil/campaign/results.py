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
from hil.identification.result import widened
from hil.identification.verdict.random_effects import Drift, between, drift
from hil.recording.reader import Recording

PARAMETERS = ("Kc", "Bc")
BESIDE = ("Fc", "Fd", "mu", "gap")
"""Friction and play, which a joint has only if its model has the term."""
_NORMAL = 1.959964  # half a 95 % interval in standard errors
_CHANCE = 0.05
_STANDS_OUT = 3.5  # modified z-score (Iglewicz and Hoaglin 1993)
_MAD = 0.6745  # of a normal distribution, in standard deviations
_FEWEST = 5  # values among which one can stand out


@dataclass(frozen=True, slots=True)
class Value:
    """The value of one parameter with its 95 % interval, SI.

    torque_uncertainty: relative standard uncertainty of the torque's scale, which `ci95` includes. highest: the upper
    end of the interval if that scale is exact, None if `ci95` is that interval.
    """

    value: float
    ci95: tuple[float, float]
    unit: str
    torque_uncertainty: float = 0.0
    highest: float | None = None

    @property
    def error(self) -> float:
        """The standard error without the torque's scale, computed from half the 95 % interval; never zero."""
        high = self.ci95[1] if self.highest is None else self.highest
        return max((high - self.value) / _NORMAL, 1e-9 * abs(self.value), math.ulp(0.0))


@dataclass(frozen=True, slots=True)
class Measured:
    """A run with the parameters that may be trusted. failure: why there is no recording or no result, otherwise "".
    created: date of the recording. diagnostics: the warnings and errors of its result. beside: friction and play.
    """

    run: Run
    values: Mapping[str, Value]
    failure: str = ""
    created: str = ""
    diagnostics: tuple[Diagnostic, ...] = ()
    beside: Mapping[str, Value] = field(default_factory=dict)


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
    hand. beside: friction and play, pooled.
    """

    joint: str
    profile: str
    pretension: str
    measured: tuple[Measured, ...]
    values: Mapping[str, Value]
    repeats: Mapping[str, bool | None]
    stands_out: Mapping[str, Outlier] = field(default_factory=dict)
    beside: Mapping[str, Value] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The names of joint, pretension and profile, joined with commas."""
        return ", ".join(part for part in (self.joint, self.pretension, self.profile) if part)

    @property
    def missing(self) -> list[str]:
        """The parameters that no run identifies."""
        return [name for name in PARAMETERS if name not in self.values]


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
        """Return whether every run has a result, and every line all parameters."""
        return not self.failed and not any(line.missing for line in self.lines)


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
    scale = found.get("torque_scale", {}).get("uncertainty") or 0.0  # an old result has no such entry
    usable = {name: _value(one, scale) for name, one in found["parameters"].items() if _usable(one)}
    values = {name: usable[name] for name in PARAMETERS if name in usable}
    beside = {name: usable[name] for name in BESIDE if name in usable}
    texts = dict.fromkeys(one["message"] for one in found["errors"])
    reasons = "; ".join(one for one in texts if not any(other != one and other in one for other in texts))
    with Recording(run.path) as recording:
        created = str(recording.attributes.get("created", ""))
    said = tuple(
        Diagnostic(one["code"], f"{run.name}: {one['message']}", one["parameter"], is_error=severity == "errors")
        for severity in ("errors", "warnings")
        for one in found[severity]
    )
    return Measured(run, values, "" if values else reasons or "neither Kc nor Bc may be trusted", created, said, beside)


def _usable(one: dict[str, Any]) -> bool:
    return bool(one.get("trusted")) and None not in (one["value"], *one["ci95"])


def _value(one: dict[str, Any], scale: float) -> Value:
    low, high = one["ci95"]
    exact = one.get("ci95_without_torque_scale", (low, high))[1]
    is_scaled = "N*m" in one["unit"]
    return Value(one["value"], (low, high), one["unit"], scale if is_scaled else 0.0, exact)


def _line(key: tuple[str, str, str], measured: Sequence[Measured]) -> Line:
    pooled = {name: _pooled([one.values[name] for one in measured if name in one.values]) for name in PARAMETERS}
    beside = {name: _pooled([one.beside[name] for one in measured if name in one.beside])[0] for name in BESIDE}
    return Line(
        *key,
        tuple(measured),
        {name: value for name, (value, _) in pooled.items() if value is not None},
        {name: agree for name, (_, agree) in pooled.items()},
        beside={name: value for name, value in beside.items() if value is not None},
    )


def _pooled(known: Sequence[Value]) -> tuple[Value | None, bool | None]:
    """Return the mean of a parameter over the runs, and whether they agree within their own errors; None if unknown."""
    if len(known) < 2:
        return (known[0] if known else None), None
    pooled = between(np.array([one.value for one in known]), np.array([one.error for one in known]))
    scale = max(one.torque_uncertainty for one in known)  # the stand's, and the same in all runs
    ends = widened(pooled.value, pooled.ci95, scale)
    return Value(pooled.value, ends, known[0].unit, scale, pooled.ci95[1]), pooled.p_alike >= _CHANCE


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
