"""The optimisers of others, each with the settings that did best here, behind one fitness that is watched.

Each searches the unit square, which the watched fitness maps onto the box, or, if informed, onto the cube
around the least-squares solution that our `default` begins in (`ga.start`), in its coordinates. Each hands over a whole
generation at a time through what its public interface offers for that (the comments name it), and its own stop rules
are off. Of the population sizes 10, 20, 50 and 100 (differential evolution: 6 to 30, CMA-ES: 6 to 24) each has the one
that came soonest within 1e-6 of the optimum at 2,500 samples.
"""

from __future__ import annotations

import math
import random
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import cma  # type: ignore[import-untyped]
import numpy as np
import pygad  # type: ignore[import-untyped]
from cmaes import CMA  # type: ignore[import-untyped]
from deap import algorithms, base, creator, tools  # type: ignore[import-untyped]
from deap import cma as deap_strategy
from pymoo.algorithms.soo.nonconvex.ga import GA  # type: ignore[import-untyped]
from pymoo.core.problem import Problem  # type: ignore[import-untyped]
from pymoo.optimize import minimize  # type: ignore[import-untyped]
from scipy.optimize import differential_evolution

from ga.bounds import Bounds, bounds_from_data
from ga.compiled import compiled
from ga.lad.exact import Optimum, least_absolute_deviations
from ga.start import Start, start_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

TARGETS = (1e-3, 1e-6, 1e-9)
"""Relative distances to the exact optimum."""

FOREVER = 10**9
"""Generations: the targets or the cap end a run."""

LANES = 128


@dataclass(frozen=True)
class Data:
    """The paper's joint under a chirp with noise, the box to search, where ours begins and the proven optimum."""

    columns: Array
    torque: Array
    bounds: Bounds
    start: Start
    optimum: Optimum


def recording(samples: int) -> Data:
    """A chirp of 0.3 rad through 0.1 to 15 Hz at 500 Hz, Kc and Bc of the paper, 0.2 mN m of noise."""
    at = np.arange(samples) / 500.0
    sweep = 14.9 / at[-1]
    phase = 2.0 * np.pi * (0.1 + 0.5 * sweep * at) * at
    rate = 0.3 * 2.0 * np.pi * (0.1 + sweep * at) * np.cos(phase)
    columns = np.stack([0.3 * np.sin(phase), rate], axis=1)
    torque = columns @ np.array([17.75e-3, 0.19e-3]) + np.random.default_rng(0).normal(scale=2e-4, size=samples)
    bounds = bounds_from_data(columns, torque)
    start = start_of(columns, torque, bounds)
    assert start is not None
    return Data(columns, torque, bounds, start, least_absolute_deviations(columns, torque))


@compiled
def mean_errors(torque: Array, columns: Array, corner: Array, sides: Array, units: Array) -> Array:
    """Equation 5 for chromosomes corner + sides . units, units (m, 2), from torque (n,), columns (2, n): (m,), N m.

    Partial sums side by side, so that it runs in the vector units: the best a user of the others could write.
    """
    errors, total = np.empty(len(units)), np.empty(LANES)
    whole = len(torque) - len(torque) % LANES
    for i in range(len(units)):
        stiffness = corner[0] + sides[0, 0] * units[i, 0] + sides[0, 1] * units[i, 1]
        damping = corner[1] + sides[1, 0] * units[i, 0] + sides[1, 1] * units[i, 1]
        total[:] = 0.0
        for b in range(0, whole, LANES):
            measured, angle, rate = torque[b : b + LANES], columns[0, b : b + LANES], columns[1, b : b + LANES]
            for j in range(LANES):
                total[j] += abs(measured[j] - stiffness * angle[j] - damping * rate[j])
        error = total.sum()
        for k in range(whole, len(torque)):
            error += abs(torque[k] - stiffness * columns[0, k] - damping * columns[1, k])
        errors[i] = error / len(torque)
    return errors


class Reached(NamedTuple):
    """When a target was reached: s, and evaluations, that one included."""

    seconds: float
    evaluations: float


NEVER = Reached(math.inf, math.inf)


class Ended(BaseException):
    """The last target was reached or the cap is over. Not an Exception: those are logged or swallowed on the way."""


@dataclass
class Watched:
    """The fitness the others call, a generation at a time; it keeps the book on targets and cap.

    informed: whether the unit square is the cube that ours begins in, or the whole box.
    """

    data: Data
    cap: float
    informed: bool = False
    evaluations: int = 0
    reached: dict[float, Reached] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.began = time.process_time()
        self.columns = np.ascontiguousarray(self.data.columns.T)
        bounds, start = self.data.bounds, self.data.start
        self.corner, self.sides = bounds.low, np.diag(bounds.high - bounds.low)
        if self.informed:
            self.sides = 2.0 * start.reach * start.backward
            self.corner = start.centre - self.sides @ [0.5, 0.5]

    def __call__(self, units: Array) -> Array:
        """The fitness (m,), N m, of chromosomes (m, 2), the box being the unit square."""
        data = self.data
        errors = mean_errors(data.torque, self.columns, self.corner, self.sides, units)
        seconds = time.process_time() - self.began
        if seconds > self.cap:
            raise Ended
        least = data.optimum.relative_gap(errors.min())
        while least <= TARGETS[len(self.reached)]:
            target = TARGETS[len(self.reached)]
            first = int(np.argmax(data.optimum.relative_gap(errors) <= target))  # type: ignore[arg-type]
            self.reached[target] = Reached(seconds, self.evaluations + first + 1)
            if len(self.reached) == len(TARGETS):
                raise Ended
        self.evaluations += len(units)
        return errors


def pymoo_ga(fitness: Watched, seed: int) -> None:
    # vectorised `Problem`; SBX and polynomial mutation are its defaults
    class Joint(Problem):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(n_var=2, n_obj=1, xl=0.0, xu=1.0)

        def _evaluate(self, x: Array, out: dict[str, Array], *_: object, **__: object) -> None:
            out["F"] = fitness(x)

    minimize(Joint(), GA(pop_size=50), ("n_gen", FOREVER), seed=seed, copy_algorithm=False)


def pygad_ga(fitness: Watched, seed: int) -> None:
    # `fitness_batch_size`; operators for real numbers, since its default ones seldom came within 1e-6 in 4 s
    pygad.GA(
        num_generations=FOREVER,
        num_parents_mating=5,
        sol_per_pop=10,
        num_genes=2,
        fitness_func=lambda _ga, units, _places: -fitness(np.array(units)),
        fitness_batch_size=10,
        gene_space={"low": 0.0, "high": 1.0},
        crossover_type="sbx",
        mutation_type="polynomial",
        random_seed=seed,
        suppress_warnings=True,
    ).run()


creator.create("Least", base.Fitness, weights=(-1.0,))
creator.create("Chromosome", list, fitness=creator.Least)


def deap_toolbox(fitness: Watched) -> Any:
    # a `map` of one's own, as for its parallel evaluation
    def together(_evaluate: object, chromosomes: list[list[float]]) -> list[tuple[float]]:
        return [(error,) for error in fitness(np.array(chromosomes))] if chromosomes else []

    toolbox = base.Toolbox()
    toolbox.register("evaluate", fitness)
    toolbox.register("map", together)
    return toolbox


def deap_ga(fitness: Watched, seed: int) -> None:
    # the operators that pymoo has
    random.seed(seed)
    toolbox = deap_toolbox(fitness)
    toolbox.register("mate", tools.cxSimulatedBinaryBounded, low=0.0, up=1.0, eta=20.0)
    toolbox.register("mutate", tools.mutPolynomialBounded, low=0.0, up=1.0, eta=20.0, indpb=0.5)
    toolbox.register("select", tools.selTournament, tournsize=3)
    population = [creator.Chromosome([random.random(), random.random()]) for _ in range(20)]  # noqa: S311 - no secret
    algorithms.eaMuPlusLambda(population, toolbox, 20, 20, 0.7, 0.3, FOREVER, verbose=False)


def deap_cma(fitness: Watched, seed: int) -> None:
    # it knows no bounds: here it needs none
    np.random.seed(seed)  # noqa: NPY002 - the one generator it draws from
    strategy = deap_strategy.Strategy(centroid=[0.5, 0.5], sigma=0.25, lambda_=8)
    toolbox = deap_toolbox(fitness)
    toolbox.register("generate", strategy.generate, creator.Chromosome)
    toolbox.register("update", strategy.update)
    algorithms.eaGenerateUpdate(toolbox, ngen=FOREVER, verbose=False)


def scipy_de(fitness: Watched, seed: int) -> None:
    # `vectorized=True`; polishing would come after the end only
    differential_evolution(
        lambda units: fitness(np.ascontiguousarray(units.T)),
        [(0.0, 1.0), (0.0, 1.0)],
        maxiter=FOREVER,
        popsize=5,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=seed,
    )


def pycma(fitness: Watched, seed: int) -> None:
    # ask and tell
    options = {"bounds": [0.0, 1.0], "popsize": 8, "seed": seed + 1, "verbose": -9, "verb_log": 0}  # a seed 0 is random
    options |= dict.fromkeys(("tolfun", "tolfunhist", "tolfunrel", "tolx"), 0.0)
    options |= dict.fromkeys(("tolflatfitness", "tolstagnation", "tolconditioncov", "maxiter"), math.inf)
    strategy = cma.CMAEvolutionStrategy([0.5, 0.5], 0.25, options)
    while not strategy.stop():
        units = strategy.ask()
        strategy.tell(units, fitness(np.array(units)).tolist())


def cmaes_cma(fitness: Watched, seed: int) -> None:
    # ask and tell; it asks for one chromosome at a time
    box = np.array([[0.0, 1.0], [0.0, 1.0]])
    strategy = CMA(mean=np.full(2, 0.5), sigma=0.25, bounds=box, seed=seed, population_size=8)
    while True:
        units = np.array([strategy.ask() for _ in range(8)])
        strategy.tell(list(zip(units, fitness(units).tolist(), strict=True)))


PEERS: Mapping[str, Callable[[Watched, int], None]] = {
    "pymoo GA": pymoo_ga,
    "pygad": pygad_ga,
    "DEAP GA": deap_ga,
    "DEAP CMA-ES": deap_cma,
    "scipy DE": scipy_de,
    "pycma": pycma,
    "cmaes": cmaes_cma,
}
