"""Measure how residuals are correlated in time: the power of their signs in bands, and the resulting covariance of
estimates.

The sum of x sign(e) of a median regression has the covariance sum over s, t of x_s x_t' E[sign(e_s) sign(e_t)]. By
Parseval's theorem that is the cross-spectrum of the columns weighted with the power spectrum of the signs (Hannan 1963
for least squares). The power is estimated from all residuals, wherever a column is large. Blocks in time, the usual
way, are too few if a column is large in only a few of them, as the column of a skew is at the fast end of a chirp.

A fit removes the part of the noise that its own columns can explain, mostly in the bands in which the columns have
their power: an offset and a drift remove it from the lowest band. The remaining power there comes from fewer lines than
the band has.

If the zero of the torque drifts randomly, the power rises towards low frequencies, also within the lowest band. The
slope within that band is estimated from the power of the next band.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ga.arrays import Array
from hil.signals.constants import BAND_WIDTH, DEPENDENT, EXPONENTS, FEWEST_LINES, ROWS_AT_ONCE

_SLOW, _NEXT = (
    np.maximum(np.arange(FEWEST_LINES), 1),
    np.arange(FEWEST_LINES, 2 * FEWEST_LINES),
)  # lines of the two lowest bands
_SHAPES = _SLOW ** -EXPONENTS[:, None]
_STEPS = np.log(
    _SHAPES.mean(axis=1) / np.mean(_NEXT ** -EXPONENTS[:, None], axis=1)
)  # between the two bands, by exponent


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """The spectrum of the residuals' signs in b bands of rising frequency.

    lines (b,): the number of spectral lines in each band. power (b,): mean square of the signs in each band, 1 if they
    are uncorrelated. crossed (b, p, p): the columns' products in each band, whose sum is columns^T columns. fitted
    (b,): the number of lines that a fit of these signs has removed from each band. slowest (k, p, p): the products of
    the k lines of the lowest band. A power below one is replaced by one, because it is chance, or the result of a fit
    with other columns.
    """

    lines: Array
    power: Array
    crossed: Array
    fitted: Array
    slowest: Array

    @property
    def _left(self) -> Array:
        """Return the lines that remain in each band after the fit, at least half of all: the band's power is known no
        better than that.
        """
        return np.asarray(np.maximum(self.lines - self.fitted, 0.5 * self.lines))

    @property
    def covariance(self) -> Array:
        """Return the covariance (p, p) of the sum of x sign(e)."""
        return np.asarray(np.einsum("b,bpq->pq", self._counted, self._weighted))

    @property
    def by_bands(self) -> Array:
        """Return the covariance (p, p) of the sum of x sign(e), with equal weights for all lines of the lowest band."""
        return np.asarray(np.einsum("b,bpq->pq", self._counted, self.crossed))

    @property
    def _counted(self) -> Array:
        return np.maximum(self.power * self.lines / self._left, 1.0)

    @property
    def _weighted(self) -> Array:
        """Return the columns' products (b, p, p); those of the lowest band are weighted by each line's power divided by
        the band's.

        No weight is below one: motion that is slow only in a part of the recording meets other noise. The slope of the
        power has a chance error, so one standard error of its logarithm is added.
        """
        if len(self.slowest) < FEWEST_LINES:
            return self.crossed
        rise = float(np.log(self._counted[0] / self._counted[1])) - float(np.sqrt(np.sum(1.0 / self._left[:2])))
        shape = _SLOW ** -float(np.interp(rise, _STEPS, EXPONENTS))
        weights = np.maximum(shape / shape.mean(), 1.0)
        return np.concatenate([np.einsum("k,kpq->pq", weights, self.slowest)[None], self.crossed[1:]])

    def freedom(self, bread: Array) -> Array:
        """Return the degrees of freedom (p,) of the variances on the diagonal of bread . covariance . bread
        (Satterthwaite 1946).
        """
        parts = np.einsum("b,kp,bpq,qk->kb", self._counted, bread, self._weighted, bread)
        # in parts of the largest: of a parameter that nothing shows, the square would overflow
        parts /= np.maximum(np.abs(parts).max(axis=1, keepdims=True), np.finfo(float).tiny)
        squares = (parts**2 / self._left).sum(axis=1)
        return np.asarray(2.0 * parts.sum(axis=1) ** 2 / np.where(squares > 0.0, squares, np.inf))


def measure(blocks: Iterable[tuple[Array, Array]]) -> ResidualSpectrum:
    """Return the spectrum of signs (m,) with columns (m, p), read in blocks of any length, in the order of time.

    The signs must be those of a fit with these columns.
    """
    edges, lines, power, crossed, slow = np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0), 1
    for columns, signs in _segments(blocks):
        count, p = columns.shape
        if not edges.size:
            edges, slow = _edges(count)
            lines, power, crossed = np.zeros(len(edges)), np.zeros(len(edges)), np.zeros((len(edges), p, p))
        spectrum, waves = np.fft.rfft(signs), np.fft.rfft(columns, axis=0)
        twice = np.full(len(spectrum), 2.0)  # a line counts for its negative frequency too
        twice[[0, -1] if count % 2 == 0 else [0]] = 1.0
        firsts = np.searchsorted(np.arange(len(spectrum)) / count, edges)
        kept = np.flatnonzero(np.diff(firsts, append=len(spectrum)) > 0)  # a short last segment has empty bands
        lines[kept] += np.add.reduceat(twice, firsts[kept]) / 2.0
        power[kept] += np.add.reduceat(twice * np.abs(spectrum) ** 2, firsts[kept]) / (2.0 * count)
        for j in range(p):
            products = (waves[:, j, None].conj() * waves).real * (twice / count)[:, None]
            crossed[kept, j] += np.add.reduceat(products, firsts[kept], axis=0)
    bands = np.r_[0, slow : len(lines)]
    together, slowest = np.add.reduceat(crossed, bands, axis=0), crossed[:slow]
    lines, power = np.add.reduceat(lines, bands), np.add.reduceat(power, bands)
    return ResidualSpectrum(lines, power / lines, together, _fitted(together), slowest)


def _fitted(crossed: Array) -> Array:
    """Return the number of lines (b,) that a fit removes from each band.

    It is half the trace of the fit's projection in the band, because a line has two numbers.
    """
    gram = crossed.sum(axis=0)
    sizes = np.sqrt(np.diag(gram))
    units = np.outer(*[np.where(sizes > 0.0, sizes, 1.0)] * 2)
    inverse = np.linalg.pinv(gram / units, rcond=DEPENDENT, hermitian=True) / units
    return np.asarray(0.5 * np.einsum("pq,bqp->b", inverse, crossed))


def _edges(count: int) -> tuple[Array, int]:
    """Return the lower ends, cycles per sample, of the lines of the lowest band and of the other bands, and the number
    of those lines.

    count: samples of a segment. If there is only one band, its lower end is returned in place of those of its lines.
    """
    starts, last = [0], count // 2 + 1
    while (following := starts[-1] + max(FEWEST_LINES, int(BAND_WIDTH * starts[-1]))) <= last - FEWEST_LINES:
        starts.append(following)
    slow = FEWEST_LINES if len(starts) > 1 else 1
    return np.r_[0:slow, starts[1:]] / count - 0.5 / count, slow


def _segments(blocks: Iterable[tuple[Array, Array]]) -> Iterator[tuple[Array, Array]]:
    """Yield the rows in segments of `ROWS_AT_ONCE` rows; the last segment may be shorter."""
    waiting: list[tuple[Array, Array]] = []
    for block in blocks:
        waiting.append(block)
        while sum(len(signs) for _, signs in waiting) >= ROWS_AT_ONCE:
            columns, signs = (np.concatenate(parts) for parts in zip(*waiting, strict=True))
            yield columns[:ROWS_AT_ONCE], signs[:ROWS_AT_ONCE]
            waiting = [(columns[ROWS_AT_ONCE:], signs[ROWS_AT_ONCE:])]
    columns, signs = (np.concatenate(parts) for parts in zip(*waiting, strict=True))
    if len(signs):
        yield columns, signs
