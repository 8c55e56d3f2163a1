"""The model a recording is fitted with: one that was named, a user's own, or the one the ladder chooses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ga.curved import Curved
from ga.motion import Motion
from hil import ladder
from hil.errors import Untrustworthy, WrongUse
from hil.ladder import Rung
from hil.signals import Signals

Array = NDArray[np.float64]


class Coupling(Curved, Protocol):
    """A model of the coupling: of the ladder (`ga.models.Model`), or a user's own."""

    @property
    def name(self) -> str: ...  # noqa: D102
    def anchored(self, motion: Motion) -> Coupling: ...  # noqa: D102
    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Choice:
    """model: anchored to the data. rungs: the ladder it was chosen from, none where it was named."""

    model: Coupling
    rungs: tuple[Rung, ...] = ()


def choose(model: Coupling | None, signals: Signals, *, straight: bool) -> Choice:
    """The model for the signals; None: the ladder's choice.

    straight: only models that are linear in their parameters, as a search of the `paper` preset or of a recording
    that does not fit in memory asks for. Raises WrongUse for another, Untrustworthy where no model can be fitted.
    """
    if model is not None:
        if straight and model.shape:
            raise WrongUse(
                f"model {model.name!r} has {', '.join(p.name for p in model.shape)}, which the preset paper does not "
                "search for, nor anything in recordings that do not fit in memory: leave the term out of --model"
            )
        return Choice(model.anchored(signals.motion))
    terms = ladder.TERMS + (("inertia",) if signals.torque_from == "motor" else ())
    if straight:
        terms = tuple(term for term in terms if term not in ladder.SHAPING)
    try:
        climbed = ladder.climb(signals.motion, signals.torque, signals.band[1], terms)
    except RuntimeError as error:
        raise Untrustworthy(f"no model can be fitted ({error}): look at it with hil inspect") from error
    return Choice(climbed.model, climbed.rungs)
