"""Choose the model that is fitted to a recording: a named one, a user's own, or the one that model selection finds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ga.arrays import Array, Mask
from ga.model.coupling import CouplingModel, parse
from ga.model.separable import Problem, SeparableModel, fit
from ga.model.terms import CONSIDERED, SMALLEST, TERMS, size_of
from ga.model.trajectory import Motion
from hil.errors import Untrustworthy, WrongUse
from hil.hysteresis_curve.slow_ramp import refuse_slow_ramp
from hil.identification.candidates import selection
from hil.identification.candidates.fits import LATE, with_flanks
from hil.identification.candidates.selection import Selection
from hil.identification.misfit.described import Described, tested
from hil.identification.result import Step
from hil.signals import constants as c
from hil.signals.plausibility import negative_stiffness
from hil.signals.prepare import Signals

_USUAL_FRICTION = "+".join(
    name
    for name, one in TERMS.items()
    if one.selection == "smallest" or (one.selection == "considered" and (one.sticks or one.delays))
)


@dataclass(frozen=True, slots=True)
class Choice:
    """The model, anchored to the data, with the steps of its selection (none if it was named).

    sticking: whether friction holds the joint in slow samples; the model does not describe these samples. delay: the
    age of the torque reading less that of the angle, s; the delay decides which samples are slow.
    """

    model: SeparableModel
    steps: tuple[Step, ...] = ()
    sticking: bool = False
    delay: float = 0.0

    def moving(self, motion: Motion) -> Mask:
        """Return in which samples (n,) friction does not hold the joint."""
        return self.model.described(motion, self.delay) if self.sticking else np.ones(len(motion), dtype=bool)

    def described(self, signals: Signals) -> Mask:
        """Return which samples (n,) the model describes: those in which the joint moves, at a known rate."""
        return self.moving(signals.motion) & signals.rate_known


def choose(model: SeparableModel | None, signals: Signals, *, linear_only: bool) -> Choice:
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


def _named(model: SeparableModel, signals: Signals) -> Choice:
    choice = Choice(model.anchored(signals.motion))
    problem = Problem(choice.model, signals.motion, signals.torque, *model.bounds(signals.motion, signals.band[1]))
    if isinstance(choice.model, CouplingModel) and choice.model.chooses_edge:
        choice = replace(choice, model=with_flanks(choice.model, fit(problem.of(signals.rate_known))))
        problem = replace(problem, model=choice.model)
    if not model.sticks:
        return choice
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
    """Return the selected model. If friction seems to hold the joint in some samples that the model does not
    describe, another selection is made without these samples.

    If torque or angle has the wrong sign, no model is right, and the smallest model is enough to show the wrong sign.
    """
    if negative_stiffness(signals.motion, signals.torque) is not None:
        return _named(parse(SMALLEST), signals)
    terms = tuple(name for name, one in TERMS.items() if one.selection != "named" and name not in SMALLEST.split("+"))
    if linear_only:
        terms = tuple(term for term in terms if TERMS[term].linear and term in CONSIDERED)
    if not signals.motion.repeats:
        terms = tuple(term for term in terms if not TERMS[term].repeats)
    if signals.torque_from == "motor":
        terms = tuple(term for term in terms if term not in LATE or TERMS[term].delays)
    recorded, signals = signals, _glimpses(signals)
    seen, friction = signals.rate_known, _named(parse(_USUAL_FRICTION), signals)
    moving = friction.described(signals)
    found, sticking = _plainest(signals, seen, terms), False
    # a model with smooth friction, or without friction, may describe the slow samples too
    if friction.sticking and not _describes_slow(found, friction, signals, seen):
        without = _plainest(signals, moving, terms)
        found, sticking = (without, True) if without.model.sticks else (found, False)
    model = found.model.anchored(recorded.motion)
    return Choice(model, found.steps, sticking, found.delay)


def _plainest(signals: Signals, seen: Mask, terms: tuple[str, ...]) -> Selection:
    """Return the model of common terms if it describes the samples in `seen` (n,); otherwise the model of all terms.

    Rare terms fit a part of what every sensor and every rate gets wrong, and take their share of Kc and Bc.
    """
    of_motor = {"motor torque"} if signals.torque_from == "motor" else set()
    common = tuple(term for term in terms if TERMS[term].selection in {"considered", *of_motor})
    found = selection.select(signals, seen, common)
    return found if common == terms or _describes(found, signals, seen) else selection.select(signals, seen, terms)


def _describes(found: Selection, signals: Signals, seen: Mask) -> bool:
    """Return whether a model passes the lack-of-fit tests, however small its misfit.

    Noise of the deflection is not treated as a missing term: rare terms would be selected to explain it.
    """
    values = found.chosen.fit.values
    fit = tested(
        Described(
            model=found.model,
            signals=signals,
            kept=seen,
            residuals=found.chosen.residuals,
            columns=found.chosen.columns,
            values=values,
            half_width=np.zeros(len(values)),
            averaged=True,
        )
    )
    noisy = fit is not None and fit.suspects and fit.suspects[0].effect.in_deflection
    return fit is None or not fit.misfit or bool(noisy)


def _glimpses(signals: Signals) -> Signals:
    """Return parts of long signals, spread evenly over them: enough to tell models apart."""
    whole, places = signals.motion.whole
    if len(whole) <= c.SELECTED_FROM:
        return signals
    firsts = np.linspace(0, len(whole) - c.SELECTED_FROM // c.STRETCHES, c.STRETCHES).astype(np.int64)
    rows = (firsts[:, None] + np.arange(c.SELECTED_FROM // c.STRETCHES)).ravel()
    own = np.arange(len(whole))[places]
    kept = np.isin(own, rows)
    motion = whole.alone(rows, range(0, len(rows), c.SELECTED_FROM // c.STRETCHES))
    if len(signals.motion) < len(whole):
        motion = motion.of(np.searchsorted(rows, own[kept]))
    cut = replace(signals, motion=motion, torque=signals.torque[kept])
    jerked = None if signals.jerked is None else signals.jerked[kept]
    return replace(cut, jerked=jerked, command=None, unfiltered=None)


def _describes_slow(whole: Selection, friction: Choice, signals: Signals, seen: Mask) -> bool:
    """Return whether a model fits the slow samples, in which friction seems to hold the joint, as well as others."""
    motion = signals.motion if seen.all() else signals.motion.of(seen)
    slow = ~friction.moving(signals.motion)[seen]
    values = whole.chosen.values
    loaded = size_of(values, "load share") * float(np.mean(np.abs(signals.torque)))
    little = c.SMALL_PART * (size_of(values, "dry friction") + loaded)
    return not whole.model.sticks and not _are_worse(slow, motion, whole.chosen.residuals, little)


def _is_sticking(model: SeparableModel, motion: Motion, delay: float, residuals: Array) -> bool:
    """Return whether the model fits the samples in which friction may hold the joint worse than the others.

    All such samples are compared, and also those of each decade of the rate: during a long rest nothing moves, and the
    many samples of the rest may fit well while those at its beginning do not.
    """
    return _are_worse(~model.described(motion, delay), motion, residuals)


def _are_worse(slow: Mask, motion: Motion, residuals: Array, little: float = 0.0) -> bool:
    """Return whether the slow samples (n,) of a motion fit worse than the others, either all slow samples or those of
    one decade of the rate.

    little: an error, N m, that is small enough to be ignored.
    """
    described = ~slow
    if described.all() or np.count_nonzero(described) < c.FEWEST:  # too few to fit a model to
        return False
    left, rate = np.abs(residuals), np.abs(motion.dtheta_dot)
    decade = np.floor(np.log10(np.maximum(rate, c.ROUNDED * max(float(rate.max()), np.finfo(float).tiny))))
    held = [left[~described & (decade == one)] for one in np.unique(decade[~described]).tolist()]
    worst = max([left[~described], *(some for some in held if len(some) >= c.KNOWN_MEAN)], key=np.mean)
    return bool(worst.mean() > max(c.STICKING * left[described].mean(), little))
