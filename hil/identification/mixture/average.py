"""Average Kc and Bc over the models that the data cannot decide between, so that the interval includes this choice.

Model selection leaves out every term that is not significant. But no bench is without offset, drift, friction and skew,
so the interval of the selected model alone is too narrow. The average is over the selected model with and without these
small effects, and with and without the terms for which the evidence is weak in either direction. A rare term, such as a
spring that curves, has the weight that model selection gives to that term: noise often looks a little like a cubic
spring, which changes Kc by far more than its standard error. An offset and a skew always exist. The skew has the size
that one recorder can produce, because the two readings of one tick never have the same age.

A delayed torque reading shows in fast motion, where the joint seems stiffer. A viscoelastic branch that relaxes faster
than the joint moves looks the same. In one joint of ten, a part of the apparent delay is caused by such a branch, and
that part must not be subtracted from Bc.

An angle that passed a filter, with a torque that passed none, looks like a delayed angle, and exactly like an inertia.
For each model with an inertia in place of a skew, both explanations are in the average.

In slow motion a delayed reading only looks like less damping. If no delay is selected, models with each likely delay
are added, weighted by their likelihood.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ga.model.coupling import CouplingModel
from ga.model.terms import CONSIDERED, PARAMETERS, TERMS, of_kind, size_of
from hil.identification.candidates.choice import Choice
from hil.identification.candidates.late import Alternative
from hil.identification.mixture.deflection import read_with_errors
from hil.identification.mixture.largest import BENCH, Largest, contains, largest_model, own_values
from hil.identification.mixture.rate_laws import falling, growing
from hil.identification.result import Step
from hil.signals import constants as c
from hil.signals.constants import NORMAL, UPPER
from hil.signals.prepare import Signals
from hil.uncertainty.criteria import dampings_behind_filter
from hil.uncertainty.model_average import AKAIKE, average

Array = NDArray[np.float64]

_RELAXING = (1.0 / 11.0 / 3.0) ** 0.5  # one joint in ten: any part of what looks late, a standard deviation
_FURTHER = (1.0 / 3.0) ** 0.5  # the same where two branches were found: what relaxes does so at more speeds
_PLACES = 2**44  # steps of a range, to one of which a quantile is found


@dataclass(frozen=True, slots=True)
class Averaged:
    """An estimate averaged over models, SI: its value, and the half width of its 95 % interval for noise and choice of
    model.
    """

    value: float
    half_width: float


def averaged(
    choice: Choice, signals: Signals, used: NDArray[np.bool_], nonlinear: Array, change: Mapping[str, float]
) -> dict[str, Averaged]:
    """Return Kc and Bc averaged over models around the selected one; {} if the larger models cannot be fitted.

    used (n,): which samples the model is fitted to. nonlinear (q,): the model's nonlinear parameters. change: the
    correction for errors of the deflection, SI, by name of the parameter; for larger models it is computed again.
    """
    if not (choice.steps and isinstance(choice.model, CouplingModel)):
        return {}
    kept = replace(signals, motion=signals.motion.of(used), torque=signals.torque[used], jerked=None)
    doubtful = {
        step.term: AKAIKE if step.term in BENCH else step.cost
        for step in choice.steps
        if step.term in CONSIDERED and _is_doubtful(step)
    }
    selected = Alternative(choice.model, nonlinear, 0.0)
    own = dict(zip((one.name for one in choice.model.nonlinear), nonlinear.tolist(), strict=True))
    seems_filtered = size_of(own, "delay") < 0.0 and signals.torque_from == "given"
    found, criteria = [], []

    def of_selected(larger: Largest) -> Array:
        return np.array([change.get(name, 0.0) for name in larger.names])

    by_errors: dict[tuple[str, ...], Array] = {}

    def of_larger(larger: Largest) -> Array:
        names = tuple(larger.names)
        if names not in by_errors:
            by_errors[names] = _by_errors(larger, signals, used)
        return by_errors[names]

    for one in (selected, *choice.alternatives):
        # an alternative with other terms may be far off, and with it what errors would do to its parameters
        is_own = one.model.name == choice.model.name
        by_change = of_larger if is_own and any(change.values()) else of_selected
        around = _around(one, doubtful, kept, by_change, grows=is_own)
        if not around and one is selected:
            return {}
        if not is_own and seems_filtered:
            around += _behind_filter(one, around, kept)
        found += [values for values, _ in around]
        criteria += [one.criterion + more for _, more in around]
    for late in choice.lateness:
        stiff, damped = (found[0][name].half_width for name in c.COUPLING)
        damped = float(np.hypot(damped, NORMAL * late.spread))
        found.append({"Kc": Averaged(late.Kc + change["Kc"], stiff), "Bc": Averaged(late.Bc + change["Bc"], damped)})
        criteria.append(late.criterion)
    weights = np.exp(-0.5 * (np.array(criteria) - min(criteria)))
    weights /= weights.sum()
    mixed = {name: _mixed(weights, [one[name] for one in found]) for name in c.COUPLING}
    bc, hidden = mixed["Bc"], NORMAL * _hidden(selected, kept, mixed["Kc"].value)
    return mixed | {"Bc": Averaged(bc.value, float(np.hypot(bc.half_width, hidden)))}


def _behind_filter(
    one: Alternative, around: Sequence[tuple[dict[str, Averaged], float]], data: Signals
) -> list[tuple[dict[str, Averaged], float]]:
    """Return the estimates of a model with an inertia, for a joint whose angle passed a filter; [] if the model has no
    inertia.

    one: the model. around: the averages of Kc and Bc for this model, each with its difference of Akaike's criterion.
    Inertia and filter give the same torque (`damping_behind_filter`), so neither is likelier. Of the two filters that
    explain the inertia, the faster one is used, because the user would know of a slow filter.
    """
    inertia = size_of(own_values(one, data), "moment of inertia")
    found = []
    for mean, criterion in around:
        stiff, damped = mean["Kc"], mean["Bc"]
        behind = dampings_behind_filter(stiff.value, damped.value, inertia)
        if not behind:
            continue
        # by how much it changes with the damping that is seen, and it is no more than that
        gain = behind[-1] / max(behind[-1] - behind[0], 1e-300)
        half_width = min(gain * damped.half_width, damped.half_width + damped.value)
        found.append((mean | {"Bc": Averaged(behind[-1], half_width)}, criterion))
    return found


def _hidden(one: Alternative, data: Signals, stiffness: float) -> float:
    """Return the standard deviation, N m s/rad, of the damping that Bc would contain wrongly if a branch caused a part
    of the delay.

    For a model with one branch, `LateReading.lateness` already contains every second branch. A third branch is assumed
    to relax faster than the second by the same ratio as the second does than the first. To second order a branch of
    stiffness K and time constant tau delays the torque by K tau^2/Bc and adds a damping of K tau; in fast motion both
    branches act as stiffness.
    """
    nonlinear = dict(zip((own.name for own in one.model.nonlinear), one.nonlinear.tolist(), strict=True))
    late = sum(abs(nonlinear[name]) for name in of_kind(nonlinear, "delay", "lag time"))
    times = sorted(nonlinear[name] for name in of_kind(nonlinear, "relaxation time"))
    if late == 0.0 or len(times) < 2:
        return float(_RELAXING * stiffness * late)
    values, (fast, slow) = own_values(one, data), times[:2]
    stiffest = stiffness + size_of(values, "relaxing stiffness")
    return float(_FURTHER * late * (stiffest + values["Bc"] * slow / fast**2))


def _mixed(weights: Array, found: Sequence[Averaged]) -> Averaged:
    """Return the median of a mixture of normal estimates, and the half width of the range that contains its middle 95
    %.

    weights (m,): the weights of the estimates, of sum one. A standard deviation would miss a distant model with a
    probability of one in ten. The mean would follow such a model where no data support it.
    """
    values, errors = (np.array(of) for of in zip(*((one.value, one.half_width) for one in found), strict=True))
    low, high = float(np.min(values - 2.0 * errors)), float(np.max(values + 2.0 * errors))
    step = (high - low) / _PLACES  # scipy.optimize would take a tenth of a run to import

    def beyond(share: float) -> float:
        def below(place: int) -> float:
            return float(weights @ ndtr(NORMAL * (low + place * step - values) / errors))

        return low + step * bisect_left(range(_PLACES), share, key=below)

    least, value, most = beyond(1.0 - UPPER), beyond(0.5), beyond(UPPER)
    return Averaged(value, max(most - value, value - least))


def _by_errors(larger: Largest, signals: Signals, used: NDArray[np.bool_]) -> Array:
    """Return the correction (p,) of the larger model's parameters for errors of the deflection.

    The correction is computed at the larger model's fit, which is linearised at a smaller model. That fit may lie
    beyond the bounds, where no torque can be computed; then the values at the bounds are used.
    """
    found, count = np.zeros(len(larger.values)), len(larger.model.parameters)
    values, linear = larger.values[:count].copy(), len(larger.model.linear)
    values[linear:] = np.clip(values[linear:], *larger.model.bounds(signals.motion, signals.band[1]))
    sampling = larger.sampling
    one_sigma, half_width = np.sqrt(np.maximum(np.diag(sampling.matrix), 0.0)), np.full(len(found), np.inf)
    half_width = np.multiply(sampling.quantile, one_sigma, out=half_width, where=sampling.distinct)[:count]
    errors = read_with_errors(larger.model, signals, used, values, half_width)
    if errors is not None:
        found[:count] = errors.change
    return found


def _around(
    model: Alternative,
    doubtful: Mapping[str, float],
    data: Signals,
    by_errors: Callable[[Largest], Array],
    *,
    grows: bool,
) -> list[tuple[dict[str, Averaged], float]]:
    """Return averages of Kc and Bc for one model with and without the effects that every bench has; [] if impossible.

    The first average is over all models contained in the largest one. The next are the averages with friction that
    falls with the rate and, if `grows`, with damping that grows with the rate. Each average has its difference of
    Akaike's criterion. If the larger model does not contain the smaller one, its average would be wrong: then the
    values of the smaller model are returned, and the distance to the average is included in their half widths.

    doubtful: the terms that the data do not decide on, and the cost of each. by_errors: a function that returns the
    correction of all parameters for errors of the deflection.
    """
    largest = largest_model(model, tuple(doubtful), data)
    if largest is None:
        return []
    change = by_errors(largest)
    found = [(largest, 0.0), *falling(largest, data.motion)]
    found = [(replace(one, values=one.values + change), criterion) for one, criterion in found]
    found += growing(largest, model, tuple(doubtful), data, by_errors) if grows else []
    means = [(_mean(one, doubtful), criterion) for one, criterion in found]
    if not means[0][0]:
        return []
    means = [one for one in means if one[0]]
    if contains(largest, model, data):
        return means
    own = own_values(model, data)
    values = {name: own[name] + float(change[largest.names.index(name)]) for name in c.COUPLING}
    return [({name: _about(values[name], mean[name]) for name in c.COUPLING}, more) for mean, more in means]


def _about(value: float, mean: Averaged) -> Averaged:
    """Return `value` as an estimate. Its half width combines that of `mean` with the distance between `value` and
    `mean`.
    """
    return Averaged(value, math.hypot(mean.half_width, mean.value - value))


def _mean(largest: Largest, doubtful: Mapping[str, float]) -> dict[str, Averaged]:
    """Return Kc and Bc averaged over all models contained in the largest one; {} if no such average exists.

    doubtful: the terms for which the data do not decide, with the cost of each.
    """
    names, sampling = largest.names, largest.sampling
    costs = largest.costs(doubtful)
    found = average(
        largest.values,
        sampling.matrix,
        {at: costs[name] for at, name in enumerate(names) if name in costs},
        # the model's own terms were found possible without what is added: a skew beside an inertia takes it over, and
        # the inertia is then zero
        [at for at, name in enumerate(names) if name in costs and name in PARAMETERS and PARAMETERS[name].positive],
        largest.likely,
        bounded=[names.index(one.name) for one in largest.model.linear if one.positive and one.name not in costs],
        seldom=[names.index(name) for name in largest.seldom],
    )
    if found is None:
        return {}
    return {
        name: Averaged(float(found.values[at]), float(sampling.quantile[at] * found.errors[at]))
        for at, name in enumerate(names)
        if name in c.COUPLING
    }


def _is_doubtful(step: Step) -> bool:
    """Return whether the evidence for or against the term of a step is weak."""
    term = TERMS[step.term]
    return term.linear and term.selection != "smallest" and abs(step.gain) < -c.EVIDENCE_AGAINST
