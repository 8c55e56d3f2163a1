"""Several recordings of one joint side by side: does it repeat, does it drift, and what is one recording worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.identification.dataset import torque_uncertainty
from hil.identification.disk_table import Progress
from hil.identification.identify import Search, identify
from hil.identification.model_choice import Coupling
from hil.identification.result import Estimate, Identification
from hil.identification.same_stand import check_together
from hil.recording.reader import Recording
from hil.uncertainty.random_effects import Drift, Pooled, between, drift

COMPARED = ("Kc", "Bc")
"""What is compared: the coupling; other terms are of the stand."""

_NORMAL = 1.959964  # half a 95 % interval in standard errors
_CHANCE = 0.05
_CARRIED = 1.96  # by which an interval carries the torque's uncertainty (`Spread.carrying`)
_ROUNDING = 1e-9  # of a value: the error of a recording without noise, which would outweigh all others
_HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class Measured:
    """What one recording tells. created: UTC, None where it is not known. hours: since the first of all.

    estimates: of COMPARED, by name; {} where the recording could not be used. told: the names of those that the
    recording can tell. model: that was fitted. uncertainty: of the torque's scale, relative, one standard deviation: it
    is in the intervals of all recordings of a stand alike, and so in no difference between them.
    """

    path: Path
    created: datetime | None
    hours: float
    model: str
    estimates: dict[str, Estimate]
    told: frozenset[str]
    uncertainty: float = 0.0


@dataclass(frozen=True, slots=True)
class Repeated:
    """One parameter over all recordings that tell it.

    pooled: None with fewer than two recordings; the torque's uncertainty is in its error and interval, and not in what
    lies within. drift: per hour, in the parameter's unit; None with fewer than three.
    repeats: whether nothing lies between the recordings that their own errors do not explain; None where it cannot be
    told. verdict: a sentence or two.
    """

    name: str
    unit: str
    told_by: tuple[Path, ...]
    pooled: Pooled | None
    drift: Drift | None
    repeats: bool | None
    verdict: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """What `hil compare` found."""

    model: str
    recordings: tuple[Measured, ...]
    parameters: tuple[Repeated, ...]
    diagnostics: tuple[Diagnostic, ...]

    @property
    def trustworthy(self) -> bool:
        """Whether there is no error among the diagnostics."""
        return not any(diagnostic.is_error for diagnostic in self.diagnostics)


def compare(
    paths: Sequence[Path], model: Coupling | None, search: Search, progress: Progress | None = None
) -> Comparison:
    """Identify `model` in each recording on its own, and tell what lies within them from what lies between.

    progress is called with the fraction that is done. Raises WrongUse for fewer than two recordings, for different
    stands, for the same run twice and for a model without Kc and Bc. A recording that cannot be used is left out, and
    said to be.
    """
    if len(paths) < 2:
        raise WrongUse("a comparison needs at least two recordings")
    if model is not None:
        names = [parameter.name for parameter in (*model.linear, *model.shape)]
        if not set(COMPARED) <= set(names):
            raise WrongUse(
                f"{' and '.join(COMPARED)} are compared, and model {model.name!r} has {', '.join(names)}: name them so "
                "in the model"
            )
    diagnostics = check_together(paths)
    created, imported = zip(*(_origin(path) for path in paths), strict=True)
    if any(imported):
        diagnostics.append(
            Diagnostic("time-unknown", "an imported recording does not say when it was made: no drift is told with it")
        )
    first = min((moment for moment in created if moment is not None), default=None)
    measured = []
    for index, path in enumerate(paths):
        found = _identified(path, model, search, diagnostics, _share(progress, index, len(paths)))
        hours = (created[index] - first).total_seconds() / _HOUR if created[index] and first else math.nan
        measured.append(
            replace(_measured(path, created[index], hours, model, found), uncertainty=torque_uncertainty(path))
        )
    diagnostics += _of_scale(measured)
    models = {one.model for one in measured if one.estimates}
    if len(models) > 1:
        said = ", ".join(sorted(models))
        diagnostics.append(
            Diagnostic(
                "models-differ", f"the recordings were fitted with different models ({said}): name one with --model"
            )
        )
    repeated = tuple(_repeated(name, measured) for name in COMPARED)
    diagnostics += [
        Diagnostic("cannot-compare", one.verdict, one.name, is_error=True) for one in repeated if one.pooled is None
    ]
    return Comparison(" or ".join(sorted(models)) or _name(model), tuple(measured), repeated, tuple(diagnostics))


def _name(model: Coupling | None) -> str:
    return "auto" if model is None else model.name


def _origin(path: Path) -> tuple[datetime | None, bool]:
    """When a recording was made, None where it is not known; and whether it was imported, at another time."""
    with Recording(path) as recording:
        if recording.profile.get("kind") == "imported":
            return None, True
        try:
            moment = datetime.fromisoformat(str(recording.attributes.get("created", "")))
        except ValueError:
            return None, False
        return (moment if moment.tzinfo else None), False


def _of_scale(measured: Sequence[Measured]) -> list[Diagnostic]:
    common = max(one.uncertainty for one in measured)
    if not common:
        return []
    return [
        Diagnostic(
            "scale-in-common",
            f"the torque's scale is uncertain by {common:.2g} of itself, in all recordings alike: that is in the "
            "intervals, and not in what lies within and between the recordings",
        )
    ]


def _share(progress: Progress | None, index: int, count: int) -> Progress | None:
    if progress is None:
        return None
    told = progress
    return lambda what, done: told(what, (index + done) / count)


def _identified(
    path: Path, model: Coupling | None, search: Search, diagnostics: list[Diagnostic], progress: Progress | None
) -> Identification | None:
    try:
        found = identify([path], model, search, progress)
    except Untrustworthy as error:
        diagnostics.append(Diagnostic("left-out", f"{error}; it is left out"))
        return None
    # of one recording among several: the comparison's own trust is judged by what is left
    diagnostics += [Diagnostic(one.code, f"{path}: {one.message}", one.parameter) for one in found.diagnostics]
    return found


def _measured(
    path: Path, created: datetime | None, hours: float, model: Coupling | None, found: Identification | None
) -> Measured:
    if found is None:
        return Measured(path, created, hours, _name(model), {}, frozenset())
    estimates = {name: found[name] for name in COMPARED}
    doubted = {diagnostic.parameter for diagnostic in found.diagnostics if diagnostic.is_error}
    told = {name for name, estimate in estimates.items() if estimate.identifiable and not {name, None} & doubted}
    return Measured(path, created, hours, found.model.name, estimates, frozenset(told))


def _repeated(name: str, measured: Sequence[Measured]) -> Repeated:
    told = [one for one in measured if name in one.told]
    estimates = [one.estimates[name] for one in told]
    values = np.array([estimate.exact for estimate in estimates])
    errors = np.array([standard_error(one.estimates[name], one.uncertainty) for one in told])
    paths = tuple(one.path for one in told)
    unit = next((one.estimates[name].unit for one in measured if name in one.estimates), "")
    if len(told) < 2:
        verdict = f"{name} cannot be compared: {len(told)} of {len(measured)} recordings tell it, and it takes two."
        return Repeated(name, unit, paths, None, None, None, verdict)
    pooled = between(values, errors)
    hours = np.array([one.hours for one in told])
    slope = drift(hours, values, errors) if len(told) > 2 and np.isfinite(hours).all() and np.ptp(hours) > 0 else None
    repeats = pooled.p_alike >= _CHANCE and (slope is None or slope.p >= _CHANCE)
    verdict = _verdict(name, pooled, slope, len(told))
    return Repeated(name, unit, paths, _carrying(pooled, max(one.uncertainty for one in told)), slope, repeats, verdict)


def _carrying(pooled: Pooled, uncertainty: float) -> Pooled:
    """The same with the uncertainty of the torque's scale in its error and interval."""
    scale = uncertainty * abs(pooled.value)
    half = math.hypot(0.5 * (pooled.ci95[1] - pooled.ci95[0]), _CARRIED * scale)
    error = math.hypot(pooled.standard_error, scale)
    return replace(pooled, standard_error=error, ci95=(pooled.value - half, pooled.value + half))


def standard_error(estimate: Estimate, uncertainty: float = 0.0) -> float:
    """An estimate's own standard error, in its unit, from its 95 % interval without the torque's uncertainty."""
    half = 0.5 * (estimate.ci95[1] - estimate.ci95[0])
    half = math.sqrt(max(half**2 - (_CARRIED * uncertainty * estimate.exact) ** 2, 0.0))
    return float(max(half / _NORMAL, _ROUNDING * abs(estimate.exact), math.ulp(0.0)))


def _verdict(name: str, pooled: Pooled, slope: Drift | None, count: int) -> str:
    scale = 100.0 / abs(pooled.value)
    within, apart = pooled.within * scale, pooled.between * scale
    low, high = (end * scale for end in pooled.between_ci95)
    if pooled.p_alike < _CHANCE:
        said = (
            f"{name} does not repeat: it differs from recording to recording by {apart:.2g} % (standard deviation; "
            f"95 %: {low:.2g} to {high:.2g} %), and one recording's own error is {within:.2g} %. Quote the pooled "
            "interval, never one recording's"
        )
    elif high < 0.1 * within:
        said = f"{name} repeats, more closely than the recordings' own errors of {within:.2g} % would have it"
    elif high > 2.0 * within:
        said = (
            f"{name} agrees within the recordings' own errors of {within:.2g} %, but {count} of them cannot rule out "
            f"that it differs by up to {high:.2g} %: record more"
        )
    else:
        said = (
            f"{name} repeats: what lies between the recordings is at most {high:.2g} %, and one recording's own error "
            f"is {within:.2g} %"
        )
    if slope is not None and slope.p < _CHANCE:
        said += f". It drifts by {slope.slope * scale:+.2g} % an hour (p = {slope.p:.2g})"
    return f"{said}."
