"""What every model of a coupling offers to the identification."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ga.model.separable import SeparableModel
from ga.model.trajectory import Motion

Array = NDArray[np.float64]


class Coupling(SeparableModel, Protocol):
    """A model of the coupling: `ga.model.coupling.CouplingModel`, or a user's own."""

    @property
    def name(self) -> str: ...  # noqa: D102
    def anchored(self, motion: Motion) -> Coupling: ...  # noqa: D102
    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]: ...  # noqa: D102
    def described(self, motion: Motion, delay: float = 0.0) -> NDArray[np.bool_]: ...  # noqa: D102
    def delay(self, nonlinear: Array | None) -> float: ...  # noqa: D102
    @property
    def sticks(self) -> bool: ...  # noqa: D102
