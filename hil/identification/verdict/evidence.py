"""Evidence about each parameter from a fit and its recording: value, interval, bounds, and whether it is
identifiable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ga.arrays import Array
from ga.model.coupling import CouplingModel
from ga.model.record import Kind, Parameter
from ga.model.separable import SeparableModel
from ga.model.terms import of_kind, size_of
from ga.model.trajectory import Motion
from hil.identification.deflection.correction import DeflectionErrors
from hil.identification.fitting.confidence import ConfidenceIntervals
from hil.identification.fitting.solution import Solution
from hil.identification.fitting.unloaded import Span
from hil.identification.misfit.outcome import LackOfFit
from hil.identification.mixture.width import Width
from hil.identification.result import Conditional, Estimate, Repeatability, Validation, VarianceComponents, interval
from hil.identification.verdict.criteria import distinguishable, friction_likeness, narrow
from hil.signals import constants as c
from hil.signals.prepare import Signals


@dataclass(frozen=True, slots=True)
class Evidence:
    """The facts from which identifiability is derived.

    The model has p linear and q nonlinear parameters; `signals` has m samples. A half interval is half the width of a
    95 % interval.

    - reference: the encoder reading, rad, at which the deflection is zero.
    - solution: the result of the search and the exact optimum.
    - values (p + q,): the parameters, SI.
    - errors: the confidence intervals of the values.
    - widths: what the half intervals of `errors` consist of.
    - exact: values and half intervals of the selected model alone; `values` and `errors` may be averages over models.
    - scattered: the variance components of pooled recordings.
    - unbounded: the values without sign constraints, and their half intervals; None if no constraint acts.
    - deflection: how much errors of the measured deflection change the values; None if its rate was recorded.
    - unmoved: the reason why the joint did not move; "" if it moved.
    - selected: whether model selection chose the model; False if the user named it.
    - span: the least and the largest Kc at the deflections that the joint reached; None if the model has a single Kc
      and the unloaded deflection is known.
    """

    model: SeparableModel
    signals: Signals
    reference: float
    solution: Solution
    values: Array
    errors: ConfidenceIntervals
    scattered: tuple[VarianceComponents | None, ...]
    holdout: Validation
    exact: tuple[Array, Array]
    widths: tuple[Width, ...] = ()
    unbounded: tuple[Array, Array] | None = None
    deflection: DeflectionErrors | None = None
    unmoved: str = ""
    selected: bool = False
    span: Span | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return all parameters, the linear ones first."""
        return (*self.model.linear, *self.model.nonlinear)

    @property
    def names(self) -> list[str]:
        """Return the names of all parameters."""
        return [parameter.name for parameter in self.parameters]

    @property
    def zeros(self) -> Array:
        """Return the zero of each parameter (p + q,): the encoder reading that a parameter counts from if it is a
        deflection, else 0.
        """
        return np.array([self.reference if parameter.place else 0.0 for parameter in self.parameters])

    @property
    def has_friction(self) -> bool:
        """Return whether a parameter of the model is friction."""
        return any(parameter.friction for parameter in self.parameters)

    def identifiable(self, at: int) -> bool:
        """Return whether the recording identifies the parameter with this index."""
        half, value, name = float(self.errors.half_width[at]), float(self.values[at]), self.names[at]
        found = distinguishable(half, float(self.errors.inflation[at])) or self._known_beside_its_term(at)
        if name == "Bc":  # friction that the model leaves out would be in it, whatever the interval
            found = found and self.friction_likeness < c.LIKE_FRICTION
        if name in c.COUPLING:
            found = found and narrow(half, value) and not self.unmoved
        if self.parameters[at].presence:
            found = found and half < abs(value)
        # of a gap that may be zero, the middle may be anywhere
        return found and all(self.identifiable(k) for k, one in enumerate(self.parameters) if one.about == name)

    def _known_beside_its_term(self, at: int) -> bool:
        """Return whether a parameter has a narrow interval although it resembles another parameter of its own term.

        Two such parameters together describe the shape of one law, as the rise and the exponent of an exponential
        stiffness do.
        """
        terms = self.model.terms if isinstance(self.model, CouplingModel) else ()
        alike = {one.name for term in terms for one in term.parameters if self.parameters[at] in term.parameters}
        if self.names[at] in c.COUPLING or not narrow(float(self.errors.half_width[at]), float(self.values[at])):
            return False
        others = self.solution.columns[:, [name not in alike for name in self.names]]
        own = self.solution.columns[:, at]
        left = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
        return bool(own @ own < c.INFLATION * (left @ left))

    @property
    def friction_likeness(self) -> float:
        """Return the fraction of a damping torque that dry friction would explain.

        0 if the model has friction, and for a user's own model, which may contain friction under any name.
        """
        return 0.0 if self.has_friction or not self.model.linear else friction_likeness(self.signals.motion.dtheta_dot)

    def contradicted(self, at: int) -> float | None:
        """Return the negative value that the data give to a parameter that cannot be negative; None if the data agree
        with zero.
        """
        if self.unbounded is None or not self.parameters[at].positive:
            return None
        value, half = (float(of[at]) for of in self.unbounded)
        return value if value + half < 0.0 else None

    def size_of(self, kind: Kind) -> float | None:
        """Return the value of the parameter of this kind; None if the model has none."""
        return next((float(self.values[self.names.index(name)]) for name in of_kind(self.names, kind)), None)

    def at_bound(self, at: int) -> str | None:
        """Return the end of its bounds, "low" or "high", that the exact optimum of a parameter reaches; None for
        neither.
        """
        value, half = (float(of[at]) for of in self.exact)
        low, high = self.solution.low[at], self.solution.high[at]
        near = min(c.RESOLVED * (high - low), half)
        if value <= low + near:
            return "low"
        return "high" if value >= high - near else None


def sliding(values: Mapping[str, float], deflected: float = 0.0) -> tuple[float, float] | None:
    """Return the stiffness, N m/rad, that friction adds to Kc before it slides, and the deflection, rad, up to which it
    does.

    None if friction adds no stiffness. values: parameters of a model, SI, by name. deflected: the deflection, rad, at
    whose torque proportional friction is computed.
    """
    length = size_of(values, "presliding length", "yielding length")
    force = size_of(values, "presliding friction", "yielding friction")
    force += size_of(values, "load share") * values.get("Kc", 0.0) * deflected
    return (force / length, length) if length > 0.0 else None


def span_of_stiffness(values: Mapping[str, float], *, sliding_only: bool = False) -> Span | None:
    """Return the smallest and the largest Kc, N m/rad, of a model without a single Kc, and the quantity on which Kc
    depends.

    None for a single Kc, and for two values of Kc that are close: Kc is then their mean. Friction in proportion to the
    torque does not count as a stiffness. values: the model's parameters, SI, by name. sliding_only: whether the
    stiffness before friction slides is ignored.
    """
    before = None if of_kind(values, "load share") else sliding(values)
    kc, half = values.get("Kc", 0.0), abs(size_of(values, "side stiffness"))
    if before is not None and before[0] > 0.0 and not sliding_only:
        return kc, kc + before[0], "amplitude"
    if kc + half > c.DIFFERENT * (kc - half):
        return kc - half, kc + half, "direction"
    return None


def span_met(motion: Motion, names: Sequence[str], values: Array, half_width: Array) -> Span | None:
    """Return `span_of_stiffness` of values (p + q,), SI, limited to the deflections that the motion reaches.

    half_width (p + q,): the half intervals of the values. The stiffness before friction slides is included only if it
    changes Kc by more than the interval of Kc.
    """
    given = dict(zip(names, values.tolist(), strict=True))
    return span_of_stiffness(given, sliding_only=_slides(motion, given, float(half_width[names.index("Kc")])))


def _slides(motion: Motion, values: Mapping[str, float], half_width: float) -> bool:
    """Return whether friction slides in nearly all of a motion, so that sticking changes Kc by less than half of its
    interval.

    values: the model's parameters, SI, by name. half_width: the half interval of Kc, N m/rad. The stiffening is the
    slope, over the deflection between two reversals, of friction that builds up as -1 + 2 (1 - exp(-x/reach)); it is
    small if the joint travels many times `reach`. The travel is that of a sine with the same standard deviation.
    """
    before = sliding(values)
    if before is None:
        return True
    reaches = 2.0 * 2.0**0.5 * float(np.std(motion.dtheta)) / before[1]
    left = float(np.exp(-reaches))
    part = 4.0 * 3.0 * (reaches * (1.0 - left) - 2.0 + 2.0 * (1.0 + reaches) * left) / reaches**3
    return bool(min(1.0, part) * before[0] <= half_width)


def estimates(evidence: Evidence) -> tuple[Estimate, ...]:
    """Return the estimates of all parameters in the model's order; parameters that are deflections count from the
    encoder's zero.
    """
    found, span, solution = [], evidence.span, evidence.solution
    trials = solution.trials
    for at, (parameter, zero) in enumerate(zip(evidence.parameters, evidence.zeros.tolist(), strict=True)):
        value, half = zero + float(evidence.values[at]), float(evidence.errors.half_width[at])
        exact, own = zero + float(evidence.exact[0][at]), float(evidence.exact[1][at])
        is_average = (exact, own) != (value, half)
        best, mean, std = (float(of[at]) for of in (trials.best, trials.mean, trials.std))
        found.append(
            Estimate(
                name=parameter.name,
                unit=parameter.unit,
                value=value,
                ci95=interval(value, half, positive=parameter.positive),
                optimiser=Repeatability(zero + best, zero + mean, std),
                identifiable=evidence.identifiable(at),
                at_bound=evidence.at_bound(at),
                bounds=(zero + float(solution.low[at]), zero + float(solution.high[at])),
                components=evidence.scattered[at],
                conditional=Conditional(exact, interval(exact, own, positive=parameter.positive))
                if is_average
                else None,
                depends_on=(span[2] or None) if span and parameter.name == "Kc" else None,
                positive=parameter.positive,
                correlation=dict(zip(evidence.names, evidence.errors.correlation[at].tolist(), strict=True)),
                widths={one.source: float(one.half[at]) for one in evidence.widths if one.half[at]},
            )
        )
    return tuple(found)


def with_misfit(found: tuple[Estimate, ...], fit: LackOfFit | None) -> tuple[Estimate, ...]:
    """Return the estimates, with the intervals of Kc and Bc widened by the size of the model's misfit.

    A parameter whose interval becomes too wide is not identifiable, unless another error already states the size of the
    misfit.
    """
    sizes = dict(zip(c.COUPLING, zip(fit.in_intervals, fit.at_zero, strict=True), strict=True)) if fit else {}
    nothing = (0.0, 0.0)  # of a parameter that is neither Kc nor Bc
    lacks = {
        one.name: size * (zero or abs(one.value)) for one in found for size, zero in [sizes.get(one.name, nothing)]
    }
    is_said = fit is not None and fit.misfit and fit.is_grave
    said = (fit.affected or one.name for one in found) if fit is not None and is_said else ("" for _ in found)
    return tuple(_wider(one, lacks[one.name], is_said=name == one.name) for one, name in zip(found, said, strict=True))


def _wider(one: Estimate, lack: float, *, is_said: bool) -> Estimate:
    """Return the estimate with its interval widened by a misfit.

    lack: the size of the misfit, in the parameter's unit. is_said: whether an error already states that size.
    Differences between pooled recordings also fail the lack-of-fit tests, and the interval already includes them: only
    the larger of the two widenings is used.
    """
    half = one.half_width
    more = lack if one.components is None else max(0.0, lack - half)
    if not more:
        return one
    known = one.identifiable and (is_said or narrow(half + more, one.value))
    ends, widths = interval(one.value, half + more, positive=one.positive), {**one.widths, "misfit of the model": more}
    return replace(one, ci95=ends, identifiable=known, widths=widths)
