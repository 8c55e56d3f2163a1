"""Columns of a file by heading, and the names of those that lie inside a matrix or a row."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice, product
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.exchange.nested import Names
from hil.recording.interval import seconds

Array = NDArray[np.float64]
Index = tuple[int | slice, ...]
Columns = Mapping[str, Callable[[], Any]]
"""For each heading a function that reads the column (n,): numbers, texts, or dates and times (datetime64, timedelta64).
"""

MOST = 256
"""The largest number of columns that are read of one matrix."""
_UNIT_KEYS = ("units", "unit", "Units", "Unit", "unit_string")
_EMPTY = (None, "")
_SECOND = np.timedelta64(1, "s")


def titled(name: str, metadata: Mapping[Any, Any] | None) -> str:
    """Return the heading of a column: its name, with the unit that its metadata state, such as "tau [N*m]"."""
    for key in _UNIT_KEYS:
        for own in (key, key.encode()):
            unit = (metadata or {}).get(own)
            text = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
            if isinstance(text, str) and text.strip():
                return f"{name} [{text.strip()}]"
    return name


def of_matrix(
    name: str, shape: tuple[int, ...], *, matlab: bool = False, beside: Names = MappingProxyType({})
) -> Iterator[tuple[str, Index]]:
    """Yield the name and the index of each column of an array: "q[:,2]", or in MATLAB's words "q(:,3)".

    beside: names in the file, which give "q.finger". The rows of the table are along the longest axis. A vector, also
    one that is stored as a matrix with one column, has the name of the array alone.
    """
    if not all(shape):
        return
    rows = shape.index(max(shape)) if shape else None
    places: list[Sequence[int | slice]] = [
        range(size) if axis != rows else [slice(None)] for axis, size in enumerate(shape)
    ]
    alone = math.prod(shape) == max(shape, default=1)
    for index in islice(product(*places), MOST):
        inner = [(axis, place) for axis, place in enumerate(index) if not isinstance(place, slice)]
        words = ",".join(":" if isinstance(place, slice) else str(place + matlab) for place in index)
        if len(inner) == 1 and (names := beside.get(shape[inner[0][0]])) and not alone:
            yield f"{name}.{names[inner[0][1]]}", index
        else:
            yield name if alone else f"{name}({words})" if matlab else f"{name}[{words}]", index


def at(values: Any, index: Index) -> Any:
    """Return the column (n,) of an array at an index that `of_matrix` yields."""
    return values[index].ravel()


def loaded(named: Mapping[str, Any]) -> Columns:
    """Return columns that are in memory already. named: by heading, (n,) each."""
    return {name: partial(np.asarray, values) for name, values in named.items()}


def numbers(values: Any) -> tuple[Array | None, bool]:
    """Return a column (n,) as numbers, dates and times in s, None if it holds anything else; and whether its texts are
    dates or times of day.
    """
    found = np.asarray(values)
    if found.dtype.kind == "M":
        found = found - np.datetime64(0, "s")
    if found.dtype.kind == "m":
        return np.asarray(found / _SECOND, dtype=np.float64), False
    if found.dtype.kind in "USO":
        return _of_texts(found)
    return (np.asarray(found, dtype=np.float64) if found.dtype.kind in "fiub" else None), False


def _of_texts(values: NDArray[Any]) -> tuple[Array | None, bool]:
    """Return the numbers that the texts (n,) state, dates and times in s; and whether they are dates or times."""
    texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in values.tolist()]
    first = next((one for one in texts if one not in _EMPTY), None)
    if not isinstance(first, str):
        return None, False
    is_stamp = seconds(first) is not None
    try:
        read = [math.nan if one in _EMPTY else seconds(one) if is_stamp else _number(one) for one in texts]
        return np.array(read, dtype=np.float64), is_stamp
    except (TypeError, ValueError):
        return None, False


def _number(text: str) -> float:
    if "_" in text:
        raise ValueError(text)
    return float(text)
