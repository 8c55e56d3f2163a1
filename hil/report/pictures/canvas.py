"""Draw charts with matplotlib, for files and for notebooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import WrongUse
from hil.report.chart import Chart, Heat, Line, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = {"soft": "0.65", "first": "C0", "error": "C3", "good": "C2", "ink": "C1"}
_PANEL = (9.0, 3.6)
"""Width of a chart and height of a row of its panels, inches."""


def check_matplotlib() -> None:
    """Raise WrongUse if matplotlib, which draws PNG files and figures, is not installed."""
    try:
        import matplotlib as mpl
    except ImportError:
        raise WrongUse(
            "matplotlib draws these pictures and is not installed: pip install 'hil[plot]'; --report needs nothing more"
        ) from None
    mpl.rcParams["axes.formatter.useoffset"] = False


def drawn(chart: Chart) -> Figure:
    """Return a figure of a chart. Raises WrongUse without matplotlib."""
    check_matplotlib()
    from matplotlib.figure import Figure

    rows = -(-len(chart.panels) // chart.columns)
    figure = Figure(figsize=(_PANEL[0], _PANEL[1] * rows), layout="constrained")
    places = np.ravel(figure.subplots(rows, chart.columns, squeeze=False, sharex="col" if chart.common else False))
    for panel, axes in zip(chart.panels, places, strict=False):
        draw_panel(panel, axes)
    return figure


def mosaic(layout: Sequence[Sequence[str]], panels: Mapping[str, Panel | None], **settings: Any) -> Figure:
    """Return a figure with panels in the places that `layout` names. settings: arguments of matplotlib's
    subplot_mosaic. Raises WrongUse without matplotlib.
    """
    check_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 3.0 * len(layout)), layout="constrained")
    places = figure.subplot_mosaic([list(row) for row in layout], **settings)
    for name, axes in places.items():
        if (panel := panels[name]) is None:
            axes.set_axis_off()
        else:
            draw_panel(panel, axes)
    return figure


def literal(text: str) -> str:
    """Return the text with every $ escaped, because two $ would begin a formula in a figure."""
    return text.replace("$", r"\$")


def draw_panel(panel: Panel, axes: Axes) -> None:
    """Draw a panel."""
    if panel.heat is None:
        axes.grid(visible=True, lw=0.3)
    else:
        _draw_heat(panel.heat, axes)
    for band in panel.bands:
        axes.axhspan(band.low, band.high, color="0.5", alpha=0.3, lw=0, label=literal(band.name) or None)
    for line in panel.lines:
        _draw_line(line, axes)
    for scale, setter in ((panel.x_scale, axes.set_xscale), (panel.scale, axes.set_yscale)):
        if scale != "linear":
            setter(scale)
    axes.set(xlabel=literal(panel.x_label), ylabel=literal(panel.label), title=literal(panel.title))
    if panel.names:
        axes.set_xticks(range(len(panel.names)), [literal(name) for name in panel.names], rotation=30, ha="right")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", frameon=False)


def _draw_line(line: Line, axes: Axes) -> None:
    colour, label = _COLOURS[line.colour], literal(line.name) or None
    if not line.mark:
        axes.plot(line.x, line.y, lw=line.width, ls="--" if line.dashed else "-", color=colour, label=label)
    else:
        filled = colour if line.mark == "dot" else "none"
        axes.plot(line.x, line.y, "o", ms=5, mfc=filled, mec=colour, label=label)
    if line.ends is not None:
        axes.vlines(line.x, *line.ends, color=colour, lw=1.2)


def _draw_heat(heat: Heat, axes: Axes) -> None:
    limit = float(np.nanmax(np.abs(heat.values))) or 1.0
    range_ = {"cmap": "RdBu", "vmin": -limit, "vmax": limit} if heat.two_sided else {"cmap": "Blues_r"}
    image = axes.imshow(heat.values, origin="lower", extent=heat.extent, aspect="auto", **range_)
    axes.figure.colorbar(image, ax=axes, label=literal(heat.label))
