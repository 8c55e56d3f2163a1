from __future__ import annotations

import numpy as np
import pytest

from ga.evolution.generator import Words, load, seeded
from ga.evolution.operators import (
    arithmetic_crossover,
    clamp,
    crossover_share,
    ensemble_crossover,
    is_inside,
    mutate,
    sample_distinct,
    tournament,
    weighted_centre,
)


def unsigned(words: Words) -> Words:
    """The words as they are: compiled functions hand them out as whole numbers of Python, which have no size."""
    a, b, c, d = (np.uint64(word) for word in words)
    return a, b, c, d


def test_a_tournament_draws_different_chromosomes_each_with_the_same_probability() -> None:
    order, words = np.arange(10), unsigned(load(seeded(0, 0)))
    counts = np.zeros(10)
    for _ in range(3_000):
        words = sample_distinct(order, 3, unsigned(words))
        assert len(set(order[:3])) == 3
        counts[order[:3]] += 1
    assert sorted(order) == list(range(10))
    assert np.sum((counts - 900.0) ** 2 / 900.0) < 33.7


@pytest.mark.study
@pytest.mark.parametrize(("larger", "never"), [(False, {8, 9}), (True, {0, 1})])
def test_a_tournament_of_three_is_won_by_the_best_of_three(larger: bool, never: set[int]) -> None:
    fitness, order, words = np.arange(10.0), np.arange(10), unsigned(load(seeded(1, 0)))
    wins = np.zeros(10)
    for _ in range(12_000):
        winner, words = tournament(fitness, order, 3, larger, unsigned(words))
        wins[winner] += 1
    assert not wins[list(never)].any()
    # the best of ten is among the three with probability 3/10
    assert wins[9 if larger else 0] == pytest.approx(3600, abs=200)


def test_equation_6_is_the_weighted_mean_of_the_parents() -> None:
    g1, g2, f1, f2 = np.array([1.0, 10.0]), np.array([3.0, 20.0]), 0.25, 0.75
    child = np.empty(2)
    arithmetic_crossover(g1, g2, crossover_share(f1, f2, False), child)
    assert child == pytest.approx((g1 * f1 + g2 * f2) / (f1 + f2), rel=1e-15)


def test_equation_6_as_printed_favours_the_worse_parent_and_its_inverse_the_better() -> None:
    assert crossover_share(1.0, 3.0, False) == 0.25
    assert crossover_share(1.0, 3.0, True) == 0.75


def test_two_parents_without_error_have_equal_shares() -> None:
    assert crossover_share(0.0, 0.0, False) == 0.5


@pytest.mark.parametrize("inverse", [False, True])
def test_the_centre_of_two_parents_is_equation_6(inverse: bool) -> None:
    genes, fitness = np.array([[1.0, 10.0], [3.0, 20.0]]), np.array([0.25, 0.75])
    child, centre = np.empty(2), np.empty(2)
    arithmetic_crossover(genes[0], genes[1], crossover_share(0.25, 0.75, inverse), child)
    weighted_centre(genes, fitness, np.array([0, 1]), inverse, centre)
    assert centre == pytest.approx(child, rel=1e-15)


def test_a_mutation_redraws_one_gene_uniformly_in_its_bounds() -> None:
    low, high, words = np.array([-1.0, 0.0, 5.0]), np.array([1.0, 10.0, 6.0]), unsigned(load(seeded(2, 0)))
    drawn: list[list[float]] = [[], [], []]
    for _ in range(3000):
        child = np.full(3, 99.0)
        gene, words = mutate(child, low, high, unsigned(words))
        (changed,) = np.flatnonzero(child != 99.0)
        assert changed == gene
        drawn[changed].append(float((child[changed] - low[changed]) / (high - low)[changed]))
    for parts in drawn:
        assert len(parts) == pytest.approx(1000, abs=110)
        assert 0.0 <= min(parts) < 0.01
        assert 0.99 < max(parts) < 1.0
        assert np.mean(parts) == pytest.approx(0.5, abs=0.04)


def test_children_of_an_ensemble_are_spread_as_their_parents_are() -> None:
    rng, words = np.random.default_rng(3), unsigned(load(seeded(3, 0)))
    genes = rng.normal(size=(6, 2)) @ np.array([[1.0, 50.0], [0.0, 0.1]]) + np.array([5.0, -7.0])
    parents, centre = np.arange(6), np.array([1.0, 2.0])
    children = np.empty((8_000, 2))
    for i in range(len(children)):
        children[i] = centre
        words = ensemble_crossover(genes, parents, 1.0, children[i], unsigned(words))
    assert np.all(np.abs(children.mean(axis=0) - centre) < 4.0 * children.std(axis=0) / np.sqrt(len(children)))
    wanted = np.cov(genes.T, bias=True)
    assert np.cov(children.T) == pytest.approx(wanted, rel=0.07)


def test_clamping_sets_only_what_is_outside() -> None:
    child, low, high = np.array([-2.0, 0.5, 3.0]), np.zeros(3), np.ones(3)
    assert not is_inside(child, low, high)
    clamp(child, low, high)
    assert child.tolist() == [0.0, 0.5, 1.0]
    assert is_inside(child, low, high)
