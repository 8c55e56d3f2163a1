"""Kc and Bc averaged over the models that the data cannot decide between, so that the interval includes the choice.

Model selection leaves out what is not significant, but no bench is without offset, drift, friction and skew: the
interval given the selected model is too narrow. The average is over that model with and without those effects, and the
terms without strong evidence for or against them. An offset and a skew are always there, the latter of a size that one
recorder can produce, because the two readings of one tick never have quite the same age.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel, parse
from ga.model.separable import Problem, descend
from ga.model.terms import PARAMETERS, TERMS, is_addable
from hil.identification.model_choice import Choice
from hil.identification.stepwise import Step
from hil.signals.prepare import Signals
from hil.uncertainty.blocks import Blocks
from hil.uncertainty.confidence import Covariance, covariance
from hil.uncertainty.criteria import COUPLING, EVIDENCE_AGAINST, TICK_SHARE
from hil.uncertainty.model_average import average

Array = NDArray[np.float64]

_ALWAYS = ("offset", "skew")
_SELECTED, _NORMAL = 0.05, 1.96  # the least weight of the selected model; half a 95 % interval in standard errors
_BENCH = (*_ALWAYS, "drift", "coulomb")  # effects that every bench has


@dataclass(frozen=True, slots=True)
class Averaged:
    """An estimate averaged over models, SI: its value and half its 95 % interval, given the noise and the choice."""

    value: float
    half_width: float

    def beside(self, value: float, half_width: float) -> Averaged:
        """Return the average with an estimate of the selected model, SI, which weighs 5 %, its half width included.

        Selection by prediction and the average by likelihood need not agree: what they differ by is in the width.
        """
        apart = value - self.value
        variance = (1.0 - _SELECTED) * (self.half_width / _NORMAL) ** 2 + _SELECTED * (half_width / _NORMAL) ** 2
        variance += _SELECTED * (1.0 - _SELECTED) * apart**2
        return Averaged(self.value + _SELECTED * apart, _NORMAL * float(np.sqrt(variance)))


def averaged(choice: Choice, signals: Signals, used: NDArray[np.bool_], nonlinear: Array) -> dict[str, Averaged]:
    """Return Kc and Bc averaged over models around the selected one; {} where the larger ones cannot be fitted.

    used (n,): the samples that it is fitted to. nonlinear (q,): its nonlinear parameters.
    """
    if not (choice.steps and isinstance(choice.model, CouplingModel)):
        return {}
    kept = replace(signals, motion=signals.motion.of(used), torque=signals.torque[used])
    doubtful = [step.term for step in choice.steps if _is_doubtful(step)]
    largest = _largest(choice.model, doubtful, kept, nonlinear)
    if largest is None:
        return {}
    added, names, sampling = largest.added, largest.names, largest.sampling
    scales = np.full(len(names), np.inf)
    if "skew" in added:
        scales[names.index("skew")] = TICK_SHARE * float(np.median(np.diff(kept.motion.time)))
    optional = {name for term in (*added, *doubtful) if term not in _ALWAYS for name in _own(term)}
    found = average(
        largest.values,
        sampling.matrix,
        [at for at, name in enumerate(names) if name in optional],
        [at for at, name in enumerate(names) if PARAMETERS[name].positive],
        scales,
    )
    if found is None:
        return {}
    return {
        name: Averaged(float(found.values[at]), float(sampling.quantile[at] * found.errors[at]))
        for at, name in enumerate(names)
        if name in COUPLING
    }


@dataclass(frozen=True, eq=False)
class _Largest:
    """The fit of the model that contains all others: values (p,) of the parameters `names`, and the terms added."""

    added: tuple[str, ...]
    names: list[str]
    values: Array
    sampling: Covariance


def _largest(model: CouplingModel, doubtful: Sequence[str], data: Signals, nonlinear: Array) -> _Largest | None:
    """The largest model in which each added term can be distinguished from the others; None where there is none."""
    chosen = model.name.split("+")
    added: list[str] = []
    for term in (*_BENCH, *doubtful):
        added += [term] if is_addable(term, (*chosen, *added)) else []
    start = {parameter.name: parameter.absent for parameter in PARAMETERS.values()}
    start |= dict(zip((parameter.name for parameter in model.nonlinear), nonlinear.tolist(), strict=True))
    while True:
        larger = parse("+".join((*chosen, *added))).anchored(data.motion)
        problem = Problem(larger, data.motion, data.torque, *larger.bounds(data.motion, data.band[1]))
        try:
            fit = descend(problem, np.array([start[p.name] for p in larger.nonlinear], dtype=np.float64))
        except RuntimeError:  # some columns are dependent
            return None
        sampling = covariance(Blocks.of(*problem.linearised(fit)), fit.values)
        names = [parameter.name for parameter in larger.parameters]
        alike = [term for term in added if not all(sampling.distinct[names.index(name)] for name in _own(term))]
        if not alike:
            return _Largest(tuple(added), names, fit.values, sampling)
        added.remove(alike[-1])


def _is_doubtful(step: Step) -> bool:
    """Whether the evidence for or against the term of a step is not strong."""
    term = TERMS[step.term]
    return term.linear and term.selection != "smallest" and abs(step.gain) < -EVIDENCE_AGAINST


def _own(term: str) -> tuple[str, ...]:
    return tuple(parameter.name for parameter in TERMS[term].parameters)
