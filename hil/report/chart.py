"""Charts that can be zoomed in a page. The browser draws them with uPlot, which is included in the page."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STEPS = 65_000  # of the range of the values: finer than any screen, and a quarter of the size of numbers in words
_MISSING = 65_535  # stands for a NaN


@dataclass(frozen=True, slots=True)
class Line:
    """A line in a panel of a chart. values: (n,), NaN where the line is interrupted. colour: "soft", "first" or
    "error".
    """

    name: str
    values: Array
    colour: str


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel of a chart: several lines. label: of the vertical axis, with the unit."""

    label: str
    lines: Sequence[Line]


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart that can be zoomed: panels one above the other, with a common horizontal axis.

    label: of the horizontal axis, with the unit. x: values on the horizontal axis (n,), in increasing order.
    """

    label: str
    x: Array
    panels: Sequence[Panel]

    def as_json(self) -> str:
        """Return the chart as JSON for the script in the page. Samples with NaN in x, between recordings, are left
        out.
        """
        kept = np.isfinite(self.x)
        order = np.flatnonzero(kept)[np.argsort(self.x[kept], kind="stable")]
        return json.dumps(
            {
                "label": self.label,
                "x": _packed(self.x[order]),
                "panels": [
                    {
                        "label": panel.label,
                        "lines": [
                            {"name": line.name, "colour": line.colour, **_packed(line.values[order])}
                            for line in panel.lines
                        ],
                    }
                    for panel in self.panels
                ],
            }
        ).replace("<", "\\u003c")


def _packed(values: Array) -> dict[str, Any]:
    """Return values as base64 of unsigned 16-bit numbers, scaled to the range of the values."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = (high - low) / _STEPS or 1.0
    counts = np.where(np.isfinite(values), np.round((np.nan_to_num(values, nan=low) - low) / step), _MISSING)
    data = base64.b64encode(counts.astype("<u2").tobytes()).decode()
    return {"low": low, "step": step, "data": data}


def library() -> dict[str, str]:
    """Return the texts that a page with charts contains: "script", "style" and "licence" of uPlot, and the script
    "start" of hil.
    """
    folder = resources.files("hil.report").joinpath("charts")
    names = {"script": "uPlot.min.js", "style": "uPlot.min.css", "licence": "LICENSE", "start": "charts.js"}
    return {part: folder.joinpath(name).read_text(encoding="utf-8") for part, name in names.items()}
