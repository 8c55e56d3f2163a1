"""The bounds of a search: the range of each parameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.samples import check

if TYPE_CHECKING:
    from numpy.typing import NDArray

AT_BOUND = 1e-4
"""The distance from a bound, as a fraction of the range, below which a gene is at the bound: random redraws never hit a
bound exactly.
"""


@dataclass(frozen=True, eq=False)
class Bounds:
    """The lowest and the highest value of each gene, SI: low (p,) and high (p,).

    names: the parameters' names for messages; optional. Raises ValueError, naming the parameter, if a bound is not
    finite or low is not below high.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        low, high = np.array(self.low, dtype=np.float64), np.array(self.high, dtype=np.float64)
        if low.ndim != 1 or low.shape != high.shape or not low.size:
            raise ValueError(f"bounds of shapes {low.shape} and {high.shape}: give one low and one high a parameter")
        if self.names and len(self.names) != low.size:
            raise ValueError(f"bounds of {low.size} parameters, but {len(self.names)} names")
        for k in range(low.size):
            # the width must be finite too: -1e308 to 1e308 has none that a float can hold
            if not np.isfinite([low[k], high[k], high[k] / 2 - low[k] / 2]).all():
                raise ValueError(f"bounds of {self._name(k)}: {low[k]:g} to {high[k]:g} is not finite")
            if not low[k] < high[k]:
                raise ValueError(f"bounds of {self._name(k)}: {low[k]:g} is not below {high[k]:g}")
        low.setflags(write=False)
        high.setflags(write=False)
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)

    def _name(self, k: int) -> str:
        return self.names[k] if self.names else f"parameter {k}"

    def at_bound(self, genes: NDArray[np.float64]) -> tuple[str | None, ...]:
        """Return for each gene (p,) "low" or "high" if the gene lies on that bound or beyond it, else None."""
        margin = AT_BOUND * (self.high - self.low)
        return tuple(
            "low" if gene <= low + m else "high" if gene >= high - m else None
            for gene, low, high, m in zip(genes, self.low, self.high, margin, strict=True)
        )


PAPER_BOUNDS: Final = Bounds(np.array([0.5e-3, 1e-5]), np.array([0.2, 1e-2]), ("Kc", "Bc"))
"""The bounds in the paper's section "Problem Encoding": Kc 0.5 to 200 mN m/rad, Bc 0.01 to 10 mN m s/rad."""


def bounds_from_data(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    names: tuple[str, ...] = (),
    positive: tuple[int, ...] = (),
) -> Bounds:
    """Return bounds that contain a chromosome of least mean absolute error, for columns (n, p) and torque (n,), N m.

    positive: indices of genes that must not be negative. The centre of the bounds is g0, the least-squares solution,
    with zero in place of a negative value of such a gene. For the optimum g, with v = columns (g - g0), the triangle
    inequality gives |v|_1 <= 2 n fitness(g0), and the largest leverage h (the largest diagonal element of the hat
    matrix) gives |v|_2 <= sqrt(h) |v|_1; hence |g - g0|_k <= 2 n fitness(g0) sqrt(h C_kk), C = (columns^T columns)^-1.
    The bounds are never narrower than g0 +- mean|torque|/mean|column|, the value of a parameter that alone would make
    the torque; otherwise good data would make the search trivial. The bounds scale with the units of columns and
    torque. If columns are collinear or zero, the bounds contain one of the many optima.

    Raises ValueError if the data are not finite, not of equal length or empty.
    """
    check(columns, torque)
    scale = np.abs(columns).max(axis=0)
    scale[scale == 0.0] = 1.0
    left, singular, right = np.linalg.svd(columns / scale, full_matrices=False)
    known = singular > singular[0] * 1e-10
    left, singular, right = left[:, known], singular[known], right[known]
    centre = right.T @ (left.T @ torque / singular)
    centre[list(positive)] = np.maximum(centre[list(positive)], 0.0)
    misfit = float(np.sum(np.abs(torque - columns @ (centre / scale))))
    leverage = float(np.max(np.sum(left**2, axis=1), initial=0.0))
    proven = 2.0 * misfit * np.sqrt(leverage) * np.sqrt(np.sum((right.T / singular) ** 2, axis=1))
    size = np.mean(np.abs(columns), axis=0) / scale
    alone = float(np.mean(np.abs(torque))) / np.where(size > 0.0, size, 1.0)
    reach = np.maximum(proven, alone)
    reach[reach == 0.0] = 1.0  # no torque and no misfit: any box will do
    low, high = (centre - reach) / scale, (centre + reach) / scale
    low[list(positive)] = np.maximum(low[list(positive)], 0.0)
    return Bounds(low, high, names)
