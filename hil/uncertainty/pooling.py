"""Several recordings pooled: what lies within each of them told apart from what lies between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ga.lad.out_of_core import reduce
from hil.identification.dataset import Table
from hil.uncertainty.confidence import Spread, spread
from hil.uncertainty.random_effects import Pooled, between

Array = NDArray[np.float64]

_NORMAL = 1.96


@dataclass(frozen=True, slots=True)
class Scatter:
    """Of one parameter, as standard deviations in its unit: within a recording (its own error), and between them."""

    within: float
    between: float


def scatter(blocks: Table, edges: tuple[int, ...], errors: Spread) -> tuple[Spread, tuple[Scatter | None, ...]]:
    """The intervals with what lies between recordings in them, and the scatter of each parameter.

    blocks: the pooled linear problem; edges: where each recording ends, in samples. A parameter that fewer than two
    recordings tell on their own keeps its interval, and has no scatter.
    """
    if len(edges) < 2:
        return errors, (None,) * len(errors.half_width)
    fitted = [_of(blocks, start, stop) for start, stop in zip((0, *edges), edges, strict=False)]
    widened, found = errors.half_width.copy(), list[Scatter | None]()
    for at in range(len(widened)):
        told = [
            (values[at], half[at] / _NORMAL) for values, half in fitted if at < len(half) and 0.0 < half[at] < np.inf
        ]
        pooled = _pooled(told)
        found.append(None if pooled is None else Scatter(pooled.within, pooled.between))
        if pooled is not None:
            widened[at] = max(widened[at], 0.5 * (pooled.ci95[1] - pooled.ci95[0]))
    return Spread(widened, errors.inflation), tuple(found)


def _of(blocks: Table, start: int, stop: int) -> tuple[Array, Array]:
    """What one recording alone says: the exact optimum (p,), and half the width of its intervals (p,)."""

    def keep(number: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray((number >= start) & (number < stop))

    try:
        values = reduce(lambda: blocks(keep), stop - start).optimum.genes
    except RuntimeError:  # its columns are too much alike to be told apart
        return np.zeros(0), np.zeros(0)
    return values, spread(lambda: blocks(keep), values).half_width


def _pooled(told: list[tuple[float, float]]) -> Pooled | None:
    if len(told) < 2:
        return None
    values, errors = np.array(told).T
    return between(values, errors)
