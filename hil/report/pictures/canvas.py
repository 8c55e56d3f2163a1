"""Empty figures with panels, and functions that prepare text for figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GRID = 0.3
"""The width of grid lines, points."""


def canvas(rows: int, columns: int, size: tuple[float, float], **layout: Any) -> tuple[Figure, list[Axes]]:
    """Return an empty figure and its panels, row by row. size: inches. layout: arguments for matplotlib's subplots."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=size, layout="constrained")
    panels = list(np.ravel(drawn.subplots(rows, columns, squeeze=False, **layout)))
    for panel in panels:
        panel.grid(visible=True, lw=GRID)
    return drawn, panels


def literal(text: str) -> str:
    """Return the text with every $ escaped, because two $ would begin a formula in a figure."""
    return text.replace("$", r"\$")


def plain_ticks(*panels: Axes) -> None:
    """Label the logarithmic axes of the panels as 1e-04. The scale of the axes must be set before.

    Powers of ten as formulas take most of the time of drawing, and cannot be searched as text.
    """
    from matplotlib.ticker import LogFormatter

    for panel in panels:
        for axis in (panel.xaxis, panel.yaxis):
            if axis.get_scale() in {"log", "symlog"}:
                axis.set_major_formatter(LogFormatter())
            if axis.get_scale() == "log":
                axis.set_minor_formatter(LogFormatter(labelOnlyBase=False))
