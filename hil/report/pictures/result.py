"""The figures of an identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.report.formatting import people_unit
from hil.report.html_page import Picture
from hil.report.identification import headline, milli
from hil.report.pictures import checks, estimates, search
from hil.report.pictures.canvas import GRID
from hil.report.pictures.traces import Traces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.identification.result import Identification
    from hil.uncertainty.dynamic_stiffness import Bands


def figure(found: Identification) -> Figure:
    """Return one figure with everything: torque and model over time, residuals, torque over deflection, lack of fit,
    dynamic stiffness.

    A line is interrupted between recordings and at gaps.
    """
    from matplotlib.figure import Figure

    traces = Traces.of(found)
    drawn = Figure(figsize=(10, 9), layout="constrained")
    panels = drawn.subplot_mosaic(
        [
            ["torque", "torque", "loop"],
            ["residuals", "residuals", "loop"],
            ["correlation", "plane", "dynamic"],
        ],
        height_ratios=[2, 1, 1.5],
    )
    traces.draw(panels["torque"], panels["residuals"])
    panels["torque"].set_title(headline(found), pad=24)
    traces.draw_loop(panels["loop"])
    factor = people_unit("N*m", milli=milli(found))[0]
    checks.draw_correlation(found.lack_of_fit, panels["correlation"])
    checks.draw_plane(found.lack_of_fit, panels["plane"], factor, traces.unit)
    checks.draw_stiffness(found.dynamic_stiffness, panels["dynamic"], factor, f"{traces.unit}/rad")
    for name in ("torque", "residuals", "loop", "correlation", "dynamic"):
        panels[name].grid(visible=True, lw=GRID)
    return drawn


def pictures(found: Identification) -> list[Picture]:
    """Return all pictures of a result, each with its numbers in words."""
    drawn = [*fit_pictures(found), *_residual_pictures(found)]
    text = estimates.intervals_text(found)
    drawn.append(Picture("intervals", "Intervals", text, lambda: estimates.intervals_drawn(found)))
    if found.steps:
        text = estimates.selection_text(found)
        drawn.append(Picture("selection", "Model selection", text, lambda: estimates.selection_drawn(found)))
    if found.dynamic_stiffness is not None:
        text = _dynamic_text(found, found.dynamic_stiffness.bands)
        drawn.append(Picture("dynamic", "Dynamic stiffness", text, lambda: checks.dynamic_stiffness_drawn(found)))
    text = search.convergence_text(found)
    drawn.append(Picture("convergence", "Convergence of the search", text, lambda: search.convergence_drawn(found)))
    if search.has_landscape(found):
        text = search.landscape_text(found)
        drawn.append(Picture("landscape", "Fitness landscape", text, lambda: search.landscape_drawn(found)))
    return drawn


def fit_pictures(found: Identification) -> list[Picture]:
    """Return two pictures of measured and modelled torque: over time, and over the deflection."""
    traces = Traces.of(found)
    light = traces.thinned()
    return [
        Picture(
            "traces",
            "Torque, measured and modelled",
            f"Torque at the joint over time with the model {found.model.name}; "
            f"they differ by {traces.error} on average.",
            light.drawn,
            traces.chart(),
        ),
        Picture(
            "loop",
            "Torque over deflection",
            f"The loop of torque over deflection, measured and modelled: its slope is Kc, its width is friction and "
            f"damping. {headline(found)}.",
            lambda: traces.pieces().loop_drawn(),
        ),
    ]


def _residual_pictures(found: Identification) -> list[Picture]:
    text = checks.residuals_text(found)
    drawn = [Picture("residuals", "Residuals", text, lambda: checks.residuals_drawn(found))]
    if found.lack_of_fit is not None:
        words = "the model does not describe the recording" if found.lack_of_fit.misfit else "no misfit was found"
        share = f"the motion predicts {found.lack_of_fit.share:.1%} of their power"
        text = f"Residuals beside the earlier motion, and over deflection and rate: {words}; {share}."
        heading = "Does the model describe the recording?"
        drawn.append(Picture("fit", heading, text, lambda: checks.lack_of_fit_drawn(found)))
    return drawn


def _dynamic_text(found: Identification, bands: Bands) -> str:
    """Return stiffness, damping and coherence in the bands in words."""
    factor, unit = people_unit("N*m", milli=milli(found))
    ranges = (
        f"{name} {factor * float(values.min()):.4g} to {factor * float(values.max()):.4g} {of}"
        for name, values, of in (
            ("stiffness", bands.stiffness, f"{unit}/rad"),
            ("damping", bands.damping, f"{unit} s/rad"),
        )
    )
    span = f"from {bands.frequency[0]:.2g} to {bands.frequency[-1]:.3g} Hz"
    return (
        f"Without a model, in {len(bands.frequency)} bands {span}: {' and '.join(ranges)}, with 95 % intervals; "
        f"coherence {float(bands.coherence.min()):.4f} at least."
    )
