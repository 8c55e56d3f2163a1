"""Compute scores of features that a model lacks: their probability by chance, from random signs of blocks, and their
prediction.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np

from ga.arrays import Array, Index, Mask
from hil.signals import constants as c


class Scores:
    """The residuals of a fit, with which features are compared.

    clipped (n,): the residuals with outliers clipped, N m. residuals (n,): the residuals with only gross outliers
    clipped, N m, for the sizes of effects. Both are orthogonal to the model's columns, and zero at samples that the
    model does not describe.
    """

    def __init__(self, residuals: Array, columns: Array, kept: Mask) -> None:
        self._basis, self._kept = _basis(columns), kept[:, None]
        self.clipped = _clipped(residuals, self._basis, kept, c.CLIPPED)
        self._left = residuals

    @cached_property
    def residuals(self) -> Array:
        """Return the residuals (n,), N m, with only gross outliers clipped. They are computed at the first use, because
        a prediction does not need them.
        """
        return _clipped(self._left, self._basis, self._kept[:, 0], c.GROSS_OUTLIER)

    @cached_property
    def _firsts(self) -> Index:
        """The first rows of the blocks."""
        return _blocks(self.clipped)

    def new(self, features: Array) -> Array:
        """Return the part of features (n, k) that is orthogonal to the model's columns, scaled to mean square one.

        Features without such a part are left out.
        """
        power = np.einsum("nk,nk->k", features, features)
        left = self.without_model(features)
        kept = np.einsum("nk,nk->k", left, left)
        there = kept > c.NEW_COLUMN * np.maximum(power, np.finfo(float).tiny)
        return np.asarray(left[:, there] / np.sqrt(kept[there] / len(features)))

    def without_model(self, features: Array) -> Array:
        """Return features (n, k) without the part that the model's columns explain."""
        kept = features * self._kept
        return np.asarray(kept - self._basis @ (self._basis.T @ kept))

    def chance(self, features: Array) -> float:
        """Return the probability that features (n, k) have scores this large by chance."""
        if not features.shape[1]:
            return 1.0
        sums = np.add.reduceat(features * self.clipped[:, None], self._firsts, axis=0)
        values, vectors = np.linalg.eigh(features.T @ features)
        whitened = sums @ (vectors / np.sqrt(values.clip(0.0) + c.RIDGES[1] * values.mean()))
        total = float(np.sum(whitened.sum(axis=0) ** 2))
        by_chance = np.sum(
            (whitened.T @ _signs(len(self._firsts))) ** 2, axis=0
        )  # long rows: a sum over short ones takes as long
        return float((1 + np.count_nonzero(by_chance >= total * (1.0 - 1e-9))) / (1 + c.FLIPS))

    def predicted(self, features: Array) -> tuple[float, float]:
        """Return the fraction, 0 to 1, of the residuals' power that features (n, k) predict in unseen blocks, and the
        size of that part, N m r.m.s.
        """
        fold = np.arange(len(features)) * c.FOLDS // len(features)
        parts = [(features[fold == k], self.clipped[fold == k]) for k in range(c.FOLDS)]
        grams = np.array([part.T @ part for part, _ in parts])
        sums = np.array([part.T @ left for part, left in parts])
        power, best = float(self.clipped @ self.clipped), 0.0
        for ridge in c.RIDGES:
            penalty = ridge * len(features) * np.eye(features.shape[1])
            weights = np.linalg.solve(grams.sum(axis=0) - grams + penalty, (sums.sum(axis=0) - sums)[:, :, None])
            gained = sum(
                2.0 * float(own @ weight) - float(weight @ gram @ weight)
                for own, weight, gram in zip(sums, weights[:, :, 0], grams, strict=True)
            )
            best = max(best, gained / power if power > 0.0 else 0.0)
        return best, float(np.sqrt(best * power / len(features)))


@lru_cache(maxsize=2)
def _signs(blocks: int) -> Array:
    """Random signs (blocks, FLIPS) of the blocks."""
    return np.asarray(np.random.default_rng(0).integers(0, 2, (c.FLIPS, blocks)) * 2.0 - 1.0).T.copy()


def _basis(columns: Array) -> Array:
    """An orthonormal basis (n, r) of the columns (n, p)."""
    sizes = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    return np.asarray(left[:, values > 1e-9 * values.max(initial=0.0)])


def _clipped(residuals: Array, basis: Array, kept: Mask, clipped_at: float) -> Array:
    """Return the residuals (n,), N m, of Huber's (1964) estimate, which outliers hardly affect: clipped, and orthogonal
    to the basis.

    kept (n, 1): the samples that the model describes. clipped_at: the limit in standard deviations.
    """
    left = residuals
    for _ in range(4):
        limit = clipped_at * _spread(left[kept])
        clipped = np.clip(left, -limit, limit)
        inside = max(0.5, float(np.mean(np.abs(left[kept]) < limit)))
        left = left - basis @ (basis.T @ clipped) / inside
    clipped = np.clip(left, -limit, limit)
    return np.asarray(clipped - basis @ (basis.T @ clipped))


def _spread(residuals: Array) -> float:
    """Return the standard deviation of residuals, N m, robust to outliers unless more than half of the residuals are
    zero.
    """
    return c.SPREAD * float(np.median(np.abs(residuals))) or float(np.std(residuals))


def _blocks(scores: Array) -> Index:
    """Return the first rows of blocks much longer than the autocorrelation of the residuals."""
    count = len(scores)
    spectrum = np.abs(np.fft.rfft(scores, 2 * count)) ** 2
    alike = np.fft.irfft(spectrum)[:count]
    alike /= alike[0] if alike[0] > 0.0 else 1.0
    until = int(np.argmax(alike < c.UNCORRELATED)) or 1
    together = 1.0 + 2.0 * float(alike[1:until].sum())
    length = int(max(c.BLOCK_LENGTHS * together, c.SHORTEST_BLOCK, count / c.MOST_BLOCKS))
    number = max(c.FEWEST, min(c.MOST_BLOCKS, count // length))
    return (np.arange(number) * count) // number
