"""Figures of the parameters' intervals, and of the terms that model selection tried."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.report.formatting import people_unit
from hil.report.identification import milli, printed
from hil.report.pictures.canvas import canvas, literal, plain_ticks
from hil.units import with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hil.identification.result import Estimate, Identification
    from hil.identification.selection.stepwise import Step

_LINEAR = 10.0  # gains up to which their axis is linear: others are thousands of times as large


def intervals_drawn(found: Identification) -> Figure:
    """Return a figure of the 95 % interval of each parameter, in percent of the parameter's value."""
    known = _known(found)
    drawn, (panel,) = canvas(1, 1, (9, 0.9 + 0.45 * max(len(known), 1)))
    for at, estimate in enumerate(known):
        low, high = (100.0 * (end / estimate.value - 1.0) for end in estimate.ci95)
        panel.plot(sorted((low, high)), (at, at), "|-", lw=2, ms=12, mew=2, color="C0")
        panel.plot(0.0, at, "o", ms=5, color="C0")
    panel.set_yticks(range(len(known)), [literal(estimate.name) for estimate in known])
    panel.set(xlabel="95 % interval, % of the value", ylim=(len(known) - 0.5, -0.5))
    return drawn


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


def selection_drawn(found: Identification) -> Figure:
    """Return a figure: for each term that was tried, the improvement of the score, and Kc and Bc with this term.

    The interval of the final result is drawn beside Kc and Bc.
    """
    from matplotlib.patches import Patch

    steps = found.steps
    drawn, (gains, *parameters) = canvas(
        1, 3, (9, 1.4 + 0.36 * len(steps)), sharey=True, gridspec_kw={"width_ratios": [2, 1, 1]}
    )
    _draw_gains(steps, gains)
    for name, panel in zip(("Kc", "Bc"), parameters, strict=True):
        _draw_parameter(found, name, panel)
    said = {True: "included", False: "rejected"}
    handles = [Patch(label=label, **_style(included=included)) for included, label in said.items()]
    handles.append(Patch(color="0.5", alpha=0.3, lw=0, label="95 % interval of the result"))
    drawn.legend(handles=handles, loc="outside upper left", ncols=3, frameon=False)
    return drawn


def _draw_gains(steps: tuple[Step, ...], panel: Axes) -> None:
    for at, step in enumerate(steps):
        if math.isfinite(step.gain):
            panel.barh(at, step.gain, height=0.6, **_style(included=step.included))
    panel.axvline(0.0, color="0.5", lw=0.8)
    panel.set_xscale("symlog", linthresh=_LINEAR)
    plain_ticks(panel)
    names = [step.term if at == 0 else f"+ {step.term}" for at, step in enumerate(steps)]
    panel.set_yticks(range(len(steps)), [literal(name) for name in names])
    panel.set(xlabel="gain of the term (above 0: it pays)", ylim=(len(steps) - 0.5, -0.5))


def _style(*, included: bool) -> dict[str, Any]:
    """Return the style of a term's bar: included and rejected terms differ in colour and in pattern."""
    return {"color": "C0"} if included else {"facecolor": "none", "edgecolor": "C3", "hatch": "////"}


def _draw_parameter(found: Identification, name: str, panel: Axes) -> None:
    estimate = found[name]
    factor, unit = people_unit(estimate.unit, milli=milli(found))
    if np.isfinite(estimate.ci95).all():
        panel.axvspan(*(factor * end for end in estimate.ci95), color="0.5", alpha=0.3, lw=0)
    for at, step in enumerate(found.steps):
        filled = "C0" if step.included else "none"
        panel.plot(factor * getattr(step, name), at, "o", ms=6, mfc=filled, mec="C0" if step.included else "C3")
    panel.set(xlabel=f"{name} with it [{unit}]")


def selection_text(found: Identification) -> str:
    """Return the steps of the model selection in words."""
    said = [
        f"{step.term} {step.gain:.3g} ({'included' if step.included else 'rejected'})"
        for step in found.steps
        if math.isfinite(step.gain)
    ]
    begun = f"Model selection began with {found.steps[0].term} and ended with {found.model.name}."
    return f"{begun} Gain of each term beside it: {', '.join(said)}." if said else begun
