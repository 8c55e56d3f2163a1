"""What a search consists of: its population, and the rules it goes by, as the compiled loops read them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import lean, lean_apart
from ga.fitness import Samples, Tree, exact_error
from ga.generator import State, load, store, uniform
from ga.operators import Genes, Order, copy

ALWAYS, IF_BETTER, OLDEST, RANDOM = range(4)
"""What a child replaces: the worst, always or only if it is better; the oldest; any."""


class Population(NamedTuple):
    """All there is to a search under way; saved and restored, it goes on as if nothing had happened.

    genes: (population, p). fitness: (population,), N m. order: (population,), see ga.operators. generator: (4,).
    best: (p,), the best chromosome ever, and best_fitness: (1,), its fitness, N m.
    progress: (3,), generations done, evaluations made, and 1 once the stop rule has ended the search.
    """

    genes: NDArray[np.float64]
    fitness: NDArray[np.float64]
    order: Order
    generator: State
    best: Genes
    best_fitness: NDArray[np.float64]
    progress: NDArray[np.int64]

    def copied(self) -> Population:
        """The same state in arrays of its own."""
        return Population(*(part.copy() for part in self))  # type: ignore[arg-type]  # each as its field

    @property
    def generation(self) -> int:
        """Generations done."""
        return int(self.progress[0])

    @property
    def evaluations(self) -> int:
        """Chromosomes evaluated, the initial population included."""
        return int(self.progress[1])

    @property
    def stopped(self) -> bool:
        """Whether the stop rule has ended the search."""
        return bool(self.progress[2])


class Rules(NamedTuple):
    """Bounds and settings as numbers.

    rejects: whether a child that is known to be hopeless may go unevaluated. floor: N m, what relative comparisons of
    fitness divide by at least. tolerance: -1 for none.
    """

    low: Genes
    high: Genes
    tournament: int
    larger: bool
    inverse: bool
    replacement: int
    mutation: float
    reach: float
    tolerance: float
    floor: float
    rejects: bool


@lean_apart
def populate(samples: Samples | None, tree: Tree | None, rules: Rules, population: Population) -> None:
    """The paper, "Initial Population": uniform at random in the bounds, evaluated."""
    scatter(rules, population)
    for i in range(population.fitness.size):
        population.fitness[i] = exact_error(samples, tree, population.genes[i])
        remember(population, population.genes[i], population.fitness[i])
    population.progress[1] = population.fitness.size


@lean_apart
def scatter(rules: Rules, population: Population) -> None:
    """Draw every gene uniformly in its bounds."""
    words = load(population.generator)
    for i in range(population.fitness.size):
        for k in range(rules.low.size):
            part, words = uniform(words)
            population.genes[i, k] = rules.low[k] + (rules.high[k] - rules.low[k]) * part
    store(words, population.generator)


@lean
def remember(population: Population, child: Genes, error: float) -> None:
    """Keep the best chromosome ever: some readings of the paper let the population lose it."""
    if error < population.best_fitness[0]:
        population.best_fitness[0] = error
        copy(child, population.best)


@lean
def has_settled(rules: Rules, population: Population) -> bool:
    """Whether the fitness of the population spreads over no more than the tolerance."""
    if rules.tolerance < 0.0:
        return False
    lowest, highest = np.inf, 0.0
    for error in population.fitness:
        lowest, highest = min(lowest, error), max(highest, error)
    return bool(highest - lowest <= rules.tolerance * max(lowest, rules.floor))
