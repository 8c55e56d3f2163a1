"""Find the cause of a delayed torque reading: a skew, a lag of the cell, an inertia, or a branch that relaxes fast."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import CouplingModel
from ga.model.effects.springs import SHORTEST_RELAXATION
from ga.model.terms import is_addable, of_kind, of_role, size_of
from ga.model.trajectory import FORGOTTEN
from hil.identification.candidates.criterion import Criterion
from hil.identification.candidates.fits import LATE, Candidate, Fits, own
from hil.identification.candidates.held import damping_at, taken_off
from hil.signals import constants as c
from hil.uncertainty.model_average import AKAIKE

Array = NDArray[np.float64]

EARLIER: Final = (*LATE, *of_role("mass"))
"""The terms that can delay the torque reading, or make it seem early."""

_SKEW, _LAG = LATE
_FILTERS: Final = frozenset(of_role("channel")) - {_SKEW}
_OTHER_FILTERS: Final = _FILTERS - {_LAG}
_STIFFEST, _HIDDEN = 2.0, 0.002  # times Kc, what relaxes at most; part of Bc that a late reading hides, which matters
_BRANCHES = of_role("branch")  # each needs those before it
_CONSTANTS = 12  # of a branch, two an octave
_DELAYS, _LAGS = 3, 11  # every half tick of each sign, and every half octave
_NARROW = 4.0  # twice the fall of the logarithmic likelihood at a skew, from which a parabola may end before it
_UNLIKELY = 30.0  # twice the logarithm of the odds against a time, from which longer ones weigh nothing
_RARE = 2.0 * math.log(10.0)  # in Akaike's criterion: one joint in ten relaxes faster than it moves, or is read late
_APART = 2.0 * math.log(3.0)  # the same of a motor's torque, which another device reads than the joint's angle


@dataclass(frozen=True, slots=True)
class Alternative:
    """A model that may replace the selected one.

    nonlinear (q,): its nonlinear parameters, SI. criterion: its Akaike criterion less that of the selected model.
    usual_skew: whether its skew is no larger than that of every recorder.
    """

    model: CouplingModel
    nonlinear: Array
    criterion: float
    usual_skew: bool = False


@dataclass(frozen=True, slots=True)
class Lateness:
    """Kc and Bc, SI, if the torque reading has one particular delay.

    spread: standard deviation of Bc, SI, over the delays that this delay represents. criterion: twice the log odds
    against this delay.
    """

    Kc: float
    Bc: float
    spread: float
    criterion: float


@dataclass(frozen=True, eq=False)
class LateReading:
    """A recording whose torque reading may be delayed. accounts: the terms of `EARLIER` that are considered as its
    cause.
    """

    fits: Fits
    criterion: Criterion
    accounts: tuple[str, ...] = ()

    def alternatives(self, chosen: Candidate) -> tuple[Alternative, ...]:
        """Return the models with each cause of delay: a skew, a lag of the cell, both, or an inertia.

        The cause replaces the one in the chosen model, if it has one. In slow motion each cause equals a damping: a
        model without a cause may fit well and still have the wrong damping.
        """
        found = self._others(chosen) if not _OTHER_FILTERS.intersection(chosen.terms) else []
        both = [(one, term) for one in (chosen, *found) for term in (*EARLIER, *_BRANCHES[:1]) if term in one.terms]
        alike = max((self.criterion.blurred(one, term) for one, term in both), default=1.0)
        return tuple(
            Alternative(one.anchored, one.fit.nonlinear, self._akaike(chosen, one, alike))
            for one in found
            if set(one.terms) != set(chosen.terms)
        ) + self._with_the_skew_of_a_recorder(chosen)

    def _with_the_skew_of_a_recorder(self, chosen: Candidate) -> tuple[Alternative, ...]:
        """Return the model with the skew of an ordinary recorder.

        Nine benches of ten have a skew with that standard deviation, p; chance and correlated noise can make the fitted
        skew longer. With the fitted skew s and its standard error e, twice the log likelihood of this model is higher
        than without a skew by the part of s^2/e^2 that a skew of size p explains.
        """
        others = tuple(term for term in chosen.terms if term != _SKEW)
        if len(others) == len(chosen.terms) or _FILTERS.intersection(others):
            return ()
        without = self._with(others, chosen)
        if without is None:
            return ()
        square = self.criterion.ratio(without, chosen) / self.criterion.blurred(chosen, _SKEW)
        if not square > 0.0:
            return ()
        found, usual = size_of(chosen.values, "delay"), c.TICK_SHARE * float(np.median(np.diff(self.fits.motion.time)))
        error = abs(found) / math.sqrt(square)
        criterion = found**2 / (error**2 + usual**2) + math.log1p((usual / error) ** 2) - AKAIKE - _RARE
        return (Alternative(chosen.anchored, chosen.fit.nonlinear, criterion, usual_skew=True),)

    def lateness(self, chosen: Candidate) -> tuple[Lateness, ...]:
        """Return Kc and Bc for each likely cause of delay.

        If the model has neither a delay nor a lag, these are each likely delay and lag; otherwise each branch in their
        place. In slow motion the data hardly determine the delay: the best fit may be far from the truth, early, or at
        a bound. Therefore every likely delay is fitted and weighted by its likelihood. Before the data are seen, one
        bench in ten has a delay of up to 1.5 ticks, and one in ten a cell with a bandwidth of 15 to 480 Hz, each octave
        equally likely. For torques with an inertia, which hides the effect of a delay in fast motion, one
        bench in three has each.
        """
        try:
            if set(LATE).intersection(chosen.terms):
                return (*self._instead_of_the_skew(chosen), *self._relaxing(chosen))
            return tuple(self._late(chosen))
        except RuntimeError:  # no optimum can be proven
            return ()

    def _late(self, chosen: Candidate) -> Iterator[Lateness]:
        """Yield Kc and Bc for each likely delay, lag and drive. chosen: a model without a skew."""
        if set(of_role("channel")).intersection(chosen.terms):
            return
        longest = c.LONGEST_SKEW * float(np.median(np.diff(self.fits.motion.time)))
        delays = longest * np.arange(1, _DELAYS + 1) / _DELAYS
        lags = 0.5 / math.pi / np.geomspace(c.CELLS[1], c.CELLS[0], _LAGS)
        likely = ((_SKEW, delays, 2 * _DELAYS), (_SKEW, -delays, 2 * _DELAYS), (_LAG, lags, _LAGS))
        possible = [one for one in likely if one[0] in self.accounts and is_addable(one[0], chosen.terms)]
        if possible:
            rare = _APART if of_kind(chosen.values, "moment of inertia") else _RARE
            usual = rare + self._with_usual_skew(chosen)
            for term, times, many in possible:
                yield from self._late_by(chosen, term, times, usual + 2.0 * math.log(many))
            yield from self._behind_any_drive(chosen, usual)

    def _instead_of_the_skew(self, chosen: Candidate) -> Iterator[Lateness]:
        """Yield Kc and Bc for the case that held set-points, and not a skew, cause the apparent delay.

        One bench in ten has held set-points, and one in ten a skew.
        """
        others = tuple(term for term in chosen.terms if term != _SKEW)
        without = self._with(others, chosen) if len(others) < len(chosen.terms) else None
        if without is not None and not _FILTERS.intersection(others):
            lost = self.criterion.ratio(without, chosen) / self.criterion.blurred(chosen, _SKEW)
            yield from self._behind_any_drive(without, lost - AKAIKE)

    def _behind_any_drive(self, fitted: Candidate, rare: float) -> Iterator[Lateness]:
        """Yield Kc and Bc behind held set-points, for each likely drive.

        fitted: the model without a skew. rare: twice the log odds against any of the drives. The rate error behind a
        drive looks like a delay of a few hundredths of a tick, and in slow motion like less damping.
        """
        if _SKEW not in self.accounts or of_kind(fitted.values, "moment of inertia") or not fitted.damping > 0.0:
            return
        columns, target = fitted.problem.linearised(fitted.fit)
        damping, blurred = self._damping(fitted), self.criterion.blurred(fitted, *of_role("coupling"))
        before, rare = fitted.damping, rare + 2.0 * math.log(len(c.DRIVES))
        for frequency in c.DRIVES:
            if (off := taken_off(self.fits.motion, frequency)) is None:
                return
            late = target + damping * off
            values = least_absolute_deviations(columns, late, fitted.fit.values).genes
            left = float(np.abs(late - columns @ values).mean())
            criterion = rare - self.criterion.gained(fitted.fit.fitness - left) / blurred
            stiffness, found = values[:2].tolist()
            if criterion < _UNLIKELY:
                yield Lateness(stiffness, found, c.ROUNDING * abs(found - before), criterion)
            before = found

    def _damping(self, fitted: Candidate) -> Array:
        """Return the damping (n,), N m s/rad, at each sample.

        The damping is zero where the damper does not act, such as inside a gap.
        """
        rate = self.fits.motion.dtheta_dot
        return np.where(np.isclose(fitted.columns[:, 1], rate), damping_at(rate, fitted.values), 0.0)

    def _with_usual_skew(self, chosen: Candidate) -> float:
        """Return the increase of twice the log likelihood if the model gets the skew of an ordinary recorder.

        The log likelihood is approximated by a parabola in the skew, through three points: zero and one skew of each
        sign. The size of the skew is that of an ordinary recorder first, and then a shorter one if the data determine
        it much better.
        """
        usual, terms = c.TICK_SHARE * float(np.median(np.diff(self.fits.motion.time))), (*chosen.terms, _SKEW)
        if _SKEW not in self.accounts or not is_addable(_SKEW, chosen.terms):
            return 0.0
        skew, bend = usual, _NARROW
        for _ in range(2):
            skew *= math.sqrt(_NARROW / max(bend, _NARROW))
            early, late = (self.fits.with_value(terms, chosen, sign * skew) for sign in (-1.0, 1.0))
            less, more = (self.criterion.ratio(chosen, one) for one in (early, late))
            blurred = self.criterion.blurred(late, _SKEW)
            slope, bend = 0.5 * (more - less) / blurred, max(0.0, -0.5 * (more + less) / blurred)
        share = (usual / skew) ** 2  # of the usual skew's variance in that of the one tried
        return float(0.25 * slope**2 / (bend + 1.0 / share) - math.log1p(bend * share))

    def _late_by(self, chosen: Candidate, term: str, times: Array, rare: float) -> Iterator[Lateness]:
        """Yield Kc and Bc for each delay in `times` (m,), s, shortest first, until a delay is impossible or too
        unlikely.

        term: the term whose parameter is the delay. rare: twice the log odds against it.
        """
        blurred, before = 0.0, chosen.damping
        for time in times.tolist():
            late = self.fits.with_value((*chosen.terms, term), chosen, time)
            blurred = blurred or self.criterion.blurred(late, term)
            criterion = rare - self._ratio_when_settled(chosen, late, abs(time)) / blurred
            if not math.isfinite(criterion) or criterion > _UNLIKELY or late.damping <= 0.0:
                return
            spread = c.ROUNDING * abs(late.damping - before)  # times between this one and the one before are as likely
            yield Lateness(late.stiffness, late.damping, spread, criterion)
            before = late.damping

    def _ratio_when_settled(self, chosen: Candidate, late: Candidate, time: float) -> float:
        """Return `Criterion.ratio` of the samples at which a lag of that time, s, has settled in each piece.

        The unknown state at the beginning of a piece adds a large residual there, which is no evidence for or against a
        lag.
        """
        settled = self.fits.motion.elapsed > FORGOTTEN * time
        less = np.abs(chosen.problem.residuals(chosen.fit)) - np.abs(late.problem.residuals(late.fit))
        return float(4.0 * self.criterion.density * less[settled].sum())

    def _others(self, chosen: Candidate) -> list[Candidate]:
        """Return the models with each cause of a delayed torque reading, including the chosen model."""
        others = tuple(term for term in chosen.terms if term not in self.accounts)
        seen = len(others) < len(chosen.terms)  # else each likely time counts, and not the best one
        accounts = [(*others, term) for term in self.accounts if seen or term not in LATE]
        if branch := _last_branch(others):
            stiff = tuple(term for term in others if term != branch)
            accounts += [(*stiff, term) for term in self.accounts]
            accounts += [(*stiff, *LATE)] if set(LATE) <= set(self.accounts) else []
        found = [one for terms in accounts if (one := self._with(terms, chosen)) is not None]
        if seen:
            nearest = min(
                (one for one in found if one.terms[-1] in LATE), key=lambda one: one.fit.fitness, default=chosen
            )
            both = self._with((*others, *LATE), nearest) if set(LATE) <= set(self.accounts) else None
            found += [both] if both is not None else []
        return found

    def _akaike(self, chosen: Candidate, one: Candidate, alike: float) -> float:
        """Return Akaike's criterion of model `one` less that of the chosen model.

        alike: the factor by which correlated residuals make the likelihood less certain.
        """
        better = chosen.fit.fitness - self._without_errors(one, chosen.fit.fitness)
        return (
            2.0 * (len(one.model.parameters) - len(chosen.model.parameters))
            - self.criterion.gained(better) / alike
            + (0.0 if set(EARLIER).intersection(chosen.terms) else _RARE)
        )

    def _without_errors(self, one: Candidate, least: float) -> float:
        """Return the fitness, N m, of a model without the errors of the acceleration that its inertia multiplies; at
        least `least`.

        A skew adds no such errors, so without this correction a skew would fit better even if there is an inertia.
        """
        errors = size_of(one.values, "moment of inertia") * self.fits.errors[2]
        left = one.fit.fitness**2 - 2.0 / math.pi * errors**2
        return max(math.sqrt(max(left, 0.0)), min(least, one.fit.fitness))

    def _relaxing(self, chosen: Candidate) -> Iterator[Lateness]:
        """Yield Kc and Bc for each branch that relaxes faster than the joint moved, in place of a delayed torque.

        Both stiffen fast motion, and the branch also damps. In slow motion only the stiffening K1 tau1^2 shows: each
        time constant up to the shortest period of the motion is fitted, and each half octave is equally likely. One
        joint in ten has such a branch. A delay longer than a recorder's is as rare; so is a delay beside a branch,
        because a joint that relaxes at one speed may relax at two. No branch is much stiffer than Kc, and none exists
        without a parallel damper: it would equal a lag.
        """
        others = tuple(term for term in chosen.terms if term not in LATE)
        late = sum(abs(chosen.values[name]) for name in of_kind(chosen.values, "delay", "lag time"))
        term = next((term for term in _BRANCHES if is_addable(term, others)), "")
        if not term or _OTHER_FILTERS.intersection(others) or not chosen.damping > 0.0:
            return
        if late * chosen.stiffness < _HIDDEN * chosen.damping:
            return
        is_usual = term == _BRANCHES[0] and late <= c.LONGEST_SKEW * float(np.median(np.diff(self.fits.motion.time)))
        blurred, before = 0.0, math.nan
        for constant in np.geomspace(SHORTEST_RELAXATION, 1.0, _CONSTANTS) / self.fits.highest:
            branch = self.fits.with_value((*others, term), chosen, float(constant))
            blurred = blurred or self.criterion.blurred(branch, term)
            rare = (_RARE if is_usual else 0.0) + 2.0 * math.log(_CONSTANTS)
            criterion = rare - self._ratio_when_settled(chosen, branch, float(constant)) / blurred
            is_possible = 0.0 < branch.values[own(term)[0]] <= _STIFFEST * branch.stiffness and branch.damping > 0.0
            spread = c.ROUNDING * abs(branch.damping - before)
            if is_possible and math.isfinite(spread) and criterion < _UNLIKELY:
                yield Lateness(branch.stiffness, branch.damping, spread, criterion)
            before = branch.damping

    def _with(self, terms: tuple[str, ...], near: Candidate) -> Candidate | None:
        """Return the model of these terms; None if its skew or lag is outside its bounds. near: a fit whose nonlinear
        parameters the search begins with.
        """
        found = self.fits.candidate_or_none(terms, near.values)
        return found if found and found.is_possible(*(term for term in EARLIER if term in terms)) else None


def _last_branch(terms: tuple[str, ...]) -> str:
    """Return the last branch in the terms that can be removed so that the other terms are still a model; "" if there is
    none.
    """
    return next((branch for branch in reversed(_BRANCHES) if branch in terms), "")
