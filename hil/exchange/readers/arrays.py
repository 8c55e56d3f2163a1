"""Read NumPy's files, .npz and .npy. Pickled objects in them are never loaded, because they can run any program."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from hil.errors import WrongUse
from hil.exchange.nested import names_of
from hil.exchange.readers.columns import Columns, at, of_matrix


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
    parts = {name: array for name, array in arrays.items() if array.dtype.names is None}
    parts |= {f"{name}.{field}": array[field] for name, array in arrays.items() for field in array.dtype.names or ()}
    beside = names_of(part.tolist() for part in parts.values() if part.dtype.kind == "U" and part.ndim == 1)
    return {
        column: partial(at, part, index)
        for name, part in parts.items()
        for column, index in of_matrix(name, part.shape, beside=beside)
    }
