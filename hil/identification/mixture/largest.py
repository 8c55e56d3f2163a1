"""Build the largest of the models that are averaged over: it contains all others, whose fits follow from its fit.

If the spring curves, the curve that fits best is selected. No real spring follows one of these curves exactly, and the
stiffness at zero deflection depends on the curve.

Dry friction never reverses at once: the contact that holds the joint is about as stiff as the coupling. Friction
therefore builds up over a deflection of about Fc/Kc (Dahl 1976), which stiffens small motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ga.arrays import Array
from ga.lad.exact import least_absolute_deviations
from ga.model.coupling import CouplingModel, parse
from ga.model.separable import Problem
from ga.model.sticking import slowest
from ga.model.terms import PARAMETERS, TERMS, is_addable, of_kind, of_role, size_of
from ga.model.trajectory import Motion
from hil.identification.candidates.fits import own
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import Covariance, covariance
from hil.identification.mixture.model_average import AKAIKE
from hil.signals.constants import KNOWN_MEAN
from hil.signals.prepare import Signals

_ALWAYS = tuple(name for name, term in TERMS.items() if term.bench == "always")
BENCH = (*_ALWAYS, *(name for name, term in TERMS.items() if term.bench == "small"))  # effects that every bench has
_CURVES = tuple(name for name in of_role("curve") if TERMS[name].linear)  # a spring has no more reason to follow one
_PRESLIDING = "presliding"  # a nuisance parameter, 1 where friction builds up over Fc/Kc
_DEVIATING = "deviation of "  # before the name of a term: another, of what departs from its law
_SEEN = 0.1  # part of the friction, from which its building up is seen


@dataclass(frozen=True, eq=False)
class Largest:
    """The fit of the model that contains all others.

    names: the parameters of the model, and that of friction that builds up if this term was added. values (p,): their
    values, SI. columns (n, p) and target (n,), N m: the linear problem around the fit. sampling: the covariance of the
    values. prior (2, p): the expected value of each parameter and its standard deviation before the data are seen.
    """

    model: CouplingModel
    added: tuple[str, ...]
    names: list[str]
    columns: Array
    target: Array
    values: Array
    sampling: Covariance
    prior: Array

    @property
    def is_possible(self) -> bool:
        """Return whether no friction of the selected terms is negative: it would drive the joint."""
        chosen = zip(self.names, self.values.tolist(), strict=True)
        rubs = {name for name in self.names if name in PARAMETERS and PARAMETERS[name].friction}
        return all(value >= 0.0 for name, value in chosen if name in rubs.difference(self.added_names))

    @property
    def added_names(self) -> list[str]:
        """Return the names of the parameters of the added terms."""
        return [name for term in self.added for name in own(term)]

    def costs(self, doubtful: Mapping[str, float]) -> dict[str, float]:
        """Return the cost of each parameter that a model may lack: the parameters of the added terms and of the
        doubtful terms.

        doubtful: the terms that the data do not decide on, and the cost of each. If the data do not decide whether the
        spring curves at all, only the doubtful curve is considered.
        """
        curving = max((cost for term, cost in doubtful.items() if term in _CURVES), default=AKAIKE)
        found = {term: curving if term in _CURVES else AKAIKE for term in self.added if term not in _ALWAYS}
        costs = {name: cost for term, cost in (found | dict(doubtful)).items() for name in own(term)}
        return costs | {name: AKAIKE for name in self.names if name.startswith(_DEVIATING)}


@dataclass(frozen=True, eq=False)
class Selected:
    """The selected model, its nonlinear parameters (q,), SI, and the signals that it is fitted to."""

    model: CouplingModel
    nonlinear: Array
    data: Signals

    @cached_property
    def values(self) -> dict[str, float]:
        """Return the linear parameters, SI, by name, fitted at the nonlinear ones."""
        bounds = self.model.bounds(self.data.motion, self.data.band[1])
        fit = Problem(self.model, self.data.motion, self.data.torque, *bounds).solve(self.nonlinear)
        return dict(zip((one.name for one in self.model.linear), fit.values.tolist(), strict=False))


def largest_model(selected: Selected, doubtful: Sequence[str]) -> Largest | None:
    """Return the largest model in which each added term can be distinguished from the others; None if there is none.

    It is linearised at the fit of the selected model: the added effects are small, and a nonlinear search would give
    them, together with a lag, values far too large.
    """
    data, chosen = selected.data, selected.model.name.split("+")
    added: list[str] = []
    curves = _CURVES if set(of_role("curve")).intersection(chosen) else ()
    unseen = slowest(data.motion) == 0.0  # the sign of friction would be that of the rate's noise
    # a short lag differs from a delay by less than what estimates both at once
    lags = any(of_kind(own(term), "lag time") for term in chosen)
    hidden = {name for name, one in TERMS.items() if (unseen and one.sticks) or (lags and one.delays)}
    for term in (*BENCH, *doubtful, *curves):
        added += [term] if is_addable(term, (*chosen, *added)) and term not in hidden else []
    start = {parameter.name: parameter.absent for parameter in PARAMETERS.values()}
    start |= dict(zip((one.name for one in selected.model.nonlinear), selected.nonlinear.tolist(), strict=True))
    while True:
        larger = parse("+".join((*chosen, *added))).anchored(data.motion)
        problem = Problem(larger, data.motion, data.torque, *larger.bounds(data.motion, data.band[1]))
        try:
            fit = problem.solve(np.array([start[p.name] for p in larger.nonlinear], dtype=np.float64))
            names = [parameter.name for parameter in larger.parameters]
            columns, target = problem.linearised(fit)
            for name, column in _nuisances(larger, chosen, columns, fit.values, data.motion):
                names, columns = [*names, name], np.column_stack([columns, column])
            first = np.append(fit.values, np.zeros(len(names) - len(fit.values)))
            values = least_absolute_deviations(columns, target, first).genes
        except RuntimeError:  # some columns are dependent
            return None
        sampling = covariance(Blocks.of(columns, target), values)
        alike = [term for term in added if not all(sampling.distinct[names.index(name)] for name in own(term))]
        if not alike:
            prior = np.stack([np.zeros(len(names)), np.full(len(names), np.inf)])
            prior[:, [name == _PRESLIDING for name in names]] = 1.0
            return Largest(larger, tuple(added), names, columns, target, values, sampling, prior)
        added.remove(alike[-1])


def _nuisances(
    model: CouplingModel, chosen: Sequence[str], columns: Array, values: Array, motion: Motion
) -> Iterator[tuple[str, Array]]:
    """Yield the columns (n,) of effects that no term of the model follows exactly, each with its name.

    chosen: the terms that were selected. columns (n, p), values (p,): of the parameters of the model.
    """
    own = dict(zip(model.parameters, values.tolist(), strict=True))
    named = {parameter.name: value for parameter, value in own.items()}
    if (building := _building_up(named, motion)) is not None:
        yield _PRESLIDING, building
    each, seen = dict(zip(model.parameters, columns.T, strict=True)), motion.delayed(size_of(named, "delay"))
    for term in model.terms:
        if term.deviation is not None and term.name in chosen:
            yield f"{_DEVIATING}{term.name}", term.deviation(seen, each, own)


def _building_up(values: Mapping[str, float], motion: Motion) -> Array | None:
    """Return the difference in torque (n,), N m, between friction that builds up over Fc/Kc and friction that reverses
    at once.

    values: the parameters of the model by name. None if the model has no Coulomb friction, if the friction builds up
    too fast to be visible, or if friction reverses smoothly.
    """
    friction, stiffness = size_of(values, "dry friction"), values["Kc"]
    if friction <= 0.0 or stiffness <= 0.0 or of_kind(values, "turning rate"):
        return None
    whole, rows = motion.whole
    seen = whole.delayed(size_of(values, "delay"))
    found = friction * (seen.presliding(friction / stiffness) - np.sign(seen.dtheta_dot))[rows]
    return found if np.count_nonzero(np.abs(found) > _SEEN * friction) >= KNOWN_MEAN else None
