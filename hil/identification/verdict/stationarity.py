"""Check whether the parameters are the same in all pooled recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ga.arrays import Array
from ga.lad.out_of_core import reduce
from ga.model.terms import of_kind
from hil.diagnostics import Diagnostic
from hil.identification.fitting.blocks import Blocks
from hil.identification.fitting.confidence import ConfidenceIntervals, confidence_intervals
from hil.identification.result import VarianceComponents
from hil.identification.verdict.random_effects import between, is_outside
from hil.signals import constants as c

_OTHERS = {True: "the others", False: "the other one"}


def pooled_intervals(
    blocks: Blocks, edges: tuple[int, ...], intervals: ConfidenceIntervals
) -> tuple[ConfidenceIntervals, tuple[VarianceComponents | None, ...]]:
    """Return the intervals widened by the differences between recordings, and each parameter's variance components.

    blocks: the pooled linear problem. edges: the row at which each recording ends. A parameter that fewer than two
    recordings can estimate alone keeps its interval, and its components are None.
    """
    if len(edges) < 2:
        return intervals, (None,) * len(intervals.half_width)
    fitted = [_fitted(blocks.between(start, stop)) for start, stop in pairwise((0, *edges))]
    widened, components = intervals.half_width.copy(), list[VarianceComponents | None]()
    for at in range(len(widened)):
        is_known = [at < len(half) and 0.0 < half[at] < np.inf for _, half in fitted]
        if sum(is_known) < 2:
            components.append(None)
            continue
        usable = [(one[at], half[at] / c.NORMAL) for (one, half), known in zip(fitted, is_known, strict=True) if known]
        pooled = between(*np.array(usable).T)
        values = tuple(float(one[at]) if known else np.nan for (one, _), known in zip(fitted, is_known, strict=True))
        components.append(VarianceComponents(pooled.within, pooled.between, values, pooled.p_alike))
        widened[at] = max(widened[at], 0.5 * (pooled.ci95[1] - pooled.ci95[0]))
    return replace(intervals, half_width=widened), tuple(components)


def disagreement(
    names: Sequence[str], components: Sequence[VarianceComponents | None], paths: Sequence[Path]
) -> list[Diagnostic]:
    """Return a diagnostic that names the recording that differs most from the others; [] if they differ neither in Kc
    nor in Bc.

    The diagnostic is an error if that recording lies outside the prediction interval of the others, which may differ
    too. names (p,): the parameters. components (p,): their variance components. paths (m,): the recordings.
    """
    found = []
    for name, one in zip(names, components, strict=True):
        if name not in c.COUPLING or one is None or not _differ(one):
            continue
        values = np.array(one.values)
        at, usual = _most_apart(values)
        if not abs(values[at] - usual) > c.RELEVANT[0] * abs(usual):
            continue
        other = _OTHERS[len(values) > 2]
        differs = f"is {values[at]:.3g} (SI), and that of {other} is zero"
        if usual:
            differs = f"differs by {values[at] / usual - 1.0:+.1%} from {other}"
        text = (
            f"{name} of {paths[at]} {differs}. The pooled {name} "
            "describes no recording. Leave that recording out, or compare them with hil compare"
        )
        others = np.delete(values, at)
        others = others[np.isfinite(others)]
        is_error = len(others) > 1 and is_outside(float(values[at]), others, one.within)
        found.append(Diagnostic("recordings-differ", text, name, is_error=is_error))
    return found


def other_zeros(
    names: Sequence[str], components: Sequence[VarianceComponents | None], paths: Sequence[Path], error: float
) -> list[Diagnostic]:
    """Return a warning that names the recording whose torque at rest differs most from that of the others.

    names (p,), components (p,), paths (m,): parameters, their variance components, the recordings. error: mean |error|
    of the fit, N m; a difference of half of it is relevant.
    """
    (name,) = of_kind(names, "torque at rest") or ("",)
    one = dict(zip(names, components, strict=True)).get(name)
    if one is None or not _differ(one):
        return []
    values = np.array(one.values)
    at, usual = _most_apart(values)
    if not abs(values[at] - usual) > c.MAJORITY * error:
        return []
    text = (
        f"the torque at rest of {paths[at]} differs by {values[at] - usual:+.3g} N m from {_OTHERS[len(values) > 2]}; "
        f"the mean error of the fit is {error:.2g} N m. The torque cell or the encoder had another zero there. One "
        f"{name} does not describe these recordings, and Kc and Bc take a part of what it leaves. Identify each "
        "recording alone and compare them with hil compare, or set both zeros before you record again"
    )
    return [Diagnostic("recordings-differ", text, name)]


def _differ(one: VarianceComponents) -> bool:
    """Return whether the values of the recordings differ by more than chance explains. one: the variance components."""
    return one.p_alike <= c.FALSE_ALARMS and one.between > c.BETWEEN * one.within


def _most_apart(values: Array) -> tuple[int, float]:
    """Return the index of the value, out of `values` (m,), that is furthest from the median of the others, and that
    median.
    """
    usual = [float(np.nanmedian(np.delete(values, at))) for at in range(len(values))]
    at = int(np.nanargmax(np.abs(values - usual)))
    return at, usual[at]


def _fitted(blocks: Blocks) -> tuple[Array, Array]:
    """Return the exact optimum (p,) and half its intervals (p,); empty arrays without rows or independent columns."""
    if not blocks.rows:
        return np.zeros(0), np.zeros(0)
    try:
        values = reduce(blocks, blocks.rows).optimum.genes
    except RuntimeError:
        return np.zeros(0), np.zeros(0)
    return values, confidence_intervals(blocks, values).half_width
