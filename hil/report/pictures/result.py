"""The pictures of an identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.report.chart import Chart, Panel
from hil.report.formatting import people_unit
from hil.report.html_page import Picture
from hil.report.identification import headline, milli
from hil.report.lack_of_fit import lack_of_fit_line
from hil.report.pictures import checks, estimates, search
from hil.report.pictures.canvas import mosaic
from hil.report.pictures.traces import Traces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.identification.misfit.dynamic_stiffness import DynamicStiffness
    from hil.identification.result import Identification

NAMES = ("loop", "traces", "residuals", "fit", "intervals", "selection", "dynamic", "convergence", "landscape")
"""The names of all pictures, of which a result has most."""


def figure(found: Identification) -> Figure:
    """Return one figure with everything: torque and model over time, residuals, torque over deflection, lack of fit,
    dynamic stiffness. Raises WrongUse without matplotlib.

    A line is interrupted between recordings and at gaps.
    """
    traces = Traces.of(found)
    factor, unit = people_unit("N*m", milli=milli(found))
    torque, residuals = traces.panels()
    misfit, dynamic = found.lack_of_fit, found.dynamic_stiffness
    panels: dict[str, Panel | None] = {
        "torque": torque,
        "residuals": residuals,
        "loop": traces.loop(),
        "correlation": checks.correlation_panel(misfit) if misfit else None,
        "plane": checks.plane_panel(misfit, factor, unit) if misfit else None,
        "dynamic": checks.stiffness_panel(dynamic, factor, f"{unit}/rad") if dynamic else None,
    }
    layout = [["torque", "torque", "loop"], ["residuals", "residuals", "loop"], ["correlation", "plane", "dynamic"]]
    drawn = mosaic(layout, panels, height_ratios=[2, 1, 1.5])
    drawn.suptitle(headline(found))
    return drawn


def pictures(found: Identification) -> list[Picture]:
    """Return all pictures of a result, each with its numbers in words."""
    text = checks.residuals_text(found)
    shown = [*fit_pictures(found), Picture("residuals", "Residuals", text, lambda: checks.residuals_chart(found))]
    if (misfit := found.lack_of_fit) is not None:
        text = f"Residuals beside the earlier motion, and over deflection and rate: {lack_of_fit_line(misfit)}."
        heading = "Does the model describe the recording?"
        shown.append(Picture("fit", heading, text, lambda: checks.lack_of_fit_chart(found, misfit)))
    text = estimates.intervals_text(found)
    shown.append(Picture("intervals", "Intervals", text, lambda: estimates.intervals_chart(found)))
    if found.steps:
        text = estimates.selection_text(found)
        shown.append(Picture("selection", "Model selection", text, lambda: estimates.selection_chart(found)))
    if (dynamic := found.dynamic_stiffness) is not None:
        text = _dynamic_text(found, dynamic)
        chart = lambda: checks.dynamic_stiffness_chart(found, dynamic)  # noqa: E731 - as the others
        shown.append(Picture("dynamic", "Dynamic stiffness", text, chart))
    return [*shown, *_search_pictures(found)]


def _search_pictures(found: Identification) -> list[Picture]:
    factor, unit = people_unit("N*m", milli=milli(found))
    shown = []
    if search.is_of_one_fitness(found):
        text = search.convergence_text(found)
        chart = lambda: search.convergence_chart(found.trials, found.optimum, factor, unit)  # noqa: E731 - as above
        shown.append(Picture("convergence", "Convergence of the search", text, chart))
    if search.has_landscape(found):
        text = search.landscape_text(found)
        shown.append(Picture("landscape", "Fitness landscape", text, lambda: search.landscape_chart(found)))
    return shown


def fit_pictures(found: Identification) -> list[Picture]:
    """Return two pictures of measured and modelled torque: over the deflection, and over time."""
    traces = Traces.of(found)
    return [
        Picture(
            "loop",
            "Torque over deflection",
            f"The loop of torque over deflection, measured and modelled: its slope shows the stiffness, its width "
            f"friction and damping. {headline(found)}.",
            lambda: Chart([traces.loop()]),
        ),
        Picture(
            "traces",
            "Torque, measured and modelled",
            f"Torque at the joint over time with the model {found.model.name}; "
            f"they differ by {traces.error} on average.",
            traces.chart,
        ),
    ]


def _dynamic_text(found: Identification, bands: DynamicStiffness) -> str:
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
