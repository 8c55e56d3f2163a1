"""Other models of a late torque reading: a skew, a lag of the cell, an inertia, or a branch that relaxes fast."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel
from ga.model.polishing import polished
from ga.model.separable import descend
from ga.model.terms import is_addable
from hil.identification.selection.criterion import STRONG, Criterion
from hil.identification.selection.fits import LATE, Candidate, Fits

Array = NDArray[np.float64]

EARLIER: Final = (*LATE, "inertia")
"""Why a torque reading may be late, or may seem to be early."""

_STIFFEST, _FELT = 2.0, 0.1  # times Kc, what relaxes at most; part of Bc that a late reading hides, which matters
_RARE = 2.0 * math.log(10.0)  # in Akaike's criterion: one joint in ten relaxes faster than it moves, or is read late


@dataclass(frozen=True, slots=True)
class Alternative:
    """A model that may stand in place of the one selected, its nonlinear parameters (q,), SI, and Akaike's criterion of
    it less that of the one selected.
    """

    model: CouplingModel
    nonlinear: Array
    criterion: float


@dataclass(frozen=True, eq=False)
class LateReading:
    """A recording whose torque reading may be late; accounts: the terms by which it may be, of `EARLIER`."""

    fits: Fits
    criterion: Criterion
    accounts: tuple[str, ...] = ()

    def instead_of_branch(self, chosen: Candidate) -> Candidate:
        """Return the model with a lag in place of its branch where that fits as well.

        A branch without a damper of its own beside it has the form of a lag, which has a parameter less.
        """
        possible = "maxwell" in chosen.terms and "lag" in self.accounts and is_addable("lag", chosen.terms)
        other = self._with(_replaced(chosen.terms, "maxwell", "lag")) if possible else None
        if other is None:
            return chosen
        alike = self.criterion.blurred(other, "lag")
        parameter = math.log(max(len(self.fits.torque) / alike, math.e))
        return other if self.criterion.ratio(other, chosen) / alike < parameter else chosen

    def instead_of_skew(self, chosen: Candidate) -> Candidate:
        """Return the model with a lag or an inertia in place of its skew where that fits clearly better."""
        gains = {}
        others = [one for one in self.accounts if one not in chosen.terms] if "skew" in chosen.terms else []
        for one in others:
            terms = _replaced(chosen.terms, "skew", one)
            if self.fits.fitness(terms) < np.inf:
                other = self.fits.candidate(terms)
                gains[one] = self._independent(chosen, other, one) if other.is_possible(one) else 0.0
        best = max(gains, key=lambda one: gains[one], default="")
        return self.fits.candidate(_replaced(chosen.terms, "skew", best)) if gains.get(best, 0.0) > STRONG else chosen

    def alternatives(self, chosen: Candidate) -> tuple[Alternative, ...]:
        """Return the models with a skew, a lag of the cell, both, an inertia or a branch, in place of its own or none.

        In slow motion any of them is a damping: a model without one may have the fit, and not the damping.
        """
        found = self._others(chosen) if "mean" not in chosen.terms else []
        both = [(one, term) for one in (chosen, *found) for term in EARLIER if term in one.terms]
        alike = max((self.criterion.blurred(one, term) for one, term in both), default=1.0)
        return tuple(
            Alternative(one.anchored, one.fit.nonlinear, self._akaike(chosen, one, alike))
            for one in found
            if set(one.terms) != set(chosen.terms)
        )

    def _independent(self, chosen: Candidate, other: Candidate, one: str) -> float:
        """The likelihood ratio of the other model, divided by the factor by which it is less certain."""
        return float(self.criterion.ratio(chosen, other) / self.criterion.blurred(other, one))

    def _others(self, chosen: Candidate) -> list[Candidate]:
        """The models with any account of a late torque reading, that of the model chosen among them."""
        others = tuple(term for term in chosen.terms if term not in self.accounts)
        accounts = [(*others, term) for term in self.accounts]
        if "maxwell" in others:
            stiff = tuple(term for term in others if term != "maxwell")
            accounts += [(*stiff, term) for term in self.accounts]
            accounts += [(*stiff, *LATE)] if set(LATE) <= set(self.accounts) else []
        found = [one for terms in accounts if (one := self._with(terms)) is not None]
        if len(others) < len(chosen.terms):
            nearest = min(
                (one for one in found if one.terms[-1] in LATE), key=lambda one: one.fit.fitness, default=chosen
            )
            both = self._with((*others, *LATE), beside=nearest) if set(LATE) <= set(self.accounts) else None
            found += [one for one in (both, self._relaxing(chosen, others)) if one is not None]
        return found

    def _akaike(self, chosen: Candidate, one: Candidate, alike: float) -> float:
        """Akaike's criterion of a model less that of the one chosen, alike: the factor by which it is less certain."""
        relaxes = "maxwell" in one.terms and "maxwell" not in chosen.terms
        return (
            2.0 * (len(one.model.parameters) - len(chosen.model.parameters))
            - self.criterion.ratio(chosen, one) / alike
            + (_RARE if relaxes or not set(EARLIER).intersection(chosen.terms) else 0.0)
        )

    def _relaxing(self, chosen: Candidate, others: tuple[str, ...]) -> Candidate | None:
        """The model with a branch that relaxes faster than the joint moved, in place of a late torque reading.

        Both stiffen fast motion, and the branch is a damper besides. None is much stiffer than Kc, and none stands
        alone: without a damper beside it, it has the form of a lag, which has a parameter less.
        """
        values = chosen.values
        late = sum(abs(values.get(term, 0.0)) for term in LATE)
        if not is_addable("maxwell", others) or late * values["Kc"] < _FELT * values["Bc"]:
            return None
        terms = (*others, "maxwell")
        if self.fits.fitness(terms) == np.inf:
            return None
        found = self.fits.candidate(terms)
        branch = found.values
        likely = branch["K1"] <= _STIFFEST * branch["Kc"] and branch["Bc"] >= _FELT * values["Bc"]
        return found if likely and found.is_possible("maxwell") else None

    def _with(self, terms: tuple[str, ...], beside: Candidate | None = None) -> Candidate | None:
        """The model of these terms, where its skew and lag are within their bounds."""
        if self.fits.fitness(terms) == np.inf:
            return None
        found = self.fits.candidate(terms, beside)
        found = found if beside is None else _deeper(found)
        return found if found.is_possible(*(term for term in EARLIER if term in terms)) else None


def _deeper(found: Candidate) -> Candidate:
    """The fit of terms that are much alike: roughly on some of the samples, then on all."""
    rough = polished(found.problem.thinned(), found.fit)
    near = polished(found.problem, descend(found.problem, rough.nonlinear), reach=2.0)
    return replace(found, fit=min(found.fit, near, key=lambda fit: fit.fitness))


def _replaced(terms: tuple[str, ...], one: str, other: str) -> tuple[str, ...]:
    """The terms with another one in place of one."""
    return tuple(other if term == one else term for term in terms)
