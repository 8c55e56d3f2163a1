"""A search whose fitness is computed by the caller, for models that are not linear in their parameters.

The operators are those of the `default` preset. The method `ask` returns chromosomes to evaluate, and `tell` takes
their fitness:

    search = Search(bounds, seed=0)
    while not search.done:
        genes = search.ask()
        search.tell(genes, [error(chromosome) for chromosome in genes])
    search.best
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from ga.evolution.evolution import PRESETS, Settings, rules_of, unborn
from ga.evolution.generational import breed, draw_parents, family_of, survive
from ga.evolution.population import has_settled, remember, scatter

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ga.bounds import Bounds

_HOPELESS: Final = 1e300
"""The fitness that replaces an infinite one or a NaN: larger (worse) than any other, but finite."""


class Search:
    """A search for the chromosome with the smallest fitness within bounds (p,).

    settings: the settings of the generational scheme. floor: the smallest divisor of the stop rule's relative
    tolerance. If the best fitness is zero, set `floor` to the fitness that is as good as zero; otherwise the search
    runs through all its generations. Raises ValueError for another scheme, a population that is too small, or a
    negative seed.
    """

    def __init__(
        self, bounds: Bounds, settings: Settings = PRESETS["default"], *, seed: int = 0, floor: float = 1e-300
    ) -> None:
        if settings.scheme != "generational":
            raise ValueError(f'scheme "{settings.scheme}": only the scheme "generational" is possible here')
        p = bounds.low.size
        self._settings = settings
        self._rules = rules_of(bounds, settings, floor, reject=False)
        self._population = unborn(p, settings, seed, trial=0)
        self._family = family_of(p)
        self._asked: NDArray[np.float64] | None = None

    def ask(self) -> NDArray[np.float64]:
        """Return the chromosomes (k, p) to evaluate next: at first the first population, later 5 p children.

        Until `tell` is called, further calls return the same chromosomes.
        """
        if self._asked is None:
            population, p = self._population, self._rules.low.size
            if not population.evaluations:
                scatter(self._rules.low, self._rules.high, population)
                self._asked = population.genes.copy()
            else:
                draw_parents(population)
                children = self._family.genes[: 5 * p]
                breed(self._rules, population, population.order[: p + 2], self._family.centre, children)
                self._asked = children.copy()
        return self._asked.copy()

    def tell(self, genes: NDArray[np.float64], fitness: ArrayLike) -> None:
        """Take the fitness (k,) of the chromosomes (k, p) that `ask` returned, in their order.

        A fitness that is infinite or not a number is treated as the worst. Raises ValueError for other chromosomes, or
        if the number of fitness values differs from the number of chromosomes.
        """
        if self._asked is None or not np.array_equal(genes, self._asked):
            raise ValueError("these are not the chromosomes that were asked for: give those of the last ask()")
        errors = np.array(fitness, dtype=np.float64)
        if errors.shape != (len(self._asked),):
            raise ValueError(f"fitness of shape {errors.shape} for {len(self._asked)} chromosomes: give one each")
        errors = np.where(np.abs(errors) < _HOPELESS, errors, _HOPELESS)
        self._asked = None
        if not self._population.evaluations:
            self._take_first(errors)
        else:
            self._take_children(errors)

    def _take_first(self, errors: NDArray[np.float64]) -> None:
        population = self._population
        population.fitness[:] = errors
        for chromosome, error in zip(population.genes, errors, strict=True):
            remember(population, chromosome, error)
        population.progress[1] = len(errors)

    def _take_children(self, errors: NDArray[np.float64]) -> None:
        population, family, children = self._population, self._family, len(errors)
        chosen = population.order[: len(family.errors) - children]
        family.genes[children:], family.errors[children:] = population.genes[chosen], population.fitness[chosen]
        family.errors[:children] = errors
        survive(population, chosen, family.genes, family.errors)
        population.progress[0] += 1
        population.progress[1] += children
        population.progress[2] = has_settled(self._rules, population)

    @property
    def best(self) -> NDArray[np.float64]:
        """The best chromosome (p,) so far; NaN before the first `tell`."""
        return self._population.best.copy()

    @property
    def best_fitness(self) -> float:
        """The fitness of the best chromosome so far; infinite before the first `tell`."""
        return float(self._population.best_fitness[0])

    @property
    def evaluations(self) -> int:
        """The number of chromosomes evaluated so far."""
        return self._population.evaluations

    @property
    def done(self) -> bool:
        """Whether the stop rule or the number of generations has ended the search."""
        return self._population.stopped or self._population.generation >= self._settings.generations
