"""Choose the model that is fitted to a recording: a named one, a user's own, or the one that model selection finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import parse
from ga.model.effects.friction import SMOOTH
from ga.model.separable import Problem, fit
from ga.model.terms import CONSIDERED, OF_MOTOR, RARER, SMALLEST, TERMS, size_of, with_another
from ga.model.trajectory import Motion
from hil.errors import Untrustworthy, WrongUse
from hil.hysteresis_curve.slow_ramp import refuse_slow_ramp
from hil.identification.candidates import stepwise
from hil.identification.candidates.described import Described, tested
from hil.identification.candidates.fits import LATE, Fits
from hil.identification.candidates.late import EARLIER, Alternative, Lateness
from hil.identification.candidates.stepwise import Selection
from hil.identification.coupling import Coupling
from hil.identification.result import Step
from hil.signals.constants import FEWEST
from hil.signals.plausibility import negative_stiffness
from hil.signals.prepare import Signals

Array = NDArray[np.float64]

_STICKING = 1.25  # times the error of the other samples, from which the model does not describe the slow ones
_OF_FRICTION = 0.02  # that turns smoothly, up to which errors of the rate may move it where it turns
_KNOWN, _NONE = 100, 1e-9  # samples whose error is known well, and the part of the fastest rate that is no motion


@dataclass(frozen=True, slots=True)
class Choice:
    """The model, anchored to the data, with the steps of its selection (none if it was named) and the alternatives.

    sticking: whether friction holds the joint in slow samples; the model does not describe these samples. delay: the
    age of the torque reading less that of the angle, s; the delay decides which samples are slow.
    """

    model: Coupling
    steps: tuple[Step, ...] = ()
    sticking: bool = False
    delay: float = 0.0
    alternatives: tuple[Alternative, ...] = ()
    lateness: tuple[Lateness, ...] = ()

    def moving(self, motion: Motion) -> NDArray[np.bool_]:
        """Return in which samples (n,) friction does not hold the joint."""
        return self.model.described(motion, self.delay) if self.sticking else np.ones(len(motion), dtype=bool)

    def described(self, signals: Signals) -> NDArray[np.bool_]:
        """Return which samples (n,) the model describes: those in which the joint moves, at a known rate."""
        return self.moving(signals.motion) & signals.rate_known


def choose(model: Coupling | None, signals: Signals, *, linear_only: bool) -> Choice:
    """Return the model for the signals. model: the model that the user named; None for model selection.

    linear_only: allow only models that are linear in their parameters, as the `paper` preset and recordings that do not
    fit in memory need. Raises WrongUse for a model that is not allowed, Untrustworthy if no model can be fitted, or if
    one is to be selected for a slow ramp that none explains.
    """
    if model is not None and linear_only and model.nonlinear:
        raise WrongUse(
            f"model {model.name!r} has nonlinear parameters ({', '.join(p.name for p in model.nonlinear)}). --preset "
            "paper does not search for them, and they need recordings that fit in memory. Leave the term out of --model"
        )
    try:
        if model is not None:
            return _named(model, signals)
        refuse_slow_ramp(signals)
        return _selected(signals, linear_only=linear_only)
    except RuntimeError as error:
        raise Untrustworthy(f"no model can be fitted ({error}): look at it with hil inspect") from error


def _named(model: Coupling, signals: Signals) -> Choice:
    choice = Choice(model.anchored(signals.motion))
    if not model.sticks:
        return choice
    problem = Problem(choice.model, signals.motion, signals.torque, *model.bounds(signals.motion, signals.band[1]))
    # which samples friction holds depends on the delay, and the delay on the samples: twice is close enough
    for _ in range(2):
        found = fit(problem.of(choice.described(signals)))
        delay = choice.model.delay(found.nonlinear)
        sticking = choice.sticking or _is_sticking(choice.model, problem.motion, delay, problem.residuals(found))
        choice = replace(choice, sticking=sticking, delay=delay)
        if not sticking:
            break
    return choice


def _selected(signals: Signals, *, linear_only: bool) -> Choice:
    """Return the selected model. If friction holds the joint in some samples, the selection is repeated without them.

    If torque or angle has the wrong sign, no model is right, and the smallest model is enough to show the wrong sign.
    """
    if negative_stiffness(signals.motion, signals.torque) is not None:
        return _named(parse(SMALLEST), signals)
    terms = (*CONSIDERED, *(OF_MOTOR if signals.torque_from == "motor" else ()))
    if linear_only:
        terms = tuple(term for term in terms if TERMS[term].linear)
    # in one triangle friction that builds up looks like a drift; Kc and Bc are averages with and without one anyway.
    # Friction that grows with the load looks like a curve there, but beside a gap it is seen
    once = set() if signals.motion.repeats else {name for name, term in TERMS.items() if term.repeats}
    terms = tuple(term for term in terms if term not in once)
    # an inertia hides behind a skew, but where neither is enough it may be there, whoever read the torque
    rarer = () if linear_only else (*RARER, *OF_MOTOR)
    # a motor's torque comes through no cell: what it is late by is the time to its next set-point
    absent = {name for name in LATE if not TERMS[name].delays} if signals.torque_from == "motor" else set()
    rarer = tuple(term for term in rarer if term not in terms and term not in absent | once)
    # nobody says that a given torque is the joint's and not the motor's
    late = EARLIER if signals.torque_from == "given" else LATE
    accounts = tuple(term for term in late if term in (*terms, *rarer))
    considered = _Considered(terms, rarer, accounts)
    seen = signals.rate_known
    motion = _seen(signals.motion, seen)
    found = _select(signals, seen, considered, sticks=lambda usual: not _moving(usual, motion).all())
    moving = seen.copy()
    moving[seen] = _moving(found, motion)
    sticking = not np.array_equal(moving, seen)
    if sticking:
        again = _select(signals, moving, considered)
        found = again if again.model.sticks else _select(signals, seen, considered)
        smooth = _turning_smoothly(again, signals, seen, considered) if again.model.sticks else None
        found, sticking = (smooth, False) if smooth else (found, sticking)
    model = found.model.anchored(signals.motion)
    return Choice(model, found.steps, sticking, found.delay, found.alternatives, found.lateness)


def _turning_smoothly(
    sticking: Selection, signals: Signals, seen: NDArray[np.bool_], considered: _Considered
) -> Selection | None:
    """Return the model with smoothly reversing friction, if it describes the samples in which friction seemed to hold
    the joint.

    The selection needs these samples: without them such friction is hardly distinguishable from friction that reverses
    at once.
    """
    if SMOOTH.name not in considered.rarer:
        return None
    motion = _seen(signals.motion, seen)
    turning = ~sticking.model.described(motion, sticking.delay)
    alike = Fits(motion, signals.torque[seen], signals.band[1], signals.window)
    terms = with_another(sticking.chosen.terms, SMOOTH.name)
    if not alike.fitness(terms) < np.inf:
        return None
    first = alike.candidate(terms)
    loaded = size_of(first.values, "load share") * float(np.mean(np.abs(signals.torque)))
    little = _OF_FRICTION * (size_of(first.values, "dry friction") + loaded)
    if _are_worse(turning, motion, first.problem.residuals(first.fit), little):
        return None
    found = _select(signals, seen, considered.with_usual(SMOOTH.name))
    described = SMOOTH.name in found.model.name.split("+") and not _are_worse(turning, motion, found.residuals, little)
    return found if described and _describes(found, signals, seen, averaged=True) else None


@dataclass(frozen=True, slots=True)
class _Considered:
    """The terms that model selection may include.

    rarer: terms that are considered only if the others do not describe the recording. accounts: the terms that can
    explain a delay of the torque reading, such as a skew.
    """

    terms: tuple[str, ...]
    rarer: tuple[str, ...]
    accounts: tuple[str, ...]

    def with_usual(self, term: str) -> _Considered:
        """Return the terms to consider, with one rare term added to the common ones."""
        return replace(self, terms=(*self.terms, term), rarer=tuple(one for one in self.rarer if one != term))


def _select(
    signals: Signals,
    seen: NDArray[np.bool_],
    considered: _Considered,
    sticks: Callable[[Selection], bool] = lambda _selection: False,
) -> Selection:
    """Return the model selected from the samples in `seen` (n,). sticks: see `stepwise.select`."""
    return stepwise.select(
        _seen(signals.motion, seen),
        signals.torque[seen],
        signals.band[1],
        considered.terms,
        rarer=considered.rarer,
        accounts=considered.accounts,
        describes=lambda found, averaged: _describes(found, signals, seen, averaged=averaged),
        sticks=sticks,
        window=signals.window,
    )


def _moving(found: Selection, motion: Motion) -> NDArray[np.bool_]:
    """Return the samples (n,) in which friction does not hold the joint; all samples if the model fits them all equally
    well.
    """
    if _is_sticking(found.model, motion, found.delay, found.residuals):
        return found.model.described(motion, found.delay)
    return np.ones(len(motion), dtype=bool)


def _seen(motion: Motion, rows: NDArray[np.bool_]) -> Motion:
    return motion if rows.all() else motion.of(rows)


def _describes(found: Selection, signals: Signals, seen: NDArray[np.bool_], *, averaged: bool) -> bool:
    """Return whether the model selected from the samples in `seen` (n,) passes the lack-of-fit tests, however small its
    misfit.

    averaged: whether the model may lack the small effects that every bench has, and whether tests that decide nothing
    are enough. Noise of the deflection is not treated as a missing term: rare terms would be selected to explain it.
    """
    fitted = _moving(found, _seen(signals.motion, seen))
    kept = seen.copy()
    kept[seen] = fitted
    fit = tested(
        Described(
            model=found.model,
            signals=signals,
            kept=kept,
            residuals=found.residuals[fitted],
            columns=found.columns[fitted],
            values=found.values,
            half_width=np.zeros(len(found.values)),
            averaged=averaged,
        )
    )
    if fit is not None and fit.is_undecided and not averaged:
        return False
    noisy = fit is not None and fit.suspects and fit.suspects[0].effect.in_deflection
    return fit is None or not fit.misfit or bool(noisy)


def _is_sticking(model: Coupling, motion: Motion, delay: float, residuals: Array) -> bool:
    """Return whether the model fits the samples in which friction may hold the joint worse than the others.

    All such samples are compared, and also those of each decade of the rate: during a long rest nothing moves, and the
    many samples of the rest may fit well while those at its beginning do not.
    """
    return _are_worse(~model.described(motion, delay), motion, residuals)


def _are_worse(slow: NDArray[np.bool_], motion: Motion, residuals: Array, little: float = 0.0) -> bool:
    """Return whether the slow samples (n,) of a motion fit worse than the others, either all slow samples or those of
    one decade of the rate.

    little: an error, N m, that is small enough to be ignored.
    """
    described = ~slow
    if described.all() or np.count_nonzero(described) < FEWEST:  # too few to fit a model to
        return False
    left, rate = np.abs(residuals), np.abs(motion.dtheta_dot)
    decade = np.floor(np.log10(np.maximum(rate, _NONE * max(float(rate.max()), np.finfo(float).tiny))))
    held = [left[~described & (decade == one)] for one in np.unique(decade[~described]).tolist()]
    worst = max([left[~described], *(some for some in held if len(some) >= _KNOWN)], key=np.mean)
    return bool(worst.mean() > max(_STICKING * left[described].mean(), little))
