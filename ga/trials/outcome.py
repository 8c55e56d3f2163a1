"""The outcome of many independent searches of the same data (the paper's Table 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class History:
    """The best fitness so far against the generation, at log-spaced generations (the paper's Figure 8).

    generation: (m,), from 0, the initial population, on. fitness: (trials, m), N m; a trial that its stop rule ended
    keeps its last value from there on.
    """

    generation: NDArray[np.int64]
    fitness: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Populations:
    """The chromosomes of the best trial, SI: of its first generation and of its last, (population, p) each."""

    first: NDArray[np.float64]
    last: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trials:
    """The outcome of the trials.

    genes: (trials, p), the best chromosome of each, SI. fitness: (trials,), N m. evaluations: of all trials together,
    those known to be hopeless included. generations: (trials,). finished: (trials,), which were not cut short.
    made: how many of the evaluations were made by this run, not by the one it went on from. processor_seconds: what
    they took, on all cores together. populations: None where the genes are not what was searched.
    """

    genes: NDArray[np.float64]
    fitness: NDArray[np.float64]
    evaluations: int
    generations: NDArray[np.int64]
    history: History
    finished: NDArray[np.bool_]
    made: int
    processor_seconds: float
    populations: Populations | None = None

    @property
    def interrupted(self) -> bool:
        """Whether any trial was stopped before its end."""
        return not self.finished.all()

    @property
    def best(self) -> NDArray[np.float64]:
        """The genes (p,) of the best trial."""
        return np.asarray(self.genes[int(np.argmin(self.fitness))])

    @property
    def mean(self) -> NDArray[np.float64]:
        """The mean (p,) over the trials."""
        return np.asarray(self.genes.mean(axis=0))

    @property
    def std(self) -> NDArray[np.float64]:
        """The standard deviation (p,) over the trials, with n - 1; NaN for a single trial."""
        if len(self.genes) < 2:
            return np.full(self.genes.shape[1], np.nan)
        return np.asarray(self.genes.std(axis=0, ddof=1))

    def scaled(self, share: float) -> Trials:
        """Return the trials with every fitness times `share`, for rows that stand for 1/share times as many."""
        history = replace(self.history, fitness=self.history.fitness * share)
        return replace(self, fitness=self.fitness * share, history=history)
