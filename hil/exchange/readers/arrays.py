"""Read NumPy's files, .npz and .npy. Pickled objects in them are never loaded, because they can run any program."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import WrongUse
from hil.exchange.nested import names_of
from hil.exchange.readers.columns import Columns, of_matrix


def read(source: Path) -> Columns:
    """Return the columns by array: "tau", "data[:,2]", "log.tau" of a structured array. A .npy file is called "data".

    Raises WrongUse for an array of Python's objects.
    """
    try:
        loaded = np.load(source, allow_pickle=False)
        arrays = {"data": loaded} if isinstance(loaded, np.ndarray) else {name: loaded[name] for name in loaded.files}
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise WrongUse(
            f"{source} holds Python's objects, whose loading can run any program: save arrays of numbers, one for each "
            "column: numpy.savez('log.npz', t=..., tau=...)"
        ) from None
    parts = {
        name if field is None else f"{name}.{field}": array if field is None else array[field]
        for name, array in arrays.items()
        for field in array.dtype.names or [None]
    }
    beside = names_of(part.tolist() for part in parts.values() if part.dtype.kind == "U" and part.ndim == 1)
    return {
        column: partial(_column, part, index)
        for name, part in parts.items()
        for column, index in of_matrix(name, part, beside=beside)
    }


def _column(values: Any, index: tuple[int | slice, ...]) -> Any:
    return values[index].ravel()
