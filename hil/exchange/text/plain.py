"""Blocks of a text table without surprises, read by NumPy's parser: nothing but numbers, in every cell."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from contextlib import suppress
from io import StringIO
from itertools import islice, product

import numpy as np
from numpy.typing import NDArray

from hil.exchange.row_filter import RowFilter
from hil.exchange.text.cells import Cells, NotANumber
from hil.exchange.text.layout import Layout

Array = NDArray[np.float64]

_FIRST = 1000  # rows that show whether a comma is the decimal mark


def is_possible(form: Layout, needed: Sequence[int], filters: Sequence[tuple[int, RowFilter]]) -> bool:
    """Return whether the columns that are needed (indices) may hold numbers alone."""
    is_text = any(isinstance(one.value, str) or one.written for _, one in filters)
    return not (any(form.monitor) or form.clocks & {*needed} or is_text)


def has_commas(text: str, form: Layout, needed: Sequence[int]) -> bool:
    """Return whether a number in the columns that are needed can only have a decimal comma."""
    if form.delimiter == "," or "," not in text:
        return False
    cells = Cells(form.names, frozenset())
    with suppress(NotANumber, IndexError, csv.Error):  # such a block is not plain
        for row, at in product(islice(form.reader(StringIO(text)), _FIRST), needed):
            cells.number(0, at, row[at])
    return cells.has_commas


def numbers(text: str, form: Layout, mark: str) -> Array | None:
    """Return the numbers (lines, columns) in the lines of a text; None unless each cell of each line is a number, in
    quotation marks or not, or empty. mark: the decimal mark.
    """
    if mark == ",":
        if "." in text or form.delimiter == ",":
            return None
        text = text.replace(",", ".")
    fields, ended = len(form.names), form.delimiter + "\n"
    if form.delimiter != " " and ended in text.replace("\r\n", "\n")[: text.find("\n") + 1]:  # some end each row so
        text, fields = text.replace("\r\n", "\n").replace(ended, "\n"), fields - (not form.names[-1])
    read = _parsed(text, form.delimiter)
    if read is None and form.delimiter != " ":
        read = _parsed(_filled(text, re.escape(form.delimiter)), form.delimiter)
    lines = text.count("\n") + (not text.endswith("\n"))
    if read is None or read.shape != (lines, fields):
        return None
    return read if fields == len(form.names) else np.column_stack([read, np.full(lines, np.nan)])


def _filled(text: str, between: str) -> str:
    """Return the lines with NaN in empty cells, and without the quotation marks around a cell."""
    bare = re.sub(rf'(?<![^\n{between}])"([^"\n{between}]*)"(?=[\r\n{between}])', r"\1", text) if '"' in text else text
    return re.sub(rf"(?<=[\n{between}])(?={between})|(?<={between})(?=\r?\n|\Z)|\A(?={between})", "nan", bare)


def _parsed(text: str, delimiter: str) -> Array | None:
    try:
        return np.loadtxt(StringIO(text), delimiter=delimiter.strip(" ") or None, comments=None, ndmin=2)
    except ValueError:
        return None
