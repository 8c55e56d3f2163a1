"""How far the parameters can be told from one recording: the sampling error of a least-absolute-deviations fit.

For residuals e and columns X the estimate is asymptotically normal with covariance A^-1 B A^-1 (Koenker, Quantile
Regression, 2005, section 4.3), where A is twice the sum of x x' weighted with the residuals' density at zero (Powell's
kernel estimate) and B the covariance of the sum of x sign(e). B is taken over blocks in time, so that residuals that
follow each other, as they do on any real stand, widen the interval instead of being counted as news.

This is the error of the data, given the model. What the model leaves out of the stand is not in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BLOCKS = 40  # enough of them to estimate a covariance, long enough to hold the correlation


@dataclass(frozen=True, slots=True)
class Spread:
    """Per parameter: half the width of its 95 % interval (p,), and its variance inflation (p,).

    inflation: how many times larger the parameter's variance is than if no other column looked like its own.
    """

    half_width: Array
    inflation: Array


def spread(columns: Array, torque: Array, genes: Array) -> Spread:
    """The intervals around the exact optimum `genes` (p,) for columns (n, p) and torque (n,).

    A parameter that the columns cannot tell at all has an infinite half-width and inflation.
    """
    from scipy.special import stdtrit  # Student's quantile; scipy.stats would cost half a second of start-up

    scale = np.sqrt(np.mean(columns**2, axis=0))
    told = scale > 0.0
    half, inflation = np.full(len(genes), np.inf), np.full(len(genes), np.inf)
    unit = columns[:, told] / scale[told]
    gram = unit.T @ unit / len(torque)
    if not told.any() or np.linalg.cond(gram) > 1e12:
        return Spread(half, inflation)
    residuals = torque - columns @ genes
    rounding = 1e-12 * float(np.sqrt(np.mean(torque**2))) + np.finfo(float).tiny
    bread = np.linalg.inv(_density_weighted(unit, residuals, rounding))
    blocks = min(_BLOCKS, len(torque) // 2)
    scores = np.array([part.sum(axis=0) for part in np.array_split(unit * np.sign(residuals)[:, None], blocks)])
    covariance = bread @ (scores.T @ scores) @ bread
    quantile = float(stdtrit(max(1, blocks - unit.shape[1]), 0.975))
    half[told] = quantile * np.sqrt(np.diag(covariance)) / scale[told]
    inflation[told] = np.diag(np.linalg.inv(gram))
    return Spread(half, inflation)


def _density_weighted(unit: Array, residuals: Array, rounding: float) -> Array:
    """Powell's estimate of twice the sum of f(0) x x', with the Hall-Sheather bandwidth; (p, p).

    rounding: N m, below which residuals are all the same.
    """
    count = len(residuals)
    spread_of = min(float(np.std(residuals)), float(np.subtract(*np.quantile(residuals, [0.75, 0.25]))) / 1.349)
    # Hall and Sheather (1988) for the median: h = n^(-1/3) z^(2/3) (1.5 phi(0)^2)^(1/3), here in the scale of quantiles
    quantile_width = count ** (-1 / 3) * 1.959964 ** (2 / 3) * (1.5 / (2.0 * np.pi)) ** (1 / 3)
    width = max(spread_of * _normal_quantile(0.5 + min(quantile_width, 0.45)), rounding)
    inside = unit[np.abs(residuals) <= width]
    if len(inside) < 4 * unit.shape[1]:  # residuals that are nearly all zero: the nearest quarter stands for them
        nearest = np.argsort(np.abs(residuals))[: max(count // 4, 4 * unit.shape[1])]
        width = max(float(np.abs(residuals[nearest]).max()), rounding)
        inside = unit[nearest]
    return np.asarray(inside.T @ inside) / width


def _normal_quantile(probability: float) -> float:
    from statistics import NormalDist

    return NormalDist().inv_cdf(probability)
