"""Average Kc and Bc over the models that the data cannot decide between, so that the interval includes this choice.

Model selection leaves out every term that is not significant. But no bench is without offset, drift, friction and skew,
so the interval of the selected model alone is too narrow. The average is over the selected model with and without these
small effects, and with and without the terms for which the evidence is weak in either direction. A rare term, such as a
spring that curves, has the weight that model selection gives to that term: noise often looks a little like a cubic
spring, which changes Kc by far more than its standard error.

The torque reading of every bench is a little late or early. Nine benches of ten have the skew of one recorder, because
the two readings of one tick never have the same age; the tenth has a torque that is later, as that of a slow cell is.
Both likely sizes are in the average, each weighted by how well it explains the skew that the data show. In slow motion
they show none: a late reading then only looks like less damping.

A viscoelastic branch that relaxes faster than the joint moves looks like a late reading too. In one joint of ten, a
part of the apparent delay is caused by such a branch, and that part must not be subtracted from Bc.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from ga.arrays import Array, Mask
from ga.model.coupling import CouplingModel
from ga.model.terms import CONSIDERED, PARAMETERS, TERMS, of_kind, size_of
from hil.identification.candidates.choice import Choice
from hil.identification.deflection.correction import read_with_errors
from hil.identification.mixture.hidden import hidden, integrated
from hil.identification.mixture.largest import BENCH, Largest, Selected, largest_model
from hil.identification.mixture.model_average import AKAIKE, average
from hil.identification.result import Step
from hil.signals import constants as c
from hil.signals.constants import NORMAL, UPPER
from hil.signals.prepare import Signals


@dataclass(frozen=True, slots=True)
class Averaged:
    """An estimate averaged over models, SI: its value, and the half width of its 95 % interval, which covers noise and
    the choice of model.
    """

    value: float
    half_width: float


def averaged(
    choice: Choice, signals: Signals, used: Mask, nonlinear: Array, change: Mapping[str, float]
) -> dict[str, Averaged]:
    """Return Kc and Bc averaged over models around the selected one; {} if the larger models cannot be fitted.

    used (n,): which samples the model is fitted to. nonlinear (q,): the model's nonlinear parameters. change: the
    correction for errors of the deflection, SI, by name of the parameter; for the larger model it is computed again.
    """
    if not (choice.steps and isinstance(choice.model, CouplingModel)):
        return {}
    kept = replace(signals, motion=signals.motion.of(used), torque=signals.torque[used], jerked=None)
    selected = Selected(choice.model, nonlinear, kept)
    doubtful = {
        step.term: AKAIKE if step.term in BENCH else step.cost
        for step in choice.steps
        if step.term in CONSIDERED and _is_doubtful(step)
    }
    largest = largest_model(selected, tuple(doubtful))
    if largest is None:
        return {}
    more = _by_errors(largest, signals, used) if any(change.values()) else np.zeros(len(largest.values))
    likely = _likely_models(largest, more, selected)
    means = [(mean, against) for one, against in likely if (mean := _mean(one, doubtful))]
    if not means:
        return {}
    found, against = [mean for mean, _ in means], [odds for _, odds in means]
    best = against.index(min(against))
    for rival, odds in _rivals(choice, (*doubtful, *BENCH), found[best]):
        found, against = [*found, rival], [*against, against[best] + odds]
    weights = np.exp(-0.5 * (np.array(against) - against[best]))
    mixed = {name: _mixed(weights / weights.sum(), [one[name] for one in found]) for name in c.COUPLING}
    bc, further = mixed["Bc"], NORMAL * _hidden(selected, mixed["Kc"].value)
    return mixed | {"Bc": Averaged(bc.value, float(np.hypot(bc.half_width, further)))}


def _rivals(
    choice: Choice, apart: Collection[str], best: Mapping[str, Averaged]
) -> Iterator[tuple[dict[str, Averaged], float]]:
    """Yield Kc and Bc of each model with one term more that was refused although the evidence against it is weak, and
    twice the log odds against it; it is no likelier than `best`. apart: terms that are averaged over in another way.
    """
    terms = {*choice.model.name.split("+")}
    chosen = [step for step in choice.steps if {*step.model.split("+")} == terms]
    for step in choice.steps if chosen else ():
        larger = {*step.model.split("+")} == {*terms, step.term} > terms
        if larger and step.term not in apart and step.gain > -c.STRONG:
            change = {name: getattr(step, name) - getattr(chosen[-1], name) for name in best}
            rival = {name: replace(best[name], value=best[name].value + change[name]) for name in best}
            yield rival, max(-step.gain, 0.0)


def _likely_models(largest: Largest, more: Array, selected: Selected) -> Iterator[tuple[Largest, float]]:
    """Yield the largest model for each likely age of the torque reading, alone and with each effect that the recording
    may hide, with twice the log odds against each.

    more (p,): the correction for errors of the deflection. The hidden effects of one kind together are at most as
    likely as the likeliest model without: where the joint reverses, errors of the rate look like most of them.
    """
    aged = [*_late(replace(largest, values=largest.values + more), selected)]
    yield from aged
    least = min(odds for _, odds in aged)
    for larger, effect in hidden(largest, selected):
        found = [(*integrated(larger, effect.size, one.prior), odds) for one, odds in aged]
        against = [odds + further + effect.against for _, further, odds in found]
        too_likely = max(least - min(against), 0.0) + 2.0 * math.log(effect.among)
        for (one, *_), odds in zip(found, against, strict=True):
            if one.is_possible:
                yield replace(one, values=one.values + more), odds + too_likely


def _late(largest: Largest, selected: Selected) -> Iterator[tuple[Largest, float]]:
    """Yield the largest model for a torque reading of usual age and for a late one, with twice the log odds against
    each.

    A skew d with the standard error e is as likely as a draw from a normal distribution of variance e^2 + s^2, where s
    is the standard deviation of the skew of such benches. A skew that was selected may have any size. The model is
    yielded as it is, if it has no skew.
    """
    delays = of_kind(largest.names, "delay")
    if not delays:
        yield largest, 0.0
        return
    at, is_selected = largest.names.index(delays[0]), bool(of_kind((p.name for p in selected.model.nonlinear), "delay"))
    found, variance = float(largest.values[at]), float(largest.sampling.matrix[at, at])
    usual = c.TICK_SHARE * float(np.median(np.diff(selected.data.motion.time)))
    for size, odds_against in ((usual, 0.0), (math.inf if is_selected else c.LATE_READING, c.ONE_IN_TEN)):
        prior, both = largest.prior.copy(), variance + size**2
        prior[1, at] = size
        by_size = found**2 / both + math.log(both / variance) if math.isfinite(size) else AKAIKE
        yield replace(largest, prior=prior), odds_against + by_size


def _hidden(one: Selected, stiffness: float) -> float:
    """Return the standard deviation, N m s/rad, of the damping that Bc would contain wrongly if a branch caused a part
    of the delay.

    A further branch is assumed to relax faster than the fastest one of the model by the same ratio as that does than
    the next. To second order a branch of stiffness K and time constant tau delays the torque by K tau^2/Bc and adds a
    damping of K tau; in fast motion all branches act as stiffness.
    """
    nonlinear = dict(zip((own.name for own in one.model.nonlinear), one.nonlinear.tolist(), strict=True))
    late = sum(abs(nonlinear[name]) for name in of_kind(nonlinear, "delay", "lag time"))
    times = sorted(nonlinear[name] for name in of_kind(nonlinear, "relaxation time"))
    if late == 0.0 or len(times) < 2:
        return float(c.RELAXING * stiffness * late)
    values, (fast, slow) = one.values, times[:2]
    stiffest = stiffness + size_of(values, "relaxing stiffness")
    return float(c.FURTHER * late * (stiffest + values["Bc"] * slow / fast**2))


def _mixed(weights: Array, found: Sequence[Averaged]) -> Averaged:
    """Return the median of a mixture of normal estimates, and the half width of the range that contains its middle 95
    %.

    weights (m,): the weights of the estimates, of sum one. A standard deviation would miss a distant model with a
    probability of one in ten. The mean would follow such a model where no data support it.
    """
    values, errors = (np.array(of) for of in zip(*((one.value, one.half_width) for one in found), strict=True))
    low, high = float(np.min(values - 2.0 * errors)), float(np.max(values + 2.0 * errors))
    step = (high - low) / c.PLACES  # scipy.optimize would take a tenth of a run to import

    def beyond(share: float) -> float:
        def below(place: int) -> float:
            return float(weights @ ndtr(NORMAL * (low + place * step - values) / errors))

        return low + step * bisect_left(range(c.PLACES), share, key=below)

    least, value, most = beyond(1.0 - UPPER), beyond(0.5), beyond(UPPER)
    return Averaged(value, max(most - value, value - least))


def _by_errors(larger: Largest, signals: Signals, used: Mask) -> Array:
    """Return the correction (p,) of the larger model's parameters for errors of the deflection.

    The correction is computed at the larger model's fit, which is linearised at a smaller model. The fit of the
    larger model may lie beyond the bounds, where no torque can be computed; then the values at the bounds are used.
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


def _mean(largest: Largest, doubtful: Mapping[str, float]) -> dict[str, Averaged]:
    """Return Kc and Bc averaged over all models contained in the largest one; {} if no such average exists.

    doubtful: the terms that the model may lack, each with what the score must rise by for it to be likely.
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
        largest.prior,
        bounded=[names.index(one.name) for one in largest.model.linear if one.positive and one.name not in costs],
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
    return term.linear and term.selection != "smallest" and abs(step.gain) < c.STRONG
