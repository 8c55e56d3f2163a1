"""Find the terms that the data cannot decide on, and the values of Kc and Bc with these terms."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

from ga.model.terms import RARER, TERMS
from hil.diagnostics import Diagnostic
from hil.identification.result import Estimate, Step, interval
from hil.signals import constants as c
from hil.uncertainty.criteria import narrow
from hil.uncertainty.misfit import LackOfFit
from hil.units import with_unit

_GAUSSIAN = math.pi / 2.0  # power of noise by the square of its mean size


def beside_doubtful_terms(
    fit: LackOfFit | None, steps: tuple[Step, ...], found: tuple[Estimate, ...]
) -> LackOfFit | None:
    """Return the result of the lack-of-fit tests, its size increased by the effect of doubtful terms on Kc and Bc.

    A term is doubtful if it explains less of the torque than the misfit: the term may explain a part of the same
    effect.
    """
    if fit is None or not fit.misfit:
        return fit
    included = [step for step in steps if step.included]
    doubtful = [
        (before, after)
        for before, after in pairwise(included)
        if _GAUSSIAN * (before.fitness**2 - after.fitness**2) < fit.predicted**2
    ]
    changes = [[abs(after.Kc - before.Kc), abs(after.Bc - before.Bc)] for before, after in doubtful]
    for name, one, size in zip(("Kc", "Bc"), found, (max(sizes) for sizes in zip(*changes, strict=True)), strict=False):
        if one.value and size > abs(one.value) * getattr(fit, name):
            outside = {*fit.outside, name} if size > one.half_width else fit.outside
            fit = replace(fit, outside=tuple(outside), **{name: size / abs(one.value)})
    return fit


def with_rivals(steps: tuple[Step, ...], found: tuple[Estimate, ...]) -> tuple[tuple[Estimate, ...], list[Diagnostic]]:
    """Return the estimates, their intervals widened to include each undecided rare term, and a diagnostic for each
    term.

    Model averages weigh common terms by their odds, but do not contain rare terms. A parameter gets an error, and keeps
    its interval, in two cases: the interval that includes all these values is wider than allowed, or the evidence is
    strong for a common term that could not be included.
    """
    undecided = [step for step in steps if not step.included and step.gain > c.EVIDENCE_AGAINST]
    pairs = [_with_rivals(undecided, estimate) for estimate in found[:2]]
    return (*(one for one, _ in pairs), *found[2:]), [one for _, doubts in pairs for one in doubts]


def _with_rivals(undecided: list[Step], estimate: Estimate) -> tuple[Estimate, list[Diagnostic]]:
    low, high = estimate.ci95
    values = {step.term: {"Kc": step.Kc, "Bc": step.Bc}[estimate.name] for step in undecided}
    outside = {term: value for term, value in values.items() if not low <= value <= high}
    possible = [low, high, *(value for value in outside.values() if value > 0.0)]
    is_wide = not narrow(0.5 * (max(possible) - min(possible)), estimate.value)
    held = {term: value for term, value in outside.items() if term in RARER and value > 0.0 and not is_wide}
    strong = {step.term for step in undecided if step.gain > c.STRONG}
    doubts = [
        Diagnostic(
            "model-dependent",
            f"{_evidence(term, is_strong=term in strong)}. With it, {estimate.name} {_change(value, estimate)}, which "
            f"is {'in' if term in held else 'outside'} its interval. Record over a wider band, and at several and "
            "larger amplitudes",
            estimate.name,
            is_error=(is_wide or term in strong.difference(held)) and value > 0.0,
        )
        for term, value in outside.items()
    ]
    if not held:
        return estimate, doubts
    half = max(estimate.half_width, *(abs(value - estimate.value) for value in held.values()))
    return replace(estimate, ci95=interval(estimate.value, half, positive=estimate.positive)), doubts


def _evidence(term: str, *, is_strong: bool) -> str:
    meaning = TERMS[term].meaning
    if is_strong:
        return (
            f"there is strong evidence for {term} ({meaning}), but it cannot be included: its parameters are "
            "impossible, the motion does not distinguish them from others, or it predicts other parts of the recording "
            "no better"
        )
    return f"the data cannot decide whether {term} is present ({meaning})"


def _change(value: float, estimate: Estimate) -> str:
    if not estimate.value:
        return f"would be {with_unit(f'{value:.3g}', estimate.unit)}"
    return f"changes by {value / estimate.value - 1.0:+.2%}"
