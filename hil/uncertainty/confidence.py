"""How far the parameters can be told from one recording: the sampling error of a least-absolute-deviations fit.

For residuals e and columns X the estimate is asymptotically normal with covariance A^-1 B A^-1 (Koenker, Quantile
Regression, 2005, section 4.3), where A is twice the sum of x x' weighted with the residuals' density at zero (Powell's
kernel estimate) and B the covariance of the sum of x sign(e), from the spectrum of the signs: residuals that follow
each other, as they do on any real stand, widen the interval instead of being counted as news.

This is the error of the data, given the model. What the model leaves out of the stand is not in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.uncertainty.residual_spectrum import ResidualSpectrum, measure

Array = NDArray[np.float64]
Blocks = Callable[[], Iterable[tuple[Array, Array]]]
"""The data as often as it is asked for, in order: columns (m, p) and torque (m,) N m of any number of rows."""

_QUANTILES = 1 << 16  # residuals from which the spread of all is read


@dataclass(frozen=True, slots=True)
class Spread:
    """Per parameter: half the width of its 95 % interval (p,), and its variance inflation (p,).

    inflation: how many times larger the parameter's variance is than if no other column looked like its own.
    """

    half_width: Array
    inflation: Array

    def carrying(self, uncertainty: float, values: Array, scales: NDArray[np.bool_]) -> Spread:
        """The same with the uncertainty of the torque's scale, relative, one standard deviation, carried in.

        An error of the scale goes one to one into every parameter (p,) that `scales` with the torque.
        """
        carried = np.where(scales, 1.96 * uncertainty * np.abs(values), 0.0)
        return Spread(np.hypot(self.half_width, carried), self.inflation)


def spread(blocks: Blocks, genes: Array) -> Spread:
    """The intervals around the exact optimum `genes` (p,) of the data in `blocks`, which is gone through three times.

    A parameter that the columns cannot tell at all has an infinite half-width and inflation.
    """
    from scipy.special import stdtrit  # Student's quantile; scipy.stats would cost half a second of start-up

    sums = _first_pass(blocks, genes)
    scale = np.sqrt(np.diag(sums.gram) / sums.count)
    told = scale > 0.0
    half, inflation = np.full(len(genes), np.inf), np.full(len(genes), np.inf)
    gram = sums.gram[np.ix_(told, told)] / np.outer(scale[told], scale[told]) / sums.count
    if not told.any() or np.linalg.cond(gram) > 1e12:
        return Spread(half, inflation)
    kernel, spectrum = _second_pass(blocks, genes, sums)
    units = np.outer(scale[told], scale[told])
    bread = np.zeros_like(kernel)
    bread[np.ix_(told, told)] = np.linalg.inv(kernel[np.ix_(told, told)] / units) / units
    variance = np.diag(bread @ spectrum.covariance @ bread)[told]  # negative by rounding: the columns tell nothing
    quantile = stdtrit(np.maximum(1.0, spectrum.freedom(bread)[told]), 0.975)
    half[told] = quantile * np.sqrt(np.where(variance >= 0.0, variance, np.inf))
    inflation[told] = np.diag(np.linalg.inv(gram))
    return Spread(half, inflation)


@dataclass(frozen=True, slots=True)
class _Sums:
    """gram: sum of x x' (p, p). residuals: every so many-th, N m. rounding: N m, below which residuals are the same."""

    count: int
    gram: Array
    residuals: Array
    rounding: float


def _first_pass(blocks: Blocks, genes: Array) -> _Sums:
    count, power = 0, 0.0
    gram = np.zeros((len(genes), len(genes)))
    for columns, torque in blocks():
        count += len(torque)
        power += float(torque @ torque)
        gram += columns.T @ columns
    every, seen, kept = max(1, count // _QUANTILES), 0, []
    for columns, torque in blocks():
        first = -seen % every
        kept.append(torque[first::every] - columns[first::every] @ genes)
        seen += len(torque)
    rounding = 1e-12 * float(np.sqrt(power / count)) + float(np.finfo(float).tiny)
    return _Sums(count, gram, np.concatenate(kept), rounding)


def _second_pass(blocks: Blocks, genes: Array, sums: _Sums) -> tuple[Array, ResidualSpectrum]:
    """Powell's estimate of twice the sum of f(0) x x' (p, p), and how the signs of the residuals follow each other."""
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
    """The residuals that count as near zero, N m: the bandwidth of Bofinger (1975) for the median.

    In quantiles it is n^(-1/5) (4.5 phi(0)^4)^(1/5), the least mean square error of the density, which parameters that
    few rows tell need; never so narrow that fewer than a hundred rows remain.
    """
    from scipy.special import ndtri

    residuals, count = sums.residuals, sums.count
    sigma = min(float(np.std(residuals)), float(np.subtract(*np.quantile(residuals, [0.75, 0.25]))) / 1.349)
    share = count ** (-1 / 5) * (4.5 / (2.0 * np.pi) ** 2) ** (1 / 5)
    fewest = float(np.quantile(np.abs(residuals), min(1.0, 100.0 / count)))
    return max(sigma * float(ndtri(0.5 + min(share, 0.45))), fewest, sums.rounding)
