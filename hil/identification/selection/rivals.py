"""The terms that the data cannot decide on, and what Kc and Bc would be with them."""

from __future__ import annotations

from dataclasses import replace

from ga.model.terms import TERMS
from hil.diagnostics import Diagnostic
from hil.identification.result import Estimate, interval
from hil.identification.selection.stepwise import Step
from hil.uncertainty.criteria import EVIDENCE_AGAINST, narrow
from hil.units import with_unit


def with_rivals(steps: tuple[Step, ...], found: tuple[Estimate, ...]) -> tuple[tuple[Estimate, ...], list[Diagnostic]]:
    """Return the estimates with what Kc and Bc would be with each undecided term in their intervals, and those terms.

    Errors, and the intervals as they were, where one that holds these values too would be wider than one may be.
    """
    undecided = [step for step in steps if not step.included and step.gain > EVIDENCE_AGAINST]
    pairs = [_with_rivals(undecided, estimate) for estimate in found[:2]]
    return (*(one for one, _ in pairs), *found[2:]), [one for _, doubts in pairs for one in doubts]


def _with_rivals(undecided: list[Step], estimate: Estimate) -> tuple[Estimate, list[Diagnostic]]:
    low, high = estimate.ci95
    values = {step.term: {"Kc": step.Kc, "Bc": step.Bc}[estimate.name] for step in undecided}
    outside = {term: value for term, value in values.items() if not low <= value <= high}
    likely = [value for value in outside.values() if value > 0.0]
    possible = [low, high, *likely]
    is_wide = not narrow(0.5 * (max(possible) - min(possible)), estimate.value)
    doubts = [
        Diagnostic(
            "model-dependent",
            f"the data cannot decide whether {term} is present ({TERMS[term].meaning}). With it, {estimate.name} "
            f"{_change(value, estimate)}{_of_interval(value, is_wide=is_wide)}. Record over a wider band or with a "
            "larger amplitude",
            estimate.name,
            is_error=is_wide and value > 0.0,
        )
        for term, value in outside.items()
    ]
    if is_wide or not likely:
        return estimate, doubts
    half = max(estimate.half_width, *(abs(value - estimate.value) for value in likely))
    return replace(estimate, ci95=interval(estimate.value, half, positive=estimate.positive)), doubts


def _of_interval(value: float, *, is_wide: bool) -> str:
    """What the interval has of the value, which it holds where that is possible and not too far away."""
    return ", which is outside its interval" if is_wide or value <= 0.0 else "; its interval includes that"


def _change(value: float, estimate: Estimate) -> str:
    if not estimate.value:
        return f"would be {with_unit(f'{value:.3g}', estimate.unit)}"
    return f"changes by {value / estimate.value - 1.0:+.2%}"
