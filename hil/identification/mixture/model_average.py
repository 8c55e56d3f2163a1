"""Average over models that the data cannot decide between: estimates and errors that include the choice of model.

All models are contained in the largest one. If some parameters of the largest model are left out, the others change as
the sampling covariance says, to first order, and the likelihood falls by the Wald statistic of the omitted parameters
(Hjort and Claeskens 2003), so one fit gives every model. The variance of the average is the mean of the models'
variances plus the variance of their estimates (Buckland, Burnham and Augustin 1997; Burnham and Anderson 2004).

For the averaged value, a parameter is weighted by its odds in model selection. With the weights of Akaike's criterion
the value would follow noise that resembles a rare parameter. But a small rare effect may exist, and the interval must
include it: therefore the variance about the averaged value uses the weights of Akaike's criterion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from ga.arrays import Array
from hil.signals.constants import FAR_TAIL

AKAIKE: Final = 2.0
"""The cost of a parameter in Akaike's criterion if most benches have the parameter."""


@dataclass(frozen=True, eq=False)
class Average:
    """The averages of the parameters (p,) and their standard errors (p,), in their units.

    left_out: for each model the indices of the parameters that it lacks. weights: the weights of the models for the
    values, of sum one.
    """

    values: Array
    errors: Array
    left_out: tuple[tuple[int, ...], ...]
    weights: Array


def average(
    values: Array,
    covariance: Array,
    costs: Mapping[int, float],
    positive: Sequence[int],
    prior: Array,
    *,
    bounded: Sequence[int] = (),
) -> Average | None:
    """Return the average over all models with and without the doubtful parameters; None if no model is possible.

    values (p,) and covariance (p, p): of the model with all parameters. costs: for each doubtful parameter, by index,
    how much the parameter must raise twice the log likelihood for a model with it to be as likely as a model without
    it. positive: indices of parameters whose negative estimate makes a model impossible. prior (2, p): the expected
    value of each parameter and its standard deviation, infinite if nothing is known; the expected value has the more
    weight the less the data determine the parameter (ridge regression). bounded: parameters of every model that are set
    to zero if their estimate is negative, with the variance that they have without that bound.
    """
    variance = np.diag(covariance)  # negative by rounding: nearly dependent columns
    if not (np.isfinite(variance).all() and (variance > 0.0).all()):
        return None
    size = np.sqrt(variance)
    values, covariance = _penalised(values / size, covariance / np.outer(size, size), prior[0] / size, size / prior[1])
    found = []
    for count in range(len(costs) + 1):
        for left_out in combinations(costs, count):
            estimates, variances, fall = _bounded(values, covariance, list(left_out), bounded)
            if all(estimates[at] >= 0.0 for at in positive if at not in left_out):
                found.append((left_out, estimates, variances, fall))
    if not found:
        return None
    left, falls = tuple(one[0] for one in found), np.array([one[3] for one in found])
    each, weights = np.array([one[1] for one in found]), _weights(falls, left, costs)
    mean = weights @ each
    spread = _weights(falls, left, dict.fromkeys(costs, AKAIKE))
    variance = spread @ (np.array([one[2] for one in found]) + (each - mean) ** 2)
    return Average(mean * size, np.sqrt(variance) * size, left, weights)


def without_positive(values: Array, covariance: Array, prior: Array) -> tuple[Array, Array, float]:
    """Integrate over the last parameter: return values (p - 1,) and covariance (p - 1, p - 1) of the others, and a
    change of criterion.

    prior (2, p): see `average`. The last parameter is expected around zero and cannot be negative, so its distribution
    is the positive part of a normal distribution, represented by its mean and variance. The last result is Akaike's
    criterion with the parameter less that without. Its penalty is weighted by how far the data, and not the expected
    size, determine the parameter.
    """
    size = np.sqrt(np.diag(covariance))
    values, covariance = _penalised(values / size, covariance / np.outer(size, size), prior[0] / size, size / prior[1])
    # where the data say next to nothing of it, rounding leaves zero of its variance, or more than of its likely size
    most, error = float(prior[1, -1] / size[-1]), math.sqrt(max(float(covariance[-1, -1]), 0.0))
    error = min(error or most, most)
    centre = float(values[-1]) / error
    mean, spread = _positive_part(centre)
    gain = covariance[:, -1] / error
    moved = (values + gain * (mean - centre)) * size
    changed = (covariance + np.outer(gain, gain) * (spread**2 - 1.0)) * np.outer(size, size)
    seen = 1.0 - (error * size[-1] / prior[1, -1]) ** 2
    return moved[:-1], changed[:-1, :-1], float(AKAIKE * seen - max(centre, 0.0) ** 2)


def _positive_part(centre: float) -> tuple[float, float]:
    """Return mean and standard deviation of the positive part of a normal distribution with mean `centre` and standard
    deviation one.
    """
    if centre < FAR_TAIL:  # the tail of an exponential distribution, by its first term
        return -1.0 / centre, -1.0 / centre
    ratio = math.exp(-0.5 * centre**2) / (math.sqrt(0.5 * math.pi) * math.erfc(-centre / math.sqrt(2.0)))
    return centre + ratio, math.sqrt(1.0 - ratio * (ratio + centre))


def _weights(falls: Array, left_out: Sequence[Sequence[int]], costs: Mapping[int, float]) -> Array:
    """Return the weights (m,) of m models, of sum one.

    falls (m,): how much twice the log likelihood of each model is below that of the largest. left_out: the parameters
    that each model lacks. costs: the cost that a model without a parameter saves.
    """
    criteria = falls - np.array([sum(costs[at] for at in one) for one in left_out])
    weights = np.exp(-0.5 * (criteria - criteria.min()))
    return np.asarray(weights / weights.sum())


def _penalised(values: Array, covariance: Array, centres: Array, precision: Array) -> tuple[Array, Array]:
    """Return values (p,) and covariance (p, p) after adding a quadratic penalty.

    centres (p,): the values without penalty. precision (p,): the weight of the penalty, the inverse of a variance.
    """
    known = np.flatnonzero(precision > 0.0)
    if not known.size:
        return values, covariance
    prior = np.diag(precision[known] ** -2.0)
    gain = np.linalg.solve(covariance[np.ix_(known, known)] + prior, covariance[known]).T
    return values - gain @ (values[known] - centres[known]), covariance - gain @ covariance[known]


def _bounded(
    values: Array, covariance: Array, left_out: list[int], bounded: Sequence[int]
) -> tuple[Array, Array, float]:
    """Return `_without` for some left-out parameters; bounded parameters that would be negative are set to zero."""
    estimates, variances, fall = _without(values, covariance, left_out)
    at_zero = list(left_out)
    while below := [at for at in bounded if estimates[at] < 0.0 and at not in at_zero]:
        at_zero += below
        estimates, _, fall = _without(values, covariance, at_zero)
        estimates[at_zero] = 0.0  # but for rounding
    return estimates, variances, fall


def _without(values: Array, covariance: Array, left_out: list[int]) -> tuple[Array, Array, float]:
    """Return values (p,) and variances (p,) of the model without the parameters `left_out`, and the fall of twice its
    log likelihood.
    """
    block = covariance[np.ix_(left_out, left_out)]
    gain = np.linalg.solve(block, covariance[left_out]).T
    without, fall = values - gain @ values[left_out], values[left_out] @ np.linalg.solve(block, values[left_out])
    variances = np.maximum(np.diag(covariance - gain @ covariance[left_out]), 0.0)
    return without, variances, float(fall)
