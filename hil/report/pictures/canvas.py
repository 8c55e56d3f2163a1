"""Empty pictures with their panels, and text for them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GRID = 0.3
"""Width of the lines of a grid, points."""


def canvas(rows: int, columns: int, size: tuple[float, float], **layout: Any) -> tuple[Figure, list[Axes]]:
    """Return a picture of that size, inches, with its panels row by row. layout: of matplotlib's subplots."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=size, layout="constrained")
    panels = list(np.ravel(drawn.subplots(rows, columns, squeeze=False, **layout)))
    for panel in panels:
        panel.grid(visible=True, lw=GRID)
    return drawn, panels


def literal(text: str) -> str:
    """Return the text for a picture, where two $ would begin a formula."""
    return text.replace("$", r"\$")


def plain_ticks(*panels: Axes) -> None:
    """Label the logarithmic axes of the panels, whose scale is set already, as 1e-04.

    Powers of ten set as formulas take most of the time that a picture takes, and are no text that can be searched.
    """
    from matplotlib.ticker import LogFormatter

    for panel in panels:
        for axis in (panel.xaxis, panel.yaxis):
            if axis.get_scale() in {"log", "symlog"}:
                axis.set_major_formatter(LogFormatter())
            if axis.get_scale() == "log":
                axis.set_minor_formatter(LogFormatter(labelOnlyBase=False))
