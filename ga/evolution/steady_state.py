"""The paper's steady-state scheme, Algorithm 1: one child in each generation.

A child that cannot survive is not evaluated. After the first thousand generations nearly every mutant is such a child,
because its gene is redrawn uniformly in wide bounds. The fitness f is convex, so f(x) >= f(a) + slope(a) . (x - a) for
any a: a tangent is a lower bound. If a mutant was evaluated and rejected, the tangent at the mutant is stored, for the
gene that was redrawn and the side of the redraw; the next mutants that this tangent rejects cost a few multiplications.
Rejecting a child must not change the search by a bit:

- If only a better child replaces the worst, a child no better than the worst has no effect.
- If the child always replaces the worst, and the smallest error wins a tournament of two or more, a child worse than
  all others is the worst until the next child replaces it, and never wins. Only its exact error remains unknown.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_inline, compiled_no_refcount, compiled_within
from ga.evolution.generator import Words, below, load, store, uniform
from ga.evolution.operators import Genes, arithmetic_crossover, copy, crossover_share, mutate, tournament
from ga.evolution.population import (
    IF_BETTER,
    OLDEST,
    RANDOM,
    Population,
    Record,
    Rules,
    due_after,
    has_settled,
    recorded,
    remember,
)
from ga.fitness.cells import Tree
from ga.fitness.dense import ROUNDING, Samples
from ga.fitness.engine import error_of, tangent_of

Tangents = NDArray[np.float64]


def tangents_of(p: int) -> Tangents:
    """Return memory for two tangents for each gene, (2 p, 2 p + 1): fitness, point and slope. A tangent of zeros
    rejects nothing.
    """
    return np.zeros((2 * p, 2 * p + 1))


@compiled_no_refcount
def steady_state(  # noqa: PLR0917 - the compiled loops take their parts by position
    samples: Samples | None,
    tree: Tree | None,
    rules: Rules,
    population: Population,
    tangents: Tangents,
    child: Genes,
    record: Record,
    generations: int,
) -> None:
    """Continue the search for some generations.

    tangents: from `tangents_of` or from an earlier call. child (p,): working space.
    """
    due = due_after(record, population)
    genes, fitness, order = population.genes, population.fitness, population.order
    words = load(population.generator)
    worst, second = _worst_two(fitness)
    for _ in range(generations):
        a, words = tournament(fitness, order, rules.tournament, rules.larger, words)
        b, words = tournament(fitness, order, rules.tournament, rules.larger, words)
        arithmetic_crossover(genes[a], genes[b], crossover_share(fitness[a], fitness[b], rules.inverse), child)
        mutated = -1
        chance, words = uniform(words)
        if chance < rules.mutation:
            mutated, words = mutate(child, rules.low, rules.high, words)
        limit = np.inf
        if rules.rejects:
            limit = fitness[worst] if rules.replacement == IF_BETTER else second
        if mutated >= 0 and rules.rejects and _is_hopeless(tangents, mutated, population.best, child, limit):
            error = np.inf
        else:
            error = error_of(samples, tree, child, limit)
            remember(population, child, error)
            if mutated >= 0 and error > limit:
                _learn(samples, tree, tangents, mutated, population.best, child, limit)
        place, words = _place(rules, population, worst, words)
        if rules.replacement != IF_BETTER or error < fitness[place]:
            copy(child, genes[place])
            fitness[place] = error
            if place != worst or error <= second:
                worst, second = _worst_two(fitness)
        population.progress[0] += 1
        population.progress[1] += 1
        due = recorded(record, due, population)
        if rules.tolerance >= 0.0 and has_settled(rules, population):
            population.progress[2] = 1
            break
    store(words, population.generator)
    if rules.rejects and fitness[worst] == np.inf:
        fitness[worst] = error_of(samples, tree, genes[worst], np.inf)


@compiled_inline
def _worst_two(fitness: NDArray[np.float64]) -> tuple[int, float]:
    """Return the row of the largest error (the first of equal ones), and the largest error of the other rows."""
    worst, second = 0, -np.inf
    for i in range(1, fitness.size):
        if fitness[i] > fitness[worst]:
            worst, second = i, fitness[worst]
        elif fitness[i] > second:
            second = fitness[i]
    return worst, second


@compiled_inline
def _place(rules: Rules, population: Population, worst: int, words: Words) -> tuple[int, Words]:
    """Return the row that the child replaces. worst: the row of the largest error."""
    place = worst
    if rules.replacement == OLDEST:
        place = population.progress[0] % population.fitness.size  # every child enters, so ages go round
    if rules.replacement == RANDOM:
        place, words = below(words, population.fitness.size)
    return place, words


@compiled_inline
def _is_hopeless(tangents: Tangents, gene: int, centre: Genes, child: Genes, limit: float) -> bool:
    """Return whether a tangent proves that the fitness of the child exceeds the limit.

    The tangent is the one for the redrawn gene and for the child's side of the centre.
    """
    p = child.size
    tangent = tangents[2 * gene + (1 if child[gene] > centre[gene] else 0)]
    bound = extent = tangent[0]
    for k in range(p):
        rise = tangent[p + 1 + k] * (child[k] - tangent[1 + k])
        bound += rise
        extent += abs(rise)
    return bool(bound - ROUNDING * extent > limit)


@compiled_within
def _learn(  # noqa: PLR0917 - the compiled loops take their parts by position
    samples: Samples | None,
    tree: Tree | None,
    tangents: Tangents,
    gene: int,
    centre: Genes,
    child: Genes,
    limit: float,
) -> None:
    """Store the tangent at the child for the redrawn gene and for the child's side of the centre. limit: error that
    rejects a child, N m.
    """
    p = child.size
    tangent = tangents[2 * gene + (1 if child[gene] > centre[gene] else 0)]
    for k in range(p):
        tangent[1 + k] = child[k]
    tangent[0] = tangent_of(samples, tree, child, limit, tangent[p + 1 :])
