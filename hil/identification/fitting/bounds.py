"""Choose the bounds of a search: ranges given by the user, those of the paper, or those derived from the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ga.arrays import Array
from ga.bounds import PAPER_BOUNDS, Bounds, bounds_from_data
from ga.model.record import Parameter, positive_among
from ga.model.separable import SeparableModel
from hil.errors import WrongUse, meant

Given = Mapping[str, tuple[float, float]]
"""The user's bounds: the lowest and highest value of some parameters, SI, by name."""


def bounds_for(model: SeparableModel, given: Given, columns: Array, torque: Array, *, papers: bool) -> Bounds:
    """Return the bounds of the linear parameters: the given ranges, else the paper's if `papers` is true, else those
    from the data.

    No bound is below zero for a parameter that cannot be negative for physical reasons. Raises WrongUse for an
    unknown parameter, an empty range, or a negative range of a parameter that cannot be negative.
    """
    found = bounds_from_data(columns, torque, positive=positive_among(model.linear))
    low, high = found.low.copy(), found.high.copy()
    if papers:
        low[:2], high[:2] = PAPER_BOUNDS.low, PAPER_BOUNDS.high
    low, high = narrowed(low, high, given, model.linear, model.name)
    return Bounds(low, high, tuple(parameter.name for parameter in model.linear))


def narrowed(
    low: Array, high: Array, given: Given, parameters: Sequence[Parameter], model: str, *, zero: float = 0.0
) -> tuple[Array, Array]:
    """Return the bounds (p,), narrowed to the given ranges; parameters that are deflections count from `zero`, rad.

    Raises WrongUse for an unknown parameter, an empty range, or a negative range of a parameter that cannot be
    negative.
    """
    low, high, names = low.copy(), high.copy(), [parameter.name for parameter in parameters]
    for name, (lowest, highest) in given.items():
        if name not in names:
            near = meant(name, names)
            raise WrongUse(f"--bounds {name}: model {model!r} has no such parameter; {near}it has {', '.join(names)}")
        if not (np.isfinite(lowest) and np.isfinite(highest) and lowest < highest):
            raise WrongUse(f"--bounds {name}={lowest:g}:{highest:g}: write the lower one first, both as numbers in SI")
        at = names.index(name)
        if parameters[at].positive and highest <= 0.0:
            raise WrongUse(f"--bounds {name}={lowest:g}:{highest:g}: {name} is not negative; give a range above zero")
        shift = zero if parameters[at].place else 0.0
        low[at], high[at] = max(lowest, 0.0) if parameters[at].positive else lowest - shift, highest - shift
    return low, high
