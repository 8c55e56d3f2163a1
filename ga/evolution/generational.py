"""The generational scheme of the `default` preset: each generation is one family of parents and children.

A child worse than all parents does not survive, so its exact fitness is not needed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount, compiled_within
from ga.evolution.generator import load, store, uniform
from ga.evolution.operators import (
    REDRAWS,
    Genes,
    Order,
    clamp,
    copy,
    ensemble_crossover,
    is_inside,
    mutate,
    sample_distinct,
    weighted_centre,
)
from ga.evolution.population import Population, Record, Rules, due_after, has_settled, recorded, remember
from ga.fitness.cells import Tree
from ga.fitness.dense import Samples
from ga.fitness.engine import error_of


class Family(NamedTuple):
    """Working space of one search: the chromosomes (7 p + 2, p) of the children, followed by the parents, and their
    errors, N m.
    """

    genes: NDArray[np.float64]
    errors: NDArray[np.float64]
    centre: NDArray[np.float64]


def family_of(p: int) -> Family:
    """Return working space for p + 2 parents and 5 p children of p genes."""
    return Family(np.empty((p + 2 + 5 * p, p)), np.empty(p + 2 + 5 * p), np.empty(p))


@compiled_no_refcount
def generational(  # noqa: PLR0917 - the compiled loops take their parts by position
    samples: Samples | None,
    tree: Tree | None,
    rules: Rules,
    population: Population,
    family: Family,
    record: Record,
    generations: int,
) -> None:
    """Run some generations of the scheme: draw parents at random, breed children around their centre, and keep the best
    of both.

    The best of the family take the parents' places in the population.
    """
    due = due_after(record, population)
    p = rules.low.size
    parents, children = p + 2, 5 * p
    genes, errors = family.genes, family.errors
    for _ in range(generations):
        draw_parents(population)
        chosen = population.order[:parents]
        breed(rules, population, chosen, family.centre, genes[:children])
        limit = 0.0 if rules.rejects else np.inf
        for i in range(parents):
            copy(population.genes[chosen[i]], genes[children + i])
            errors[children + i] = population.fitness[chosen[i]]
            limit = max(limit, errors[children + i])
        for i in range(children):
            errors[i] = error_of(samples, tree, genes[i], limit)
        survive(population, chosen, genes, errors)
        population.progress[0] += 1
        population.progress[1] += children
        due = recorded(record, due, population)
        if has_settled(rules, population):
            population.progress[2] = 1
            break


@compiled_within
def draw_parents(population: Population) -> None:
    """Put p + 2 different chromosomes, each with equal probability, in front of the population's order."""
    count = population.genes.shape[1] + 2
    store(sample_distinct(population.order, count, load(population.generator)), population.generator)


@compiled_within
def breed(rules: Rules, population: Population, parents: Order, centre: Genes, children: NDArray[np.float64]) -> None:
    """Fill `children` (count, p) by ensemble crossover and mutation, within the bounds.

    parents: rows of the parents in the population. centre (p,): working space.
    """
    words = load(population.generator)
    weighted_centre(population.genes, population.fitness, parents, rules.inverse, centre)
    for i in range(len(children)):
        child = children[i]
        for _ in range(REDRAWS):
            copy(centre, child)
            words = ensemble_crossover(population.genes, parents, rules.reach, child, words)
            if is_inside(child, rules.low, rules.high):
                break
        clamp(child, rules.low, rules.high)
        chance, words = uniform(words)
        if chance < rules.mutation:
            _, words = mutate(child, rules.low, rules.high, words)
    store(words, population.generator)


@compiled_within
def survive(population: Population, places: Order, genes: NDArray[np.float64], errors: NDArray[np.float64]) -> None:
    """Put the best chromosomes of the family into the parents' rows of the population, the best first.

    places: the parents' rows. genes, errors: the family; `errors` is overwritten.
    """
    for i in range(places.size):
        best = 0
        for j in range(1, errors.size):
            if errors[j] < errors[best]:
                best = j
        copy(genes[best], population.genes[places[i]])
        population.fitness[places[i]] = errors[best]
        remember(population, genes[best], errors[best])
        errors[best] = np.inf
