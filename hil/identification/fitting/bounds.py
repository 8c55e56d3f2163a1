"""The bounds of a search: the ranges that were given, the paper's or those from the data."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ga.bounds import PAPER_BOUNDS, Bounds, bounds_from_data
from hil.errors import WrongUse, meant
from hil.identification.model_choice import Coupling

Array = NDArray[np.float64]
Given = Mapping[str, tuple[float, float]]
"""The lowest and highest value of some parameters, SI, by name."""


def bounds_for(model: Coupling, given: Given, columns: Array, torque: Array, *, papers: bool) -> Bounds:
    """Return the bounds of the linear parameters: the given ranges, else the paper's if asked for, else the data's.

    Raises WrongUse as `narrowed`.
    """
    found = bounds_from_data(columns, torque)
    low, high = found.low.copy(), found.high.copy()
    if papers:
        low[:2], high[:2] = PAPER_BOUNDS.low, PAPER_BOUNDS.high
    names = tuple(parameter.name for parameter in model.linear)
    return Bounds(*narrowed(low, high, given, names, model.name), names)


def narrowed(low: Array, high: Array, given: Given, names: tuple[str, ...], model: str) -> tuple[Array, Array]:
    """Return the bounds (p,) with the given ranges. Raises WrongUse for an unknown parameter or an empty range."""
    low, high = low.copy(), high.copy()
    for name, (lowest, highest) in given.items():
        if name not in names:
            near = meant(name, names)
            raise WrongUse(f"--bounds {name}: model {model!r} has no such parameter; {near}it has {', '.join(names)}")
        if not (np.isfinite(lowest) and np.isfinite(highest) and lowest < highest):
            raise WrongUse(f"--bounds {name}={lowest:g}:{highest:g}: write the lower one first, both as numbers in SI")
        low[names.index(name)], high[names.index(name)] = lowest, highest
    return low, high
