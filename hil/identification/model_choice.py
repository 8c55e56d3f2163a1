"""The model a recording is fitted with: one that was named, a user's own, or the one the ladder chooses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ga.model.separable import Curved, Problem, fit
from ga.model.trajectory import Motion
from hil.errors import Untrustworthy, WrongUse
from hil.identification import stepwise
from hil.identification.stepwise import Rung
from hil.signals.prepare import Signals

Array = NDArray[np.float64]

_HELD = 1.25  # times the error of the other samples, from which on the slow ones are not described by the model


class Coupling(Curved, Protocol):
    """A model of the coupling: of the ladder (`ga.model.terms.Model`), or a user's own."""

    @property
    def name(self) -> str: ...  # noqa: D102
    def anchored(self, motion: Motion) -> Coupling: ...  # noqa: D102
    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]: ...  # noqa: D102
    def told(self, motion: Motion, skew: float = 0.0) -> NDArray[np.bool_]: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Choice:
    """model: anchored to the data. rungs: the ladder it was chosen from, none where it was named.

    held: whether friction holds the joint where it is slow, so that the model says nothing there. skew: s, how much
    older the torque reading is, which tells where it is slow.
    """

    model: Coupling
    rungs: tuple[Rung, ...] = ()
    held: bool = False
    skew: float = 0.0

    def told(self, motion: Motion) -> NDArray[np.bool_]:
        """The samples (n,) that the model says something about."""
        return self.model.told(motion, self.skew) if self.held else np.ones(len(motion), dtype=bool)


def choose(model: Coupling | None, signals: Signals, *, straight: bool) -> Choice:
    """The model for the signals; None: the ladder's choice.

    straight: only models that are linear in their parameters, as a search of the `paper` preset or of a recording
    that does not fit in memory asks for. Raises WrongUse for another, Untrustworthy where no model can be fitted.
    """
    if model is not None and straight and model.shape:
        raise WrongUse(
            f"model {model.name!r} has {', '.join(p.name for p in model.shape)}, which the preset paper does not "
            "search for, nor anything in recordings that do not fit in memory: leave the term out of --model"
        )
    try:
        return _named(model, signals) if model is not None else _climbed(signals, straight=straight)
    except RuntimeError as error:
        raise Untrustworthy(f"no model can be fitted ({error}): look at it with hil inspect") from error


def _named(model: Coupling, signals: Signals) -> Choice:
    choice = Choice(model.anchored(signals.motion))
    if "Fc" not in {parameter.name for parameter in model.linear}:
        return choice
    problem = Problem(choice.model, signals.motion, signals.torque, *model.bounds(signals.motion, signals.band[1]))
    # which samples friction holds depends on the skew, and the skew on the samples: the second time it is close enough
    for _ in range(2):
        found = fit(problem.of(choice.told(problem.motion)))
        skew = stepwise.skew_of(choice.model, found)
        held = choice.held or _is_held(choice.model, problem.motion, skew, problem.residuals(found))
        choice = replace(choice, held=held, skew=skew)
        if not held:
            break
    return choice


def _climbed(signals: Signals, *, straight: bool) -> Choice:
    """The ladder's choice; where friction holds the joint, climbed again without the samples it does so in."""
    terms = stepwise.TERMS + (("inertia",) if signals.torque_from == "motor" else ())
    if straight:
        terms = tuple(term for term in terms if term not in stepwise.SHAPING)
    motion, highest = signals.motion, signals.band[1]
    climbed = stepwise.climb(motion, signals.torque, highest, terms)
    held = _is_held(climbed.model, motion, climbed.skew, climbed.residuals)
    if held:
        told = climbed.model.told(motion, climbed.skew)
        again = stepwise.climb(motion.of(told), signals.torque[told], highest, terms)
        climbed = again if "coulomb" in again.model.terms else climbed
    return Choice(climbed.model.anchored(motion), climbed.rungs, held, climbed.skew)


def _is_held(model: Coupling, motion: Motion, skew: float, residuals: Array) -> bool:
    """Whether the samples that friction may hold the joint in fit worse than the others."""
    told = model.told(motion, skew)
    if told.all() or not told.any():
        return False
    left = np.abs(residuals)
    return bool(left[~told].mean() > _HELD * left[told].mean())
