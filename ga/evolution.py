"""One search: the paper's steady-state algorithm and the generational one of the `default` preset.

Both advance a `Population` in place, any number of generations at a time, and end in the same bits however the
generations are divided into calls: that is what lets a run be watched, interrupted and resumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, get_args

import numpy as np

from ga.compiled import compiled
from ga.fitness import LANES, Samples, mean_absolute_error
from ga.generator import State, below, seeded, uniform
from ga.operators import (
    REDRAWS,
    Genes,
    Order,
    arithmetic_crossover,
    clamp,
    copy,
    crossover_share,
    ensemble_crossover,
    is_inside,
    mutate,
    sample_distinct,
    tournament,
    weighted_centre,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from ga.space import Bounds

Scheme = Literal["steady-state", "generational"]
Selection = Literal["minimise", "larger"]
Weights = Literal["error", "inverse-error"]
Replacement = Literal["worst", "worst-if-better", "oldest", "random"]

_REPLACEMENTS: Final = get_args(Replacement)
_WORST_IF_BETTER, _OLDEST, _RANDOM = (_REPLACEMENTS.index(r) for r in ("worst-if-better", "oldest", "random"))


@dataclass(frozen=True, slots=True)
class Settings:
    """What a search does; each reading of the paper is one value (docs/paper.md says what each gives).

    scheme: "steady-state", the paper's Algorithm 1, one child a generation; "generational", a family a generation:
        p + 2 parents drawn without preference, 5 p children by ensemble crossover, the best p + 2 of the family live.
    population: chromosomes; None: 10 + 8 p.
    mutation: probability that one gene of a child is redrawn.
    generations: how many at most.
    weights: the crossover weighs a parent by its "error", equation 6 as printed, or by "inverse-error".
    tournament, selection, replacement: of the steady-state scheme only; how many compete, whether the "larger" error
        wins or the smaller ("minimise"), and what the child replaces: the "worst" chromosome always or only
        "worst-if-better", the "oldest", or a "random" one.
    reach: of the generational scheme only; the spread of children over that of their parents.
    tolerance: stop when the fitness of the population spreads over less than this part of the best; None: never.
    Raises ValueError for a value out of range or a reading there is none of.
    """

    scheme: Scheme = "steady-state"
    population: int | None = 10
    mutation: float = 0.6
    generations: int = 200_000_000
    weights: Weights = "error"
    tournament: int = 3
    selection: Selection = "minimise"
    replacement: Replacement = "worst"
    reach: float = 1.1
    tolerance: float | None = None

    def __post_init__(self) -> None:
        for field, readings in _READINGS.items():
            if getattr(self, field) not in readings:
                raise ValueError(f'{field} "{getattr(self, field)}" is not one of {", ".join(readings)}')
        if self.generations < 1:
            raise ValueError(f"{self.generations} generations: give 1 or more")
        if not 0.0 <= self.mutation <= 1.0:
            raise ValueError(f"mutation {self.mutation:g} is not a probability: give 0 to 1")
        if self.tournament < 1:
            raise ValueError(f"tournament of {self.tournament}: give 1 or more")
        if not 0.0 < self.reach < float("inf"):
            raise ValueError(f"reach {self.reach:g} is not a positive number")
        if self.tolerance is not None and not 0.0 <= self.tolerance < float("inf"):
            raise ValueError(f"tolerance {self.tolerance:g}: give 0 or more")
        if self.population is not None and self.population < 2:
            raise ValueError(f"population of {self.population}: give 2 or more")

    def population_for(self, p: int) -> int:
        """The number of chromosomes for p genes.

        Raises ValueError where it is smaller than a tournament or a family needs.
        """
        population = 10 + 8 * p if self.population is None else self.population
        drawn = self.tournament if self.scheme == "steady-state" else p + 2
        if population < drawn:
            raise ValueError(f"population of {population}: {drawn} different chromosomes are drawn from it at a time")
        return population


_READINGS: Final[Mapping[str, tuple[str, ...]]] = {
    "scheme": get_args(Scheme),
    "selection": get_args(Selection),
    "weights": get_args(Weights),
    "replacement": _REPLACEMENTS,
}

PRESETS: Final[Mapping[str, Settings]] = MappingProxyType(
    {
        "paper": Settings(),
        "default": Settings(
            scheme="generational",
            population=None,
            mutation=0.0,
            generations=20_000,
            weights="inverse-error",
            tolerance=1e-8,
        ),
    }
)


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


class _Rules(NamedTuple):
    """Bounds and settings as the compiled loops read them."""

    low: Genes
    high: Genes
    tournament: int
    larger: bool
    inverse: bool
    replacement: int
    mutation: float
    reach: float
    tolerance: float


def _rules(bounds: Bounds, settings: Settings) -> _Rules:
    return _Rules(
        bounds.low,
        bounds.high,
        settings.tournament,
        settings.selection == "larger",
        settings.weights == "inverse-error",
        _REPLACEMENTS.index(settings.replacement),
        float(settings.mutation),
        float(settings.reach),
        -1.0 if settings.tolerance is None else float(settings.tolerance),
    )


def begin(samples: Samples, bounds: Bounds, settings: Settings, seed: int, trial: int) -> Population:
    """The paper, "Initial Population": uniform at random in the bounds, evaluated.

    Raises ValueError where the bounds are not of as many parameters as the samples have columns.
    """
    p = samples.blocks.shape[1] - 1
    if bounds.low.size != p:
        raise ValueError(f"bounds of {bounds.low.size} parameters for {p} columns")
    size = settings.population_for(p)
    population = Population(
        genes=np.empty((size, p)),
        fitness=np.empty(size),
        order=np.arange(size),
        generator=seeded(seed, trial),
        best=np.empty(p),
        best_fitness=np.array([np.inf]),
        progress=np.zeros(3, np.int64),
    )
    _populate(samples, _rules(bounds, settings), population)
    return population


def advance(samples: Samples, bounds: Bounds, settings: Settings, population: Population, until: int) -> None:
    """Take the search to generation `until`, or to where its stop rule ends it."""
    generations = until - population.generation
    if generations <= 0 or population.stopped:
        return
    loop = _steady_state if settings.scheme == "steady-state" else _generational
    loop(samples, _rules(bounds, settings), population, generations)


@compiled
def _populate(samples: Samples, rules: _Rules, population: Population) -> None:
    scratch = np.empty((2, LANES))
    for i in range(population.fitness.size):
        for k in range(rules.low.size):
            width = rules.high[k] - rules.low[k]
            population.genes[i, k] = rules.low[k] + width * uniform(population.generator)
        population.fitness[i] = mean_absolute_error(samples, population.genes[i], scratch)
        _remember(population, population.genes[i], population.fitness[i])
    population.progress[1] = population.fitness.size


@compiled
def _remember(population: Population, child: Genes, error: float) -> None:
    """Keep the best chromosome ever: some readings of the paper let the population lose it."""
    if error < population.best_fitness[0]:
        population.best_fitness[0] = error
        copy(child, population.best)


@compiled
def _has_settled(samples: Samples, rules: _Rules, population: Population) -> bool:
    """Whether the fitness of the population spreads over no more than the tolerance."""
    if rules.tolerance < 0.0:
        return False
    lowest, highest = np.inf, 0.0
    for error in population.fitness:
        lowest, highest = min(lowest, error), max(highest, error)
    return bool(highest - lowest <= rules.tolerance * max(lowest, samples.floor))


@compiled
def _steady_state(samples: Samples, rules: _Rules, population: Population, generations: int) -> None:
    """Algorithm 1 of the paper."""
    scratch = np.empty((2, LANES))
    child = np.empty(rules.low.size)
    genes, fitness, generator = population.genes, population.fitness, population.generator
    for _ in range(generations):
        a = tournament(fitness, population.order, rules.tournament, rules.larger, generator)
        b = tournament(fitness, population.order, rules.tournament, rules.larger, generator)
        arithmetic_crossover(genes[a], genes[b], crossover_share(fitness[a], fitness[b], rules.inverse), child)
        if uniform(generator) < rules.mutation:
            mutate(child, rules.low, rules.high, generator)
        error = mean_absolute_error(samples, child, scratch)
        _remember(population, child, error)
        place = _place(rules, population)
        if rules.replacement != _WORST_IF_BETTER or error < fitness[place]:
            copy(child, genes[place])
            fitness[place] = error
        population.progress[0] += 1
        population.progress[1] += 1
        if _has_settled(samples, rules, population):
            population.progress[2] = 1
            break


@compiled
def _place(rules: _Rules, population: Population) -> int:
    """The row that the child takes."""
    size = population.fitness.size
    if rules.replacement == _OLDEST:
        return int(population.progress[0] % size)  # every child enters, so ages go round
    if rules.replacement == _RANDOM:
        return below(population.generator, size)
    return int(population.fitness.argmax())


@compiled
def _generational(samples: Samples, rules: _Rules, population: Population, generations: int) -> None:
    """Families one after another: parents at random, children about their centre, the best of both live on."""
    p = rules.low.size
    parents, children = p + 2, 5 * p
    scratch = np.empty((2, LANES))
    family, errors = np.empty((parents + children, p)), np.empty(parents + children)
    for _ in range(generations):
        sample_distinct(population.order, parents, population.generator)
        chosen = population.order[:parents]
        _breed(rules, population, chosen, family[:children])
        for i in range(children):
            errors[i] = mean_absolute_error(samples, family[i], scratch)
        for i in range(parents):
            copy(population.genes[chosen[i]], family[children + i])
            errors[children + i] = population.fitness[chosen[i]]
        _survive(population, chosen, family, errors)
        population.progress[0] += 1
        population.progress[1] += children
        if _has_settled(samples, rules, population):
            population.progress[2] = 1
            break


@compiled
def _breed(rules: _Rules, population: Population, parents: Order, children: NDArray[np.float64]) -> None:
    """Fill children (count, p) by ensemble crossover and mutation, within the bounds."""
    generator = population.generator
    centre = np.empty(rules.low.size)
    weighted_centre(population.genes, population.fitness, parents, rules.inverse, centre)
    for i in range(len(children)):
        child = children[i]
        for _ in range(REDRAWS):
            copy(centre, child)
            ensemble_crossover(population.genes, parents, rules.reach, generator, child)
            if is_inside(child, rules.low, rules.high):
                break
        clamp(child, rules.low, rules.high)
        if uniform(generator) < rules.mutation:
            mutate(child, rules.low, rules.high, generator)


@compiled
def _survive(population: Population, places: Order, family: NDArray[np.float64], errors: NDArray[np.float64]) -> None:
    """Put the best of the family into the parents' places, the best first; errors is used up."""
    for place in places:
        best = errors.argmin()
        copy(family[best], population.genes[place])
        population.fitness[place] = errors[best]
        _remember(population, family[best], errors[best])
        errors[best] = np.inf
