"""The operators of the search: the paper's, with the number of their equation, and the ensemble crossover of the
`default` preset.

A chromosome is a row of genes (p,), one gene for each parameter, SI. A population is an array (population, p). `order`
is a permutation of the population's rows, of which only the front is shuffled, in place: its first entries are the
chromosomes drawn. Random functions take the words of a generator and return the words after the draw. All are compiled,
because they run up to 2e8 times a trial.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_inline, compiled_within
from ga.evolution.generator import Words, below, uniform

Genes: TypeAlias = NDArray[np.float64]
Order: TypeAlias = NDArray[np.int64]

REDRAWS = 20
"""The number of times that a child outside the bounds is drawn again before its genes are set to the bounds."""


@compiled_inline
def copy(source: Genes, target: Genes) -> None:
    """Set target to source, gene by gene: a slice assignment takes two seconds to compile."""
    for k in range(target.size):
        target[k] = source[k]


@compiled_within
def sample_distinct(order: Order, count: int, words: Words) -> Words:
    """Draw `count` different chromosomes, each with the same probability: put their rows into the front of `order`."""
    for i in range(count):
        j, words = below(words, order.size - i)
        order[i], order[i + j] = order[i + j], order[i]
    return words


@compiled_inline
def tournament(fitness: NDArray[np.float64], order: Order, size: int, larger: bool, words: Words) -> tuple[int, Words]:
    """Return the winner, a row of the population, among `size` different chromosomes drawn at random.

    The paper, "Selection": three chromosomes, equal probabilities, "the chromosome with larger fitness" wins. Its
    fitness is an error, which is to be minimised. larger: whether the larger error wins, as the paper's sentence says;
    else the smaller error wins.
    """
    words = sample_distinct(order, size, words)
    winner = order[0]
    for i in range(1, size):
        rival = order[i]
        better = fitness[rival] > fitness[winner] if larger else fitness[rival] < fitness[winner]
        if better:
            winner = rival
    return winner, words


@compiled_inline
def crossover_share(first_error: float, second_error: float, inverse: bool) -> float:
    """Return the first parent's weight in equation 6: f1/(f1 + f2), or with 1/f in place of f if `inverse`."""
    total = first_error + second_error
    if not total > 0.0:
        return 0.5
    return (second_error if inverse else first_error) / total


@compiled_inline
def arithmetic_crossover(first: Genes, second: Genes, share: float, child: Genes) -> None:
    """Fill `child` by equation 6: each gene is the weighted mean of its parents' genes. share: the weight of the first
    parent.
    """
    for k in range(child.size):
        child[k] = second[k] + share * (first[k] - second[k])


@compiled_within
def mutate(child: Genes, low: Genes, high: Genes, words: Words) -> tuple[int, Words]:
    """Redraw one gene of the child, chosen at random, uniformly between `low` and `high` (the paper, "Mutation").
    Return the gene's index.
    """
    k, words = below(words, child.size)
    part, words = uniform(words)
    child[k] = low[k] + (high[k] - low[k]) * part
    return k, words


@compiled_within
def weighted_centre(genes: Genes, fitness: NDArray[np.float64], parents: Order, inverse: bool, centre: Genes) -> None:
    """Fill `centre` by equation 6 for any number of parents: their mean, weighted by the error or (inverse) by
    1/error.
    """
    total = 0.0
    for k in range(centre.size):
        centre[k] = 0.0
    for i in parents:
        # 1/f overflows where a chromosome fits to the last bit; such a parent takes nearly all of the weight anyway
        weight = 1.0 / max(fitness[i], 1e-300) if inverse else max(fitness[i], 1e-300)
        total += weight
        for k in range(centre.size):
            centre[k] += weight * genes[i, k]
    for k in range(centre.size):
        centre[k] /= total


@compiled_within
def ensemble_crossover(genes: Genes, parents: Order, reach: float, child: Genes, words: Words) -> Words:
    """Move the child from the parents' weighted centre by a random deviation with the parents' spread (Kobayashi 2009,
    REX).

    The deviation of every parent from their plain mean is added with an independent uniform factor of variance
    reach^2/parents. For `reach` 1 the child's covariance is then that of the parents, whatever the scale of the genes
    or the correlation between them; a larger `reach` widens it. Equation 6 alone can only contract.
    """
    count = parents.size
    half_range = reach * math.sqrt(3.0 / count)
    anchor = genes[parents[0]]  # differences of neighbours stay exact when the population has closed in
    total = 0.0
    for i in parents:
        part, words = uniform(words)
        factor = half_range * (2.0 * part - 1.0)
        total += factor
        for k in range(child.size):
            child[k] += factor * (genes[i, k] - anchor[k])
    for i in parents:
        for k in range(child.size):
            child[k] -= total / count * (genes[i, k] - anchor[k])
    return words


@compiled_inline
def is_inside(child: Genes, low: Genes, high: Genes) -> bool:
    """Return whether every gene of the child lies between its bounds `low` and `high`."""
    for k in range(child.size):  # noqa: SIM110 - numba compiles no generator expression
        if not low[k] <= child[k] <= high[k]:
            return False
    return True


@compiled_inline
def clamp(child: Genes, low: Genes, high: Genes) -> None:
    """Set every gene of the child that is beyond its bound `low` or `high` to that bound."""
    for k in range(child.size):
        child[k] = min(max(child[k], low[k]), high[k])
