"""The body of a text table without surprises, read by NumPy's parser: nothing but numbers, in every cell."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import StringIO
from itertools import islice, product

import numpy as np
from numpy.typing import NDArray

from hil.exchange.row_filter import RowFilter
from hil.exchange.text.cells import Cells, NotANumber
from hil.exchange.text.layout import Layout

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_FIRST = 1000  # rows that show whether a comma is the decimal mark


def numbers(
    form: Layout, block: Callable[[], str], wanted: Sequence[int], filters: Sequence[tuple[int, RowFilter]]
) -> tuple[Array, Rows] | None:
    """Return the columns `wanted`, (columns, n), and the line numbers (n,) of the rows that pass the filters.

    None if any line is not a row of numbers alone, so that it must be read cell by cell. block: returns the next whole
    lines from the first row on, "" at the end.
    """
    needed = list(dict.fromkeys([*wanted, *(at for at, _ in filters)]))
    is_text = any(isinstance(one.value, str) or one.written for _, one in filters)
    if any(form.monitor) or form.clocks & {*needed} or is_text:
        return None
    parts, places, above, mark = list[Array](), list[Rows](), form.above, ""
    while text := block():
        mark = mark or ("," if form.delimiter != "," and "," in text and _has_commas(text, form, needed) else ".")
        as_points = text.replace(",", ".") if mark == "," else text
        if (mark == "," and "." in text) or (read := _parsed(as_points, form)) is None:
            return None
        kept = np.ones(len(read), dtype=np.bool_)
        for at, one in filters:
            kept &= one.keeps(read[:, at])
        parts.append((read if kept.all() else read[kept])[:, list(wanted)].T)
        places.append(np.flatnonzero(kept) + above + 1)
        above += len(read)
    return (np.concatenate(parts, axis=1), np.concatenate(places)) if parts else None


def _has_commas(text: str, form: Layout, needed: Sequence[int]) -> bool:
    """Return whether a number in the columns that are needed can only have a decimal comma."""
    cells = Cells(form.names, frozenset())
    with suppress(NotANumber, IndexError, csv.Error):  # such a body is not plain
        for row, at in product(islice(form.reader(StringIO(text)), _FIRST), needed):
            cells.number(0, at, row[at])
    return cells.has_commas


def _parsed(text: str, form: Layout) -> Array | None:
    """Return the numbers (lines, columns) in the lines of a text, None unless each cell of each line is a number."""
    try:
        read = np.loadtxt(StringIO(text), delimiter=form.delimiter.strip(" ") or None, comments=None, ndmin=2)
    except ValueError:
        return None
    lines = text.count("\n") + (not text.endswith("\n"))
    return read if read.shape == (lines, len(form.names)) else None
