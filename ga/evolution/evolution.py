"""Run one search: with the paper's steady-state algorithm, or with the generational one of the `default` preset.

Both advance a `Population` in place by any number of generations, and give the same bits however the generations are
divided into calls. Therefore a run can be watched, interrupted and resumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np

from ga.evolution.generational import family_of, generational
from ga.evolution.generator import seeded
from ga.evolution.population import Population, Record, Rules, scatter, scatter_around, unrecorded
from ga.evolution.steady_state import steady_state, tangents_of
from ga.fitness.engine import Engine, columns_of, evaluate_all, parts

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ga.bounds import Bounds
    from ga.start import Start

Scheme = Literal["steady-state", "generational"]
Selection = Literal["minimise", "larger"]
Weights = Literal["error", "inverse-error"]
Replacement = Literal["worst", "worst-if-better", "oldest", "random"]
Beginning = Literal["uniform", "informed"]

_REPLACEMENTS: Final = get_args(Replacement)  # in the order of ga.evolution.population's numbers


@dataclass(frozen=True, slots=True)
class Settings:
    """The options of a search. If the paper's text has several interpretations, each is one value (docs/paper.md).

    scheme: "steady-state", the paper's Algorithm 1, with one child in each generation; "generational", with one family
        in each generation: p + 2 parents drawn at random, 5 p children by ensemble crossover; the best p + 2 survive.
    population: the number of chromosomes; None: 10 + 8 p.
    start: "uniform", the first population is drawn in the bounds; "informed", in a cube around the least-squares
        solution (ga.start), if the data determine that cube and it lies within the bounds.
    mutation: the probability that one gene of a child is redrawn.
    generations: the largest number of generations.
    weights: the crossover weighs a parent by its "error", equation 6 as printed, or by "inverse-error".
    tournament, selection, replacement: only for the steady-state scheme: how many chromosomes compete, whether the
        "larger" error wins or the smaller one ("minimise"), and which individual the child replaces: the "worst"
        always, the worst only "worst-if-better", the "oldest", or a "random" one.
    reach: only for the generational scheme: the spread of the children divided by that of their parents.
    tolerance: stop when the spread of the population's fitness is less than this fraction of the best; None: never.

    Raises ValueError for a value that is out of range or not allowed.
    """

    scheme: Scheme = "steady-state"
    population: int | None = 10
    start: Beginning = "uniform"
    mutation: float = 0.6
    generations: int = 200_000_000
    weights: Weights = "error"
    tournament: int = 3
    selection: Selection = "minimise"
    replacement: Replacement = "worst"
    reach: float = 1.1
    tolerance: float | None = None

    def __post_init__(self) -> None:
        for field, readings in READINGS.items():
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
        """Return the number of chromosomes for p genes.

        Raises ValueError if that number is smaller than a tournament or a family needs.
        """
        population = 10 + 8 * p if self.population is None else self.population
        drawn = self.tournament if self.scheme == "steady-state" else p + 2
        if population < drawn:
            raise ValueError(f"population of {population}: {drawn} different chromosomes are drawn from it at a time")
        return population


READINGS: Final[Mapping[str, tuple[str, ...]]] = {
    "scheme": get_args(Scheme),
    "selection": get_args(Selection),
    "weights": get_args(Weights),
    "replacement": _REPLACEMENTS,
    "start": get_args(Beginning),
}
"""The allowed values of the options of `Settings` that are interpretations of the paper's text."""

PRESETS: Final[Mapping[str, Settings]] = MappingProxyType(
    {
        "paper": Settings(),
        "default": Settings(
            scheme="generational",
            population=None,
            start="informed",
            mutation=0.0,
            generations=20_000,
            weights="inverse-error",
            tolerance=1e-8,
        ),
    }
)


def rules_of(bounds: Bounds, settings: Settings, floor: float, reject: bool) -> Rules:
    """Return bounds and settings in the form that the compiled loops use.

    floor: the smallest divisor, N m, in relative comparisons of fitness. reject: whether the evaluation of children
    that cannot survive is skipped.
    """
    rejects = settings.scheme == "generational" or settings.replacement == "worst-if-better"
    if settings.replacement == "worst" and settings.selection == "minimise" and settings.tournament > 1:
        rejects = rejects or settings.tolerance is None  # the stop rule asks how bad the worst is
    return Rules(
        bounds.low,
        bounds.high,
        settings.tournament,
        settings.selection == "larger",
        settings.weights == "inverse-error",
        _REPLACEMENTS.index(settings.replacement),
        float(settings.mutation),
        float(settings.reach),
        -1.0 if settings.tolerance is None else float(settings.tolerance),
        floor,
        reject and rejects,
    )


def unborn(p: int, settings: Settings, seed: int, trial: int) -> Population:
    """Return memory for a population of p genes, with its random generator. Raises ValueError if the population would
    be too small.
    """
    size = settings.population_for(p)
    return Population(
        genes=np.empty((size, p)),
        fitness=np.empty(size),
        order=np.arange(size),
        generator=seeded(seed, trial),
        best=np.full(p, np.nan),
        best_fitness=np.array([np.inf]),
        progress=np.zeros(3, np.int64),
    )


def begin(
    engine: Engine, bounds: Bounds, settings: Settings, seed: int, trial: int, *, start: Start | None = None
) -> Population:
    """Return the first population, evaluated. It is uniform at random in the cube `start`, or in the bounds if there is
    no start.

    Raises ValueError if the number of bounds differs from the engine's number of columns.
    """
    p = columns_of(engine)
    if bounds.low.size != p:
        raise ValueError(f"bounds of {bounds.low.size} parameters for {p} columns")
    population = unborn(p, settings, seed, trial)
    if start is None:
        scatter(bounds.low, bounds.high, population)
    else:
        scatter_around(bounds.low, bounds.high, start, population.genes, population.generator)
    evaluate_all(engine, population.genes, population.fitness)
    best = int(population.fitness.argmin())
    population.best[:], population.best_fitness[0] = population.genes[best], population.fitness[best]
    population.progress[1] = population.fitness.size
    return population


def advance(
    engine: Engine,
    bounds: Bounds,
    settings: Settings,
    population: Population,
    until: int,
    *,
    record: Record | None = None,
    reject: bool = True,
) -> None:
    """Continue the search to generation `until`, or until its stop rule ends it, and fill the record of the best
    fitness.

    reject: whether the evaluation of children that cannot survive is skipped; the population is the same to the last
    bit.
    """
    generations = until - population.generation
    if generations <= 0 or population.stopped:
        return
    p, rules = bounds.low.size, rules_of(bounds, settings, engine.floor, reject)
    samples, tree = parts(engine)
    record = unrecorded() if record is None else record
    if settings.scheme == "steady-state":
        steady_state(samples, tree, rules, population, tangents_of(p), np.empty(p), record, generations)
    else:
        generational(samples, tree, rules, population, family_of(p), record, generations)
