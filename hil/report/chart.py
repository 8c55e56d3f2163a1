"""Charts of a page that can be zoomed, drawn in the browser by uPlot, which is included in the page."""

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
    """A line of a panel: its values (n,), NaN if it is interrupted. colour: "soft", "first" or "error"."""

    name: str
    values: Array
    colour: str


@dataclass(frozen=True, slots=True)
class Panel:
    """Lines over a common axis; label: of their values, with the unit."""

    label: str
    lines: Sequence[Line]


@dataclass(frozen=True, slots=True)
class Chart:
    """Panels, one above the other, over one axis. x: (n,), in order. label: of the axis, with the unit."""

    label: str
    x: Array
    panels: Sequence[Panel]

    def as_json(self) -> str:
        """Return the chart for the script of the page. Samples with NaN for x, between recordings, belong to no
        line.
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
    """Return values as unsigned 16-bit steps of their range, base64."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = (high - low) / _STEPS or 1.0
    counts = np.where(np.isfinite(values), np.round((np.nan_to_num(values, nan=low) - low) / step), _MISSING)
    data = base64.b64encode(counts.astype("<u2").tobytes()).decode()
    return {"low": low, "step": step, "data": data}


def library() -> dict[str, str]:
    """Return the parts that a page with charts needs: "script", "style" and "licence" of uPlot, and our "start"."""
    folder = resources.files("hil.report").joinpath("charts")
    names = {"script": "uPlot.min.js", "style": "uPlot.min.css", "licence": "LICENSE", "start": "charts.js"}
    return {part: folder.joinpath(name).read_text(encoding="utf-8") for part, name in names.items()}
