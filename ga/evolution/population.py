"""The population of a search, and the rules of the search in the form that the compiled loops use."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_when_worth, compiled_within
from ga.evolution.generator import State, fill, uniforms
from ga.evolution.operators import REDRAWS, Genes, Order, copy
from ga.start import Start

ALWAYS, IF_BETTER, OLDEST, RANDOM = range(4)
"""The individual that the offspring replaces: the worst one, always or only if the offspring is better; the oldest one;
a random one.
"""


class Population(NamedTuple):
    """The whole state of a search. A search whose state is saved and restored continues as if it had not stopped.

    genes: (population, p). fitness: (population,), N m. order: (population,), the rows of the population, of which the
    front is shuffled in a draw. generator: (4,), the state of the random generator. best: (p,), the best chromosome
    ever. best_fitness: (1,), its fitness, N m. progress: (3,), the number of generations, the number of evaluations,
    and 1 once the stop rule has ended the search.
    """

    genes: NDArray[np.float64]
    fitness: NDArray[np.float64]
    order: Order
    generator: State
    best: Genes
    best_fitness: NDArray[np.float64]
    progress: NDArray[np.int64]

    def copied(self) -> Population:
        """Return a copy of the population that shares no arrays with it."""
        return Population(*(part.copy() for part in self))  # type: ignore[arg-type]  # each as its field

    @property
    def generation(self) -> int:
        """The number of generations so far."""
        return int(self.progress[0])

    @property
    def evaluations(self) -> int:
        """The number of chromosomes evaluated so far, including the first population."""
        return int(self.progress[1])

    @property
    def stopped(self) -> bool:
        """Whether the stop rule has ended the search."""
        return bool(self.progress[2])


class Rules(NamedTuple):
    """Bounds and settings as numbers for the compiled loops.

    rejects: whether a child that cannot survive may stay unevaluated. floor: the smallest divisor, N m, in relative
    comparisons of fitness. tolerance: the tolerance of the stop rule, -1 for none.
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


class Record(NamedTuple):
    """The best fitness at selected generations.

    generation (m + 1,): these generations, rising; the last one is never reached. fitness (m,): the best fitness until
    each, N m, NaN for generations not reached yet.
    """

    generation: NDArray[np.int64]
    fitness: NDArray[np.float64]


def unrecorded() -> Record:
    """Return a record without entries, for a search whose best fitness is not recorded."""
    return Record(np.full(1, -1), np.empty(0))


@compiled_within
def due_after(record: Record, population: Population) -> int:
    """Return the index of the first entry of the record that is for a future generation."""
    due = 0
    while due < record.fitness.size and record.generation[due] <= population.progress[0]:
        due += 1
    return due


@compiled_within
def recorded(record: Record, due: int, population: Population) -> int:
    """Record the best fitness if entry `due` of the record is for this generation; return the index of the next entry
    to fill.
    """
    if population.progress[0] == record.generation[due]:
        record.fitness[due] = population.best_fitness[0]
        due += 1
    return due


def scatter(low: Genes, high: Genes, population: Population) -> None:
    """Draw every gene uniformly within the bounds `low` and `high` (the paper, "Initial Population")."""
    parts = uniforms(population.generator, population.genes.size).reshape(population.genes.shape)
    population.genes[:] = low + (high - low) * parts


@compiled_when_worth
def scatter_around(low: Genes, high: Genes, start: Start, genes: NDArray[np.float64], state: State) -> None:
    """Replace every chromosome of `genes` by a random one, drawn uniformly in a cube around the start and limited to
    the bounds.

    A chromosome outside the bounds is drawn again, REDRAWS times at most.
    """
    for chromosome in genes:
        for _ in range(REDRAWS):
            fill(state, chromosome)
            inside = True
            for k in range(chromosome.size):
                gene = 0.0
                for j in range(k, chromosome.size):
                    gene += start.backward[k, j] * (start.reach * (2.0 * chromosome[j] - 1.0))
                chromosome[k] = start.centre[k] + gene  # the numbers of the genes before are no longer needed
                inside = inside and low[k] <= chromosome[k] <= high[k]
            if inside:
                break
        for k in range(chromosome.size):
            chromosome[k] = min(max(chromosome[k], low[k]), high[k])


@compiled_within
def remember(population: Population, child: Genes, error: float) -> None:
    """Store the child if it is the best chromosome of the whole search: in some readings of the paper the population
    can lose it.
    """
    if error < population.best_fitness[0]:
        population.best_fitness[0] = error
        copy(child, population.best)


@compiled_within
def has_settled(rules: Rules, population: Population) -> bool:
    """Return whether the stop rule ends the search: the population's fitness spreads over no more than the
    tolerance.
    """
    if rules.tolerance < 0.0:
        return False
    lowest, highest = np.inf, 0.0
    for error in population.fitness:
        lowest, highest = min(lowest, error), max(highest, error)
    return bool(highest - lowest <= rules.tolerance * max(lowest, rules.floor))
