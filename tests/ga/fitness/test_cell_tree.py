from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ga.bounds import PAPER_BOUNDS, Bounds, bounds_from_data
from ga.fitness.cell_tree import tree_tangent
from ga.fitness.cells import Tree, another, grow
from ga.fitness.dense import pack
from ga.fitness.engine import engine_for, evaluate
from ga.lad.exact import least_absolute_deviations

from ..lad import test_exact as lad

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.ga.conftest import Data, Making

pytestmark = pytest.mark.study  # the tree takes 20 s to compile, and only searches of a billion residuals use it

KINDS = [*lad.KINDS, "all zero", "no noise", "one heavy row"]


def recording(kind: str, n: int, p: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    columns, torque = lad.recording(kind, n, p, rng)
    if kind == "all zero":
        columns[:] = 0.0
    if kind == "no noise":
        torque = columns @ rng.normal(size=p)
    if kind == "one heavy row":  # as when settled rows are collapsed into one
        columns[0], torque[0] = 1e6 * columns[0], 1e6 * torque[0] + 1e6
    return columns, torque


def places(bounds: Bounds, centre: NDArray[np.float64], rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Chromosomes all over the bounds, on their corners, and ever nearer to the centre."""
    width = bounds.high - bounds.low
    everywhere = [bounds.low + width * rng.uniform(size=width.size) for _ in range(8)]
    near = [centre + width * 10.0**-e * rng.uniform(-1.0, 1.0, size=width.size) for e in range(1, 15)]
    inside = [np.clip(genes, bounds.low, bounds.high) for genes in near]
    return [*everywhere, bounds.low, bounds.high, *inside, np.clip(centre, bounds.low, bounds.high)]


def plain(columns: NDArray[np.float64], torque: NDArray[np.float64], genes: NDArray[np.float64]) -> tuple[float, float]:
    """Equation 5 summed without rounding, and what one rounding of every product in it amounts to."""
    terms = np.abs(torque - np.sum(columns * genes, axis=1))
    size = np.abs(torque) + np.abs(columns) @ np.abs(genes)
    return math.fsum(terms) / len(terms), float(np.finfo(np.float64).eps) * math.fsum(size) / len(terms)


@settings(max_examples=20)
@given(kind=st.sampled_from(KINDS), n=st.integers(1, 600), p=st.integers(1, 5), seed=st.integers(0, 2**32 - 1))
def test_the_boxes_give_the_plain_sum_to_rounding(kind: str, n: int, p: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, torque = recording(kind, n, p, rng)
    bounds = bounds_from_data(columns, torque)
    tree, dense = grow(columns, torque, bounds), pack(columns, torque)
    for genes in places(bounds, least_absolute_deviations(columns, torque).genes, rng):
        wanted, rounding = plain(columns, torque, genes)
        assert abs(evaluate(tree, genes) - wanted) <= 1e-12 * wanted + 2.0 * rounding
        assert abs(evaluate(dense, genes) - wanted) <= 1e-12 * wanted + 2.0 * rounding


@pytest.mark.parametrize("p", [2, 3])
def test_a_long_recording_is_summed_as_exactly(made: Making, p: int) -> None:
    data = made([17.75e-3, 0.19e-3, 1e-3][:p], noise=2e-4, count=20_000, seed=p)
    bounds = bounds_from_data(data.columns, data.torque)
    tree = grow(data.columns, data.torque, bounds)
    for genes in places(bounds, data.truth, np.random.default_rng(0)):
        assert evaluate(tree, genes) == pytest.approx(plain(data.columns, data.torque, genes)[0], rel=1e-12)


def test_out_of_bounds_every_sample_is_looked_at(paper_like: Data) -> None:
    tree = grow(paper_like.columns, paper_like.torque, PAPER_BOUNDS)
    for genes in (np.array([-5.0, 3.0]), np.array([0.1, 2.0])):
        assert evaluate(tree, genes) == pytest.approx(plain(paper_like.columns, paper_like.torque, genes)[0], rel=1e-12)


def test_a_value_does_not_depend_on_what_was_asked_before(paper_like: Data) -> None:
    rng = np.random.default_rng(5)
    asked = places(PAPER_BOUNDS, paper_like.truth, rng)
    tree = grow(paper_like.columns, paper_like.torque, PAPER_BOUNDS)
    first = [evaluate(tree, genes) for genes in asked]
    assert [evaluate(tree, genes) for genes in asked] == first
    other = another(tree)
    assert [evaluate(other, genes) for genes in reversed(asked)] == first[::-1]


def test_a_tree_without_room_forgets_and_goes_on_with_the_same_values(paper_like: Data) -> None:
    rng = np.random.default_rng(6)
    asked = [genes for _ in range(20) for genes in places(PAPER_BOUNDS, paper_like.truth, rng)]
    roomy = grow(paper_like.columns, paper_like.torque, PAPER_BOUNDS)
    few_nodes = roomy._replace(nodes=another(roomy).nodes[:40].copy(), table=np.full(128, -1, np.int32))
    few_nodes = few_nodes._replace(used=few_nodes.used.copy(), recent=few_nodes.recent.copy())
    short = another(roomy)._replace(undecided=np.empty(2 * 2500, np.int32))
    few_leaves = another(roomy)._replace(leaves=np.empty((6, 3, 8)))
    wanted = [evaluate(roomy, genes) for genes in asked]
    assert roomy.used[0] > 40
    for cramped in (few_nodes, short, few_leaves):
        assert [evaluate(cramped, genes) for genes in asked] == wanted
        assert cramped.used[0] < roomy.used[0]


def test_near_the_optimum_a_long_recording_takes_no_more_looks_than_a_short_one(made: Making) -> None:
    def looks(count: int) -> int:
        data = made([17.75e-3, 0.19e-3], noise=2e-4, count=count, seed=0)
        tree = grow(data.columns, data.torque, PAPER_BOUNDS)
        evaluate(tree, data.truth)
        return int(tree.nodes[tree.recent.max(), 4])

    assert looks(2500) <= 16
    assert looks(200_000) <= 16


@settings(max_examples=15)
@given(kind=st.sampled_from(KINDS), n=st.integers(1, 300), p=st.integers(1, 4), seed=st.integers(0, 2**32 - 1))
def test_every_tangent_bounds_the_fitness_from_below(kind: str, n: int, p: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, torque = recording(kind, n, p, rng)
    bounds = bounds_from_data(columns, torque)
    tree, slope = grow(columns, torque, bounds), np.empty(p)
    asked = places(bounds, least_absolute_deviations(columns, torque).genes, rng)
    limit = 1.5 * evaluate(tree, asked[-1])
    sums = [plain(columns, torque, genes) for genes in asked]
    for at, (_, rounding_at) in zip(asked, sums, strict=True):
        height = tree_tangent(tree, at, limit, slope)
        assert height > limit or height == evaluate(tree, at)
        for genes, (wanted, rounding) in zip(asked, sums, strict=True):
            bound, extent = height + slope @ (genes - at), height + np.abs(slope) @ np.abs(genes - at)
            assert bound <= wanted + 1e-13 * extent + 4.0 * (rounding + rounding_at)


def test_the_engine_is_chosen_by_the_work_there_is(paper_like: Data) -> None:
    few = engine_for(paper_like.columns, paper_like.torque, PAPER_BOUNDS, 1000)
    many = engine_for(paper_like.columns, paper_like.torque, PAPER_BOUNDS, 2_000_000)
    long_but_few = engine_for(np.ones((100_000, 1)), np.ones(100_000), Bounds(np.zeros(1), np.ones(1)), 10_000)
    assert not isinstance(few, Tree)
    assert not isinstance(long_but_few, Tree)
    assert isinstance(many, Tree)
