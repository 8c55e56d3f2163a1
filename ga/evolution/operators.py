"""The operators of the search: the paper's, with their equation, and the ensemble crossover of the `default` preset.

A chromosome is a row of genes (p,), one gene a parameter in SI units. A population is (population, p). `order` is a
permutation of the population's rows, shuffled in place as far as it is needed: its first entries are the chromosomes
drawn. What draws at random takes the words of a generator and gives back those after it. Compiled, because they run up
to 2e8 times a trial.
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
"""How often a child outside the bounds is drawn anew before its genes are set on the bound."""


@compiled_inline
def copy(source: Genes, target: Genes) -> None:
    """Set target to source, gene by gene: a slice assignment takes two seconds to compile."""
    for k in range(target.size):
        target[k] = source[k]


@compiled_within
def sample_distinct(order: Order, count: int, words: Words) -> Words:
    """Draw `count` different chromosomes, each with the same probability, into the front of `order`."""
    for i in range(count):
        j, words = below(words, order.size - i)
        order[i], order[i + j] = order[i + j], order[i]
    return words


@compiled_inline
def tournament(fitness: NDArray[np.float64], order: Order, size: int, larger: bool, words: Words) -> tuple[int, Words]:
    """The winner, a row of the population, of `size` different chromosomes drawn at random.

    The paper, "Selection": three chromosomes, equal probabilities, "the chromosome with larger fitness" wins. Its
    fitness is an error, which is to be minimised: `larger` takes the sentence at its word, else the smaller error wins.
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
    """The first parent's share of the child in equation 6: f1/(f1 + f2), or with 1/f for f where `inverse`."""
    total = first_error + second_error
    if not total > 0.0:
        return 0.5
    return (second_error if inverse else first_error) / total


@compiled_inline
def arithmetic_crossover(first: Genes, second: Genes, share: float, child: Genes) -> None:
    """Equation 6: each gene of the child is the weighted mean of its parents' genes."""
    for k in range(child.size):
        child[k] = second[k] + share * (first[k] - second[k])


@compiled_within
def mutate(child: Genes, low: Genes, high: Genes, words: Words) -> tuple[int, Words]:
    """The paper, "Mutation": one gene, chosen at random, is redrawn uniformly in its bounds. Returns which."""
    k, words = below(words, child.size)
    part, words = uniform(words)
    child[k] = low[k] + (high[k] - low[k]) * part
    return k, words


@compiled_within
def weighted_centre(genes: Genes, fitness: NDArray[np.float64], parents: Order, inverse: bool, centre: Genes) -> None:
    """Equation 6 for any number of parents: their mean, weighted by the error or by its inverse."""
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
    """Move the child from the parents' weighted centre, spread as the parents are (Kobayashi 2009, REX).

    The deviation of every parent from their plain mean is added with an independent uniform factor of variance
    reach^2/parents. The child's covariance is then that of the parents, whatever the scale of the genes or the
    correlation between them; equation 6 alone can only contract. `reach` above 1 widens it.
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
    """Whether every gene is within its bounds."""
    for k in range(child.size):  # noqa: SIM110 - numba compiles no generator expression
        if not low[k] <= child[k] <= high[k]:
            return False
    return True


@compiled_inline
def clamp(child: Genes, low: Genes, high: Genes) -> None:
    """Set every gene that is out of bounds on the bound it passed."""
    for k in range(child.size):
        child[k] = min(max(child[k], low[k]), high[k])
