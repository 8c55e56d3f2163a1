"""Compare several recordings of one joint: whether Kc and Bc repeat or drift, and whether one recording differs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from ga.model.separable import SeparableModel
from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.identification.each import Result, Task, identify_each
from hil.identification.fitting.solution import Search
from hil.identification.result import Estimate, Identification, standard_error, widened
from hil.identification.same_stand import same_stand_diagnostics
from hil.identification.user_model import refuse_without_coupling
from hil.identification.verdict.identifiability import uncertain_scale
from hil.identification.verdict.random_effects import Drift, Pooled, between, drift
from hil.recording.ahead import Progress
from hil.recording.channels import TorqueScale
from hil.recording.interval import Given
from hil.signals import constants as c
from hil.signals.source import Source, open_sources


@dataclass(frozen=True, slots=True)
class Measured:
    """The result of one recording.

    created: when it was recorded, UTC; None if unknown. hours: time since the first recording, h. estimates: the
    estimates of Kc and Bc, by name; {} if the recording could not be used. identifiable: the names of
    the parameters that the recording identifies. model: the fitted model. torque_scale: how well the torque's scale,
    which cancels in differences, is known. window: the first and the last time that was used, s; None for all of it.
    """

    path: Path
    created: datetime | None
    hours: float
    model: str
    estimates: dict[str, Estimate]
    identifiable: frozenset[str]
    torque_scale: TorqueScale
    window: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Repeated:
    """One parameter over all recordings that identify it.

    pooled: the common value and the variance components; None for fewer than two recordings. Its error and interval
    include the torque's uncertainty, its variance components do not. drift: the change per hour, in the parameter's
    unit; None for fewer than three recordings. repeats: whether the errors of the single recordings explain all
    differences; None if that cannot be decided. verdict: a sentence or two for the user.
    """

    name: str
    unit: str
    recordings: tuple[Path, ...]
    pooled: Pooled | None
    drift: Drift | None
    repeats: bool | None
    verdict: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """The result of `hil compare`: the result of each recording, Kc and Bc over all of them, and the diagnostics."""

    model: str
    recordings: tuple[Measured, ...]
    parameters: tuple[Repeated, ...]
    diagnostics: tuple[Diagnostic, ...]

    @property
    def trustworthy(self) -> bool:
        """Return whether there is no error among the diagnostics."""
        return not any(diagnostic.is_error for diagnostic in self.diagnostics)


def compare(
    given: Sequence[Given],
    model: SeparableModel | None,
    search: Search,
    progress: Progress | None = None,
) -> Comparison:
    """Identify `model` in each recording separately, and split the variance of Kc and Bc into that within and that
    between recordings.

    progress: a function that is called with the fraction done. A recording that cannot be
    used is left out with a warning. Raises WrongUse for fewer than two recordings, different stands, the same run
    twice, or a model without Kc and Bc.
    """
    if len(given) < 2:
        raise WrongUse("a comparison needs at least two recordings")
    refuse_without_coupling(model, "Kc and Bc are compared")
    with open_sources(given) as sources:
        diagnostics = same_stand_diagnostics(sources)
        created, imported = zip(*(_origin(source) for source in sources), strict=True)
        if any(imported):
            text = "an imported recording does not say when it was made: no drift is estimated with it"
            diagnostics.append(Diagnostic("hard-to-compare", text))
        first = min((moment for moment in created if moment is not None), default=None)
        all_found = identify_each([Task((one,), model, search) for one in given], progress)
        measured = []
        for source, moment, found in zip(sources, created, all_found, strict=True):
            hours = (moment - first) / timedelta(hours=1) if moment and first else math.nan
            measured.append(_measured(source, moment, hours, model, _usable(source.path, found, diagnostics)))
    models = sorted({one.model for one in measured if one.estimates})
    repeated = tuple(_repeated(name, measured) for name in c.COUPLING)
    diagnostics += uncertain_scale(TorqueScale.widest(one.torque_scale for one in measured))
    if len(models) > 1:
        text = f"the recordings were fitted with different models ({', '.join(models)}): name one with --model"
        diagnostics.append(Diagnostic("hard-to-compare", text))
    diagnostics += [
        Diagnostic("hard-to-compare", one.verdict, one.name, is_error=True) for one in repeated if one.pooled is None
    ]
    return Comparison(" or ".join(models) or _name(model), tuple(measured), repeated, tuple(diagnostics))


def _name(model: SeparableModel | None) -> str:
    return "auto" if model is None else model.name


def _origin(source: Source) -> tuple[datetime | None, bool]:
    """Return when a recording was made (None if unknown), and whether the file was imported from another format at a
    later time.
    """
    if source.recording.imported:
        return None, True
    try:
        moment = datetime.fromisoformat(str(source.recording.attributes.get("created", "")))
    except ValueError:
        return None, False
    return (moment if moment.tzinfo else None), False


def _usable(path: Path, found: Result, diagnostics: list[Diagnostic]) -> Identification | None:
    if isinstance(found, Untrustworthy):
        diagnostics.append(Diagnostic("hard-to-compare", f"{found}; it is left out"))
        return None
    # only warnings here: the comparison has its own errors, by the recordings that remain
    said = [one for one in found.diagnostics if one not in uncertain_scale(found.torque_scale)]  # which is said once
    diagnostics += [Diagnostic(one.code, f"{path}: {one.message}", one.parameter) for one in said]
    return found


def _measured(
    source: Source, created: datetime | None, hours: float, model: SeparableModel | None, found: Identification | None
) -> Measured:
    scale, window = source.torque_scale, source.recording.window
    if found is None:
        return Measured(source.path, created, hours, _name(model), {}, frozenset(), scale, window)
    estimates = {name: found[name] for name in c.COUPLING}
    # numbers of one model that lacks something are still comparable with each other
    doubted = {one.parameter for one in found.diagnostics if one.is_error and one.code != "misfit"}
    names = {name for name, estimate in estimates.items() if estimate.identifiable and not {name, None} & doubted}
    return Measured(source.path, created, hours, found.model.name, estimates, frozenset(names), scale, window)


def _repeated(name: str, measured: Sequence[Measured]) -> Repeated:
    usable = [one for one in measured if name in one.identifiable]
    values = np.array([one.estimates[name].value for one in usable])
    errors = np.array([standard_error(one.estimates[name]) for one in usable])
    paths = tuple(one.path for one in usable)
    unit = next((one.estimates[name].unit for one in measured if name in one.estimates), "")
    if len(usable) < 2:
        verdict = (
            f"{name} cannot be compared: {len(usable)} of {len(measured)} recordings identify it, and two are needed."
        )
        return Repeated(name, unit, paths, None, None, None, verdict)
    pooled = between(values, errors)
    hours = np.array([one.hours for one in usable])
    slope = drift(hours, values, errors) if len(usable) > 2 and np.isfinite(hours).all() and np.ptp(hours) > 0 else None
    repeats = pooled.p_alike >= c.SIGNIFICANT and (slope is None or slope.p >= c.SIGNIFICANT)
    verdict = _verdict(name, pooled, slope, len(usable))
    scale = max(one.torque_scale.included for one in usable)
    error, ends = math.hypot(pooled.standard_error, scale * pooled.value), widened(pooled.value, pooled.ci95, scale)
    return Repeated(name, unit, paths, replace(pooled, standard_error=error, ci95=ends), slope, repeats, verdict)


def _verdict(name: str, pooled: Pooled, slope: Drift | None, count: int) -> str:
    scale = 100.0 / abs(pooled.value)
    within, apart = pooled.within * scale, pooled.between * scale
    low, high = (end * scale for end in pooled.between_ci95)
    if pooled.p_alike < c.SIGNIFICANT:
        verdict = (
            f"{name} does not repeat: the recordings differ by {apart:.2g} % (standard deviation; 95 %: {low:.2g} to "
            f"{high:.2g} %), and the error of one recording is {within:.2g} %. Use the pooled interval, not that of "
            "one recording"
        )
    elif high < 0.1 * within:
        verdict = f"{name} repeats: the recordings differ by less than their own errors of {within:.2g} % predict"
    elif high > 2.0 * within:
        verdict = (
            f"{name} agrees within the error of one recording, {within:.2g} %, but {count} recordings are too few: "
            f"they may still differ by up to {high:.2g} %. Record more"
        )
    else:
        verdict = (
            f"{name} repeats: the recordings differ by at most {high:.2g} % (standard deviation), and the error of one "
            f"recording is {within:.2g} %"
        )
    if slope is not None and slope.p < c.SIGNIFICANT:
        verdict += f". It drifts by {slope.slope * scale:+.2g} % an hour (p = {slope.p:.2g})"
    return f"{verdict}."
