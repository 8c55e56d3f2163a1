"""The outcome of many independent searches of the same data (the paper's Table 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class History:
    """The best fitness at log-spaced generations (the paper's Figure 8).

    generation (m,): the generations, from 0, the initial population, on. fitness (trials, m): the best fitness until
    each, N m; a trial that its stop rule ended keeps its last value in later generations.
    """

    generation: NDArray[np.int64]
    fitness: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Populations:
    """The chromosomes of the best trial, SI: those of its first generation and those of its last, (population, p)
    each.
    """

    first: NDArray[np.float64]
    last: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trials:
    """The outcome of the trials.

    genes (trials, p): the best chromosome of each trial, SI. fitness (trials,): their fitness, N m. evaluations: the
    number of evaluations in all trials, including children whose evaluation was skipped because they could not survive.
    generations (trials,): the number of generations. finished (trials,): which trials were not interrupted. made: the
    number of evaluations in this run, without those of a resumed run before it. processor_seconds: the processor time
    of these evaluations, all cores together. populations: None if the searched chromosomes are not the genes.
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
        """Whether any trial was interrupted before its end."""
        return not self.finished.all()

    @property
    def best(self) -> NDArray[np.float64]:
        """The genes (p,) of the best trial."""
        return np.asarray(self.genes[int(np.argmin(self.fitness))])

    @property
    def mean(self) -> NDArray[np.float64]:
        """The mean (p,) of the genes over the trials."""
        return np.asarray(self.genes.mean(axis=0))

    @property
    def std(self) -> NDArray[np.float64]:
        """The standard deviation (p,) of the genes over the trials, with n - 1; NaN for a single trial."""
        if len(self.genes) < 2:
            return np.full(self.genes.shape[1], np.nan)
        return np.asarray(self.genes.std(axis=0, ddof=1))

    def scaled(self, share: float) -> Trials:
        """Return the trials with every fitness multiplied by `share`: for searches on reduced rows, of which each
        stands for 1/share rows.
        """
        history = replace(self.history, fitness=self.history.fitness * share)
        return replace(self, fitness=self.fitness * share, history=history)
