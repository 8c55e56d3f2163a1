"""Charts as data: the page of a report draws them with uPlot, `--plot` and `.plot()` with matplotlib."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Scale = Literal["linear", "log", "symlog"]

_FEW = 200  # values that are shorter as numbers in words than as the range and steps of it
_STEPS = 65_000  # of the range of the values: finer than any screen, and a quarter of the size of numbers in words
_MISSING = 65_535  # stands for a NaN


@dataclass(frozen=True, slots=True)
class Line:
    """A line, or points, in a panel.

    name: in the legend, "" for none. x, y: (n,), NaN where the line is interrupted. colour: "soft", "first", "error",
    "good" or "ink". mark: "" for a line, "dot" or "ring" for points. ends: lower and upper ends (2, n) of an interval
    at each point, None without intervals. width: points. dashed: whether the line is dashed.
    """

    name: str
    x: Array
    y: Array
    colour: str = "first"
    mark: str = ""
    ends: Array | None = None
    width: float = 1.0
    dashed: bool = False


def with_intervals(points: Sequence[tuple[float, float, float]], name: str = "", colour: str = "first") -> Line:
    """Return a line of dots with intervals. points: for each dot, its place on the horizontal axis, its value, and half
    of its interval.
    """
    x, y, half = np.array(points, np.float64).reshape(-1, 3).T
    return Line(name, x, y, colour, mark="dot", ends=np.array([y - half, y + half]))


@dataclass(frozen=True, slots=True)
class Band:
    """A shaded range of the vertical axis, from `low` to `high`. name: in the legend, "" for none."""

    low: float
    high: float
    name: str = ""


@dataclass(frozen=True, slots=True)
class Heat:
    """A grid of values (rows, columns), drawn as shades; the first row is at the bottom.

    extent: left, right, lower and upper end of the grid on the axes. label: of the values, with the unit. two_sided:
    whether zero is in the middle of the shades.
    """

    values: Array
    extent: tuple[float, float, float, float]
    label: str
    two_sided: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel of a chart.

    x_label, label: of the horizontal and of the vertical axis, with the unit. x_scale, scale: of these axes. names: of
    the places 0, 1, ... on the horizontal axis, empty for numbers. bands, heat: drawn below the lines.
    """

    x_label: str
    label: str
    lines: Sequence[Line] = ()
    title: str = ""
    x_scale: Scale = "linear"
    scale: Scale = "linear"
    names: Sequence[str] = ()
    bands: Sequence[Band] = ()
    heat: Heat | None = None


@dataclass(frozen=True, slots=True)
class Chart:
    """Panels, `columns` of them side by side. common: whether their horizontal axes are zoomed together."""

    panels: Sequence[Panel]
    columns: int = 1
    common: bool = False

    def as_json(self) -> str:
        """Return the chart as JSON for the script in the page. Lines with the same array of x share it."""
        arrays: dict[int, int] = {}
        packed: list[Any] = []

        def place(values: Array, scale: Scale) -> int:
            if id(values) not in arrays:
                arrays[id(values)] = len(packed)
                packed.append(_packed(values, logarithm=scale == "log"))
            return arrays[id(values)]

        panels = [_panel(panel, place) for panel in self.panels]
        table = {"columns": self.columns, "common": self.common, "arrays": packed, "panels": panels}
        return json.dumps(table).replace("<", "\\u003c")


def _panel(panel: Panel, place: Any) -> dict[str, Any]:
    lines = [
        {
            "name": line.name,
            "colour": line.colour,
            "mark": line.mark,
            "width": line.width,
            "dashed": line.dashed,
            "x": place(line.x, panel.x_scale),
            "y": place(line.y, panel.scale),
            "ends": None if line.ends is None else [_plain(end) for end in line.ends],
        }
        for line in panel.lines
    ]
    heat = panel.heat
    return {
        "xLabel": panel.x_label,
        "label": panel.label,
        "title": panel.title,
        "xScale": panel.x_scale,
        "scale": panel.scale,
        "names": list(panel.names),
        "shared": len({id(line.x) for line in panel.lines}) == 1 and all(map(_is_plain_line, panel.lines)),
        "lines": lines,
        "bands": [{"low": float(one.low), "high": float(one.high), "name": one.name} for one in panel.bands],
        "heat": heat
        and {
            "rows": [_plain(row) for row in heat.values],
            "extent": [float(end) for end in heat.extent],
            "label": heat.label,
            "twoSided": heat.two_sided,
        },
    }


def _is_plain_line(line: Line) -> bool:
    """Return whether the browser's library draws this line by itself: it needs x in increasing order."""
    return not line.mark and bool((np.diff(line.x) > 0.0).all())


def _plain(values: Array) -> list[float | None]:
    """Return values as numbers of six digits, None for a NaN or an infinity."""
    return [float(f"{one:.6g}") if np.isfinite(one) else None for one in values.tolist()]


def _packed(values: Array, *, logarithm: bool) -> list[float | None] | dict[str, Any]:
    """Return values as numbers or, if there are many, as base64 of unsigned 16-bit numbers scaled to their range.

    logarithm: scale the logarithms; a value that has none is missing.
    """
    if len(values) <= _FEW:
        return _plain(values)
    scaled = np.log10(np.where(values > 0.0, values, np.nan)) if logarithm else values
    known = scaled[np.isfinite(scaled)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = (high - low) / _STEPS or 1.0
    counts = np.where(np.isfinite(scaled), np.round((np.nan_to_num(scaled, nan=low) - low) / step), _MISSING)
    data = base64.b64encode(counts.astype("<u2").tobytes()).decode()
    return {"low": low, "step": step, "logarithm": logarithm, "data": data}


def library() -> dict[str, str]:
    """Return the texts that a page with charts contains: "script", "style" and "licence" of uPlot, and the script
    "start" of hil.
    """
    folder = resources.files("hil.report").joinpath("charts")
    names = {"script": "uPlot.min.js", "style": "uPlot.min.css", "licence": "LICENSE", "start": "charts.js"}
    return {part: folder.joinpath(name).read_text(encoding="utf-8") for part, name in names.items()}
