"""The terms that the data cannot decide on, and what Kc and Bc would be with them."""

from __future__ import annotations

from ga.model.terms import TERMS
from hil.diagnostics import Diagnostic
from hil.identification.result import Estimate
from hil.identification.selection.stepwise import Step
from hil.uncertainty.criteria import EVIDENCE_AGAINST, narrow


def rivals(steps: tuple[Step, ...], found: tuple[Estimate, ...]) -> list[Diagnostic]:
    """Return what is to know of each undecided term with which Kc or Bc would be outside its interval.

    Errors where an interval that holds these values too would be wider than one may be.
    """
    undecided = [step for step in steps if not step.included and step.gain > EVIDENCE_AGAINST]
    return [diagnostic for estimate in found[:2] for diagnostic in _rivals(undecided, estimate)]


def _rivals(undecided: list[Step], estimate: Estimate) -> list[Diagnostic]:
    low, high = estimate.ci95
    values = {step.term: {"Kc": step.Kc, "Bc": step.Bc}[estimate.name] for step in undecided}
    outside = {term: value for term, value in values.items() if not low <= value <= high}
    possible = [low, high, *(value for value in outside.values() if value > 0.0)]
    is_wide = not narrow(0.5 * (max(possible) - min(possible)), estimate.value)
    return [
        Diagnostic(
            "model-dependent",
            f"the data cannot decide whether {term} is present ({TERMS[term].meaning}). With it, {estimate.name} "
            f"{_change(value, estimate)}, which is outside its interval. Record over a wider band or with a larger "
            "amplitude",
            estimate.name,
            is_error=is_wide and value > 0.0,
        )
        for term, value in outside.items()
    ]


def _change(value: float, estimate: Estimate) -> str:
    if not estimate.value:
        return f"would be {value:.3g} {estimate.unit.replace('*', ' ')}"
    return f"changes by {value / estimate.value - 1.0:+.2%}"
