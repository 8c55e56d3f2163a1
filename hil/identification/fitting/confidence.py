"""Compute confidence intervals of the parameters: the sampling error of a least-absolute-deviations fit.

For residuals e and columns X the estimate is asymptotically normal with covariance A^-1 B A^-1 (Koenker, Quantile
Regression, 2005, section 4.3). A is twice the sum of x x' weighted by the residuals' density at zero (Powell's kernel
estimate). B is the covariance of the sum of x sign(e), from the spectrum of the signs: correlated residuals, which
every real stand has, widen the interval.

This is the error due to the data for a given model. It does not include effects that the model lacks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ga.arrays import Array, Mask
from hil.identification.candidates.residual_spectrum import ResidualSpectrum, measure
from hil.identification.fitting.blocks import Blocks
from hil.signals.constants import DEPENDENT, ENOUGH, LEAST_ROUNDING, MOST, SPREAD, TAKES_PART, UPPER


@dataclass(frozen=True, slots=True)
class ConfidenceIntervals:
    """The confidence intervals of all parameters.

    half_width (p,): half of each parameter's 95 % interval, SI. inflation (p,): the variance inflation: how many times
    larger the parameter's variance is than if its column were orthogonal to all others. correlation (p, p): of the
    sampling errors, NaN for a parameter that cannot be distinguished from others.
    """

    half_width: Array
    inflation: Array
    correlation: Array


@dataclass(frozen=True, slots=True)
class Covariance:
    """The sampling covariance of the parameters.

    matrix (p, p): the covariance, SI; zero for parameters that cannot be distinguished from others. quantile (p,): half
    a 95 % interval in standard errors. distinct (p,): which parameters can be distinguished from others. inflation
    (p,): the variance inflation of each parameter.
    """

    matrix: Array
    quantile: Array
    distinct: Mask
    inflation: Array


def confidence_intervals(blocks: Blocks, genes: Array) -> ConfidenceIntervals:
    """Return the intervals around the exact optimum `genes` (p,) of the data in `blocks`, which are read twice.

    A parameter that the columns, or their rows with small residuals, cannot distinguish from others has infinite half
    width and inflation; the other parameters are unaffected.
    """
    found = covariance(blocks, genes)
    variance = np.diag(found.matrix)  # negative by rounding: nearly dependent columns
    error = np.sqrt(np.where(found.distinct & (variance >= 0.0), variance, np.inf))
    known = np.where((error > 0.0) & (error < np.inf), error, np.nan)
    return ConfidenceIntervals(found.quantile * error, found.inflation, found.matrix / np.outer(known, known))


def covariance(blocks: Blocks, genes: Array) -> Covariance:
    """Return the sampling covariance of the exact optimum `genes` (p,) of the data in `blocks`."""
    from scipy.special import stdtrit  # Student's quantile; scipy.stats would cost half a second of start-up

    sums = _first_pass(blocks, genes)
    gram, distinct = inverse(sums.gram / sums.count)
    quantile, inflation = np.full(len(genes), np.inf), np.full(len(genes), np.inf)
    if not distinct.any():
        return Covariance(np.zeros_like(gram), quantile, distinct, inflation)
    kernel, spectrum = _second_pass(blocks, genes, sums)
    bread, near = inverse(kernel)
    distinct &= near
    quantile[distinct] = stdtrit(np.maximum(1.0, spectrum.freedom(bread)[distinct]), UPPER)
    inflation[distinct] = (np.diag(gram) * np.diag(sums.gram) / sums.count)[distinct]
    matrix = np.where(np.outer(distinct, distinct), bread @ spectrum.covariance @ bread, 0.0)
    return Covariance(matrix, quantile, distinct, inflation)


def distinct(blocks: Blocks) -> Mask:
    """Return which parameters (p,) the columns of the data in `blocks` can distinguish from the others."""
    gram: Array | float = 0.0
    for columns, _ in blocks():
        gram = gram + columns.T @ columns
    return inverse(np.asarray(gram))[1]


def inverse(gram: Array) -> tuple[Array, Mask]:
    """Return the inverse (p, p) of a Gram matrix, and which parameters (p,) can be distinguished from others.

    For dependent columns the pseudo-inverse is returned, which is correct for the other parameters.
    """
    size = np.sqrt(np.diag(gram))
    excited = size > 0.0
    units = np.outer(*[np.where(excited, size, 1.0)] * 2)
    strengths, directions = np.linalg.eigh(gram / units)
    dependent = strengths <= DEPENDENT * max(float(strengths[-1]), 0.0)
    distinct = excited & (np.linalg.norm(directions[:, dependent], axis=1) < TAKES_PART)
    inverse = (directions / np.where(dependent, np.inf, strengths)) @ directions.T
    return np.asarray(inverse / units), distinct


@dataclass(frozen=True, slots=True)
class _Sums:
    """The sums of the first pass through the rows.

    count: the number of rows. gram (p, p): the sum of x x'. residuals: the residuals of every n-th row, N m. rounding:
    the residual, N m, below which a residual is treated as zero.
    """

    count: int
    gram: Array
    residuals: Array
    rounding: float


def _first_pass(blocks: Blocks, genes: Array) -> _Sums:
    count, power, every = 0, 0.0, max(1, blocks.rows // ENOUGH)
    gram, kept = np.zeros((len(genes), len(genes))), []
    for columns, torque in blocks():
        first = -count % every
        kept.append(torque[first::every] - columns[first::every] @ genes)
        count += len(torque)
        power += float(torque @ torque)
        gram += columns.T @ columns
    rounding = 1e-12 * float(np.sqrt(power / count)) + LEAST_ROUNDING
    return _Sums(count, gram, np.concatenate(kept), rounding)


def _second_pass(blocks: Blocks, genes: Array, sums: _Sums) -> tuple[Array, ResidualSpectrum]:
    """Return Powell's estimate of twice the sum of f(0) x x' (p, p), and the spectrum of the residuals' signs."""
    width, kernel = _kernel_width(sums), np.zeros_like(sums.gram)

    def signed() -> Iterator[tuple[Array, Array]]:
        for columns, torque in blocks():
            residuals = torque - columns @ genes
            inside = columns[np.abs(residuals) <= width]
            kernel[:] += inside.T @ inside / width
            # the optimum passes through p rows
            yield columns, np.where(np.abs(residuals) > sums.rounding, np.sign(residuals), 0.0)

    return kernel, measure(signed())


def _kernel_width(sums: _Sums) -> float:
    """Return the residual, N m, up to which a residual is near zero: the bandwidth of Bofinger (1975) for the median.

    In quantiles the bandwidth is n^(-1/5) (9/2 phi(0)^4)^(1/5), which minimises the mean square error of the density;
    parameters that few rows determine need this bandwidth. At least a hundred rows are always near zero.
    """
    from scipy.special import ndtri

    residuals, count = sums.residuals, sums.count
    lower, upper = (float(one) for one in np.quantile(residuals, [1.0 / 4.0, 3.0 / 4.0]))
    sigma = min(float(np.std(residuals)), 0.5 * SPREAD * (upper - lower))
    share = count ** (-1 / 5) * (0.5 * (3.0 / (2.0 * np.pi)) ** 2) ** (1 / 5)
    fewest = float(np.quantile(np.abs(residuals), min(1.0, 100.0 / count)))
    return max(sigma * float(ndtri(0.5 + min(share, 0.5 * MOST))), fewest, sums.rounding)
