"""Pictures of the parameters' intervals, and of the terms that model selection tried."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.report.chart import Band, Chart, Line, Panel
from hil.report.formatting import people_unit
from hil.report.identification import milli, printed
from hil.units import with_unit

if TYPE_CHECKING:
    from hil.identification.result import Estimate, Identification, Step

Array = NDArray[np.float64]


def intervals_chart(found: Identification) -> Chart:
    """Return the 95 % interval of each parameter, in percent of the parameter's value."""
    known = _known(found)
    places = np.arange(float(len(known)))
    ends = np.array([sorted(100.0 * (end / one.value - 1.0) for end in one.ci95) for one in known]).reshape(-1, 2).T
    line = Line("", places, 0.0 * places, mark="dot", ends=ends)
    return Chart([Panel("", "95 % interval [%]", [line], names=[one.name for one in known])])


def intervals_text(found: Identification) -> str:
    """Return the parameters' intervals in words."""
    parts = []
    for estimate in _known(found):
        _, _, interval, unit = printed(found, estimate)
        parts.append(f"{estimate.name} {with_unit(interval, unit)}")
    return f"95 % intervals: {'; '.join(parts)}." if parts else "No parameter has an interval."


def _known(found: Identification) -> list[Estimate]:
    """Return the parameters that have a finite interval and a value that is not zero."""
    return [one for one in found.estimates if np.isfinite(one.ci95).all() and one.value != 0.0]


def selection_chart(found: Identification) -> Chart:
    """Return, for each term that was tried, the improvement of the score, and Kc and Bc with this term.

    The interval of the final result is drawn beside Kc and Bc.
    """
    names = [step.term if at == 0 else f"+ {step.term}" for at, step in enumerate(found.steps)]
    gains = _split(found.steps, [step.gain for step in found.steps], from_zero=True)
    panels = [Panel("", "gain (included: above 0)", gains, scale="symlog", names=names)]
    return Chart([*panels, *(_parameter(found, name, names) for name in ("Kc", "Bc"))])


def _split(steps: Sequence[Step], values: Sequence[float], *, from_zero: bool = False) -> list[Line]:
    """Return a line of points for the included terms and one for the rejected terms. from_zero: draw a stem from 0 to
    each point.
    """
    heights, lines = np.array(values, np.float64), []
    for name, mark, colour, included in (("included", "dot", "first", True), ("rejected", "ring", "error", False)):
        chosen = np.array([step.included == included for step in steps]) & np.isfinite(heights)
        places, shown = np.flatnonzero(chosen).astype(np.float64), heights[chosen]
        ends = np.sort([0.0 * shown, shown], axis=0) if from_zero else None
        lines.append(Line(name, places, shown, colour, mark=mark, ends=ends))
    return lines


def _parameter(found: Identification, name: str, names: Sequence[str]) -> Panel:
    estimate = found[name]
    factor, unit = people_unit(estimate.unit, milli=milli(found))
    low, high = (factor * end for end in estimate.ci95)
    bands = [Band(low, high, "95 % interval of the result")] if math.isfinite(low) and math.isfinite(high) else []
    lines = _split(found.steps, [factor * getattr(step, name) for step in found.steps])
    return Panel("", f"{name} with it [{unit}]", lines, names=names, bands=bands)


def selection_text(found: Identification) -> str:
    """Return the result of the model selection and the gain of each term in words."""
    said = [
        f"{step.term} {step.gain:.3g} ({'included' if step.included else 'rejected'})"
        for step in found.steps
        if math.isfinite(step.gain)
    ]
    begun = f"Model selection ended with {found.model.name}."
    return f"{begun} Gain of each term beside it: {', '.join(said)}." if said else begun
