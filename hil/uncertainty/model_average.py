"""Averages over models that the data cannot decide between: estimates and errors that include the choice.

All models are contained in one, the largest. Leaving some of its parameters out moves the others by what the sampling
covariance says, to first order, and costs the likelihood their Wald statistic (Hjort and Claeskens 2003), so that one
fit gives every model. The models are weighted by Akaike's criterion, and the variance of the average is the mean of
theirs plus that of their estimates (Buckland, Burnham and Augustin 1997; Burnham and Anderson 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Average:
    """The averages of the parameters (p,) and their standard errors (p,), in their units.

    left_out: for each model the numbers of the parameters that it does without; weights: of the models, of sum one.
    """

    values: Array
    errors: Array
    left_out: tuple[tuple[int, ...], ...]
    weights: Array


def average(
    values: Array, covariance: Array, doubtful: Sequence[int], positive: Sequence[int], likely: Array
) -> Average | None:
    """Return the average over all models with and without the doubtful parameters; None where none is possible.

    values (p,) and covariance (p, p): of the model with all of them. positive: parameters of which a negative estimate
    makes a model impossible. likely (2, p): what a parameter is likely to be, and one standard deviation of that,
    infinite where nothing is known: where the data say less, this does (ridge regression).
    """
    size = np.sqrt(np.diag(covariance))
    if not (np.isfinite(size).all() and (size > 0.0).all()):
        return None
    values, covariance = _penalised(
        values / size, covariance / np.outer(size, size), likely[0] / size, size / likely[1]
    )
    found = []
    for count in range(len(doubtful) + 1):
        for left_out in combinations(doubtful, count):
            estimates, variances, fall = _without(values, covariance, list(left_out))
            if all(estimates[at] >= 0.0 for at in positive if at not in left_out):
                found.append((left_out, estimates, variances, fall - 2.0 * count))
    if not found:
        return None
    criteria = np.array([one[3] for one in found])
    weights = np.exp(-0.5 * (criteria - criteria.min()))
    weights /= weights.sum()
    each = np.array([one[1] for one in found])
    mean = weights @ each
    variance = weights @ (np.array([one[2] for one in found]) + (each - mean) ** 2)
    return Average(mean * size, np.sqrt(variance) * size, tuple(one[0] for one in found), weights)


def _penalised(values: Array, covariance: Array, centres: Array, precision: Array) -> tuple[Array, Array]:
    """Values (p,) and covariance (p, p) with the penalty of parameters around centres (p,) of precisions (p,)."""
    known = np.flatnonzero(precision > 0.0)
    if not known.size:
        return values, covariance
    prior = np.diag(precision[known] ** -2.0)
    gain = np.linalg.solve(covariance[np.ix_(known, known)] + prior, covariance[known]).T
    return values - gain @ (values[known] - centres[known]), covariance - gain @ covariance[known]


def _without(values: Array, covariance: Array, left_out: list[int]) -> tuple[Array, Array, float]:
    """Values (p,) and variances (p,) of the model without some parameters, and the fall of twice its log likelihood."""
    block = covariance[np.ix_(left_out, left_out)]
    gain = np.linalg.solve(block, covariance[left_out]).T
    without, fall = values - gain @ values[left_out], values[left_out] @ np.linalg.solve(block, values[left_out])
    variances = np.maximum(np.diag(covariance - gain @ covariance[left_out]), 0.0)
    return without, variances, float(fall)
