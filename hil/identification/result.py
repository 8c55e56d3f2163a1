"""The result of an identification, from which the report is made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ga.arrays import Array, Mask
from ga.model.separable import SeparableModel
from ga.trials.outcome import Trials
from hil.diagnostics import Diagnostic
from hil.identification.deflection.correction import Method
from hil.identification.misfit.dynamic_stiffness import DynamicStiffness
from hil.identification.misfit.outcome import LackOfFit
from hil.recording.channels import TorqueScale
from hil.signals import constants as c
from hil.signals.prepare import Signals


@dataclass(frozen=True, slots=True)
class Step:
    """One model of the selection, and the gain of its last term.

    model: the model's name. term: its last term. fitness: mean |error| of all samples, N m. held_out: mean |error| of
    blocks that the fit did not see, N m. gain: the gain in score by `term` beyond chance, NaN for the first model. Kc,
    Bc: their values, SI. included: whether the term is in the selected model. cost: twice the log odds against the term
    before the data are seen.
    """

    model: str
    term: str
    fitness: float
    held_out: float
    gain: float
    Kc: float
    Bc: float
    included: bool
    cost: float


@dataclass(frozen=True, slots=True)
class Repeatability:
    """One parameter over the optimiser's trials: its value in the best trial, and mean and standard deviation over all
    trials.

    These numbers show how well the optimiser repeats; the uncertainty is the confidence interval. std: NaN for a single
    trial.
    """

    best: float
    mean: float
    std: float


@dataclass(frozen=True, slots=True)
class VarianceComponents:
    """The scatter of one parameter, in its unit. within: its standard error in a recording. between: its standard
    deviation between recordings.

    values: the estimate of each recording alone, NaN if the recording cannot estimate the parameter. p_alike: the
    probability of values this far apart if the recordings did not differ.
    """

    within: float
    between: float
    values: tuple[float, ...] = ()
    p_alike: float = 1.0


@dataclass(frozen=True, slots=True)
class Conditional:
    """The estimate of one parameter by the selected model alone, SI: the exact optimum and its 95 % interval."""

    value: float
    ci95: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimate of one parameter, SI.

    value: the exact optimum, or its average over models. ci95: the 95 % interval. conditional: the estimate by the
    selected model alone, None if `value` and `ci95` are that estimate. bounds: the searched range, NaN if the parameter
    was computed exactly and not searched. components: variance within and between pooled recordings, None for a single
    recording and if fewer than two recordings identify the parameter. depends_on: the quantity that the parameter
    changes with, such as "amplitude", if it has no single value: `ci95` then spans its values, and `value` is the
    middle. positive: whether the parameter cannot be negative for physical reasons. correlation: of its sampling
    error with those of all parameters, by name. widths: what half the width of `ci95` consists of, by source; ranges
    and a misfit are added to the root of the sum of squares of the others. ci95_without_scale: the 95 % interval if
    the torque's scale is exact, None if `ci95` is that interval.
    """

    name: str
    unit: str
    value: float
    ci95: tuple[float, float]
    optimiser: Repeatability = field(repr=False)
    identifiable: bool
    at_bound: str | None
    bounds: tuple[float, float] = field(repr=False)
    components: VarianceComponents | None = field(default=None, repr=False)
    conditional: Conditional | None = field(default=None, repr=False)
    depends_on: str | None = None
    positive: bool = False
    correlation: Mapping[str, float] = field(default_factory=dict, repr=False)
    widths: Mapping[str, float] = field(default_factory=dict, repr=False)
    ci95_without_scale: tuple[float, float] | None = field(default=None, repr=False)

    @property
    def half_width(self) -> float:
        """Return half of the 95 % interval, before the interval is cut at zero."""
        return max(self.ci95[1] - self.value, self.value - self.ci95[0])

    @property
    def without_scale(self) -> Estimate:
        """Return the estimate with the interval that it has if the torque's scale is exact."""
        return replace(self, ci95=self.ci95_without_scale or self.ci95)

    @property
    def stderr(self) -> float:
        """Return the standard error of a normal distribution with the same 95 % interval."""
        return self.half_width / c.NORMAL

    @property
    def exact(self) -> float:
        """Return the exact optimum of the selected model, with which the optimiser's trials are compared."""
        return self.value if self.conditional is None else self.conditional.value

    @property
    def choice(self) -> float:
        """Return the fraction, 0 to 1, of the interval's width that comes from the choice of the model."""
        if self.conditional is None:
            return 0.0
        (low, high), (least, most) = self.ci95, self.conditional.ci95
        return max(0.0, 1.0 - (most - least) / (high - low)) if high > low else 0.0


@dataclass(frozen=True, slots=True)
class Validation:
    """The error of a fit to 80 % of the data on the held-out 20 %.

    fitness: mean |error|, N m. nrmse: r.m.s. error divided by the torque's standard deviation, NaN if that is zero.
    """

    fitness: float
    nrmse: float


@dataclass(frozen=True, slots=True)
class Fixture:
    """The compliance of the fixture, from an empty-rig recording; the Kc and Bc of the result are without it."""

    recording: Path
    model: str
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True, slots=True)
class Deflection:
    """The errors of the deflection and their effect on Kc and Bc.

    noise: standard deviation of the readings, rad. counts: the encoder counts of the motion, peak to peak. low_pass:
    corner frequency of the low-pass, Hz, None if deflection and rate needed none. method: how Kc and Bc were corrected.
    strength: the strength of the command as an instrument, 0 to 1; None if it was not needed or not recorded. before:
    the relative deviation of the uncorrected Kc and Bc from the corrected ones. predicted: the same deviation from a
    simulation of the errors.
    """

    noise: float
    counts: float
    low_pass: float | None
    method: Method
    strength: float | None
    before: Mapping[str, float]
    predicted: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Identification:
    """The result of `hil identify`.

    fitness: mean |error| of the best trial, N m. optimum: mean |error| of the exact solution, N m. optimiser_gap: how
    far `fitness` is above `optimum`, relative. steps: the steps of model selection, empty if the model was named.
    seconds: total time. search_seconds: time of the trials. torque_scale: how well the torque's scale
    is known. lack_of_fit: the test whether the model describes the recordings; dynamic_stiffness: the joint's
    stiffness without a model; both None if the recordings are too short. fixture: the fixture whose compliance was
    removed, None if it is assumed rigid. values (p + q,): the exact optimum, SI, for the signals, whose deflections may
    count from another zero than the estimates. fitted (n,): which samples of the signals were fitted. deflection: the
    errors of the deflection, None if they are too small to have an effect. windows: for each recording the first and
    last time that was used, s, None for all of it. reference: the deflection, rad, from which the signals' count.
    """

    recordings: tuple[Path, ...]
    model: SeparableModel
    steps: tuple[Step, ...]
    preset: str
    seed: int
    estimates: tuple[Estimate, ...]
    fitness: float
    optimum: float
    optimiser_gap: float
    samples: int
    trials: Trials
    seconds: float
    search_seconds: float
    validation: Validation
    diagnostics: tuple[Diagnostic, ...]
    signals: Signals
    values: Array
    fitted: Mask
    windows: tuple[tuple[float, float] | None, ...]
    torque_scale: TorqueScale
    lack_of_fit: LackOfFit | None = None
    dynamic_stiffness: DynamicStiffness | None = None
    fixture: Fixture | None = None
    deflection: Deflection | None = None
    reference: float = 0.0

    def __getitem__(self, name: str) -> Estimate:
        return next(estimate for estimate in self.estimates if estimate.name == name)

    @property
    def covariance(self) -> Array:
        """Return the covariance (p, p) of the parameters in their order, SI. A variance is the square of `stderr`.

        The error of the torque's scale is common to all parameters that are torques. What else is in a standard error
        correlates as the sampling errors of the selected model do. Infinite or NaN for a parameter that is not known.
        """
        errors = np.array([one.stderr for one in self.estimates])
        common = np.array([one.value * bool(one.ci95_without_scale) for one in self.estimates])
        common *= self.torque_scale.included
        rest = np.array([one.without_scale.stderr for one in self.estimates])
        names = [one.name for one in self.estimates]
        alike = np.array([[one.correlation.get(name, np.nan) for name in names] for one in self.estimates])
        found = alike * np.outer(rest, rest) + np.outer(common, common)
        np.fill_diagonal(found, errors**2)
        return np.asarray(found)

    def doubts(self, name: str) -> list[str]:
        """Return the codes of the errors that concern the parameter, or all parameters; empty if the parameter may be
        trusted.
        """
        return [one.code for one in self.diagnostics if one.is_error and one.parameter in {name, None}]

    def trusted(self, name: str) -> bool:
        """Return whether a parameter may be trusted. For a parameter that the model lacks, only errors that concern all
        parameters matter.
        """
        known = all(estimate.identifiable for estimate in self.estimates if estimate.name == name)
        return known and not self.doubts(name)

    @property
    def sign_is_wrong(self) -> bool:
        """Return whether torque or angle has the wrong sign: then no number of the result has a meaning."""
        return any(one.code == "implausible" and one.parameter is None for one in self.diagnostics)

    @property
    def trustworthy(self) -> bool:
        """Return whether there is no error among the diagnostics."""
        return not any(diagnostic.is_error for diagnostic in self.diagnostics)


def interval(value: float, half: float, *, positive: bool) -> tuple[float, float]:
    """Return the interval of a value with half width `half`, cut at zero if `positive`: the parameter cannot be
    negative.

    This is the interval of a truncated normal distribution: it contains a true value above zero as often as without the
    cut.
    """
    return max(value - half, 0.0) if positive and math.isfinite(half) else value - half, value + half


def widened(value: float, ends: tuple[float, float], scale: float, *, positive: bool = True) -> tuple[float, float]:
    """Return a 95 % interval with the uncertainty of the torque's scale, relative, which more samples do not reduce."""
    half = max(ends[1] - value, value - ends[0])
    return interval(value, math.hypot(half, c.NORMAL * scale * value), positive=positive)


def with_scale(one: Estimate, uncertainty: float) -> Estimate:
    """Return the estimate of a parameter that is proportional to the torque, its intervals `widened`. Each end of an
    interval that spans several values moves by the uncertainty of that end.
    """
    if not uncertainty:
        return one
    ends, alone = widened(one.value, one.ci95, uncertainty, positive=one.positive), one.conditional
    if one.depends_on:
        low, high = (widened(end, (end, end), uncertainty, positive=one.positive) for end in one.ci95)
        ends = low[0], high[1]
    if alone is not None:
        alone = replace(alone, ci95=widened(alone.value, alone.ci95, uncertainty, positive=one.positive))
    widths = {**one.widths, "torque's scale": c.NORMAL * uncertainty * abs(one.value)}
    return replace(one, ci95=ends, ci95_without_scale=one.ci95, conditional=alone, widths=widths)


def standard_error(estimate: Estimate) -> float:
    """Return the standard error of an estimate, in its unit, without the part that the torque's scale causes."""
    return float(max(estimate.without_scale.stderr, c.ROUNDED * abs(estimate.value), math.ulp(0.0)))
