"""What makes an interval wide: the contributions by source, and how they combine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ga.arrays import Array

Source = Literal[
    "noise",
    "choice of the model",
    "differences between recordings",
    "errors of the deflection",
    "errors of the rate",
    "range of Kc",
]


@dataclass(frozen=True, eq=False, slots=True)
class Width:
    """One contribution to the 95 % intervals of all parameters.

    half (p,): half its width, SI. is_range: whether the parameter has all values within it, and not one unknown value.
    """

    source: Source
    half: Array
    is_range: bool = False


def combined(widths: Sequence[Width]) -> Array:
    """Return the half widths (p,) of the whole intervals: independent errors combine as the root of the sum of their
    squares, and ranges are added.
    """
    squares = np.sum([one.half**2 for one in widths if not one.is_range], axis=0)
    return np.asarray(np.sqrt(squares) + sum(one.half for one in widths if one.is_range))


def beyond(wide: Array, narrow: Array) -> Array:
    """Return the half width (p,) that combines with `narrow` to `wide`; zero where `wide` is not the wider one."""
    known = np.isfinite(wide)
    squares = np.subtract(wide**2, narrow**2, out=np.zeros_like(wide), where=known)
    return np.sqrt(np.maximum(squares, 0.0))
