"""Groups of rows: each row is in one of them, and its residual is where the group says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ga.bounds import PAPER_BOUNDS, bounds_from_data
from ga.fitness.cells import COUNT, INNER, KIND, ROWS, START, Tree, grow
from ga.fitness.engine import evaluate
from ga.fitness.row_groups import END_ROW, FAN, FIRST_PART, FIRST_ROW, PARTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.ga.conftest import Making


def rows_of(tree: Tree, item: int) -> range:
    group = item - len(tree.rows)
    return range(item, item + 1) if group < 0 else range(*tree.contents[group, [FIRST_ROW, END_ROW]].tolist())


@pytest.mark.study
@settings(max_examples=15)
@given(n=st.integers(1, 2000), p=st.integers(1, 4), seed=st.integers(0, 2**32 - 1))
def test_a_group_holds_its_parts_and_bounds_the_residuals_of_its_rows(n: int, p: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, torque = rng.normal(size=(n, p)), rng.normal(size=n)
    tree = grow(columns, torque, bounds_from_data(columns, torque))
    assert sorted(tree.rows[:, 1].tolist()) == sorted(columns[:, 0].tolist())
    assert list(rows_of(tree, n + len(tree.contents) - 1)) == list(range(n))
    place = rng.normal(size=p)
    residuals, along = tree.rows[:, 0] - tree.rows[:, 1:-1] @ place, np.abs(tree.forward @ place)
    for group, value in enumerate(tree.groups):
        own = np.array(rows_of(tree, n + group))
        first, parts = tree.contents[group, [FIRST_PART, PARTS]].tolist()
        assert parts <= FAN
        assert [row for part in range(first, first + parts) for row in rows_of(tree, part)] == own.tolist()
        np.testing.assert_allclose(value[: p + 1], tree.rows[own, :-1].sum(axis=0), atol=1e-9)
        furthest = np.abs(residuals[own] - residuals[own].mean()).max()
        assert furthest <= (value[p + 1] + value[p + 2 : -2] @ along) * (1.0 + 1e-9) + 1e-12
        assert (value[-2], value[-1]) == (tree.rows[own, -1].min(), tree.rows[own, -1].max())


def test_a_cell_of_a_long_recording_lists_groups_in_place_of_their_rows(made: Making) -> None:
    def listed(count: int) -> NDArray[np.int64]:
        data = made([17.75e-3, 0.19e-3], noise=2e-4, count=count, seed=0)
        tree = grow(data.columns, data.torque, PAPER_BOUNDS)
        evaluate(tree, data.truth)
        cells = tree.nodes[1 : tree.used[0]]
        return np.asarray(cells[(cells[:, KIND] == INNER) & (cells[:, START] >= 0)])

    short, long = listed(2500), listed(200_000)
    assert long[:, ROWS].max() > 30 * short[:, ROWS].max()
    assert long[:, COUNT].max() < 15 * short[:, COUNT].max()
