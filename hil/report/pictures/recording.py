"""The pictures of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.recording.channels import LARGEST
from hil.report.chart import Chart, Line, Panel
from hil.report.pictures.canvas import mosaic
from hil.report.pictures.thinning import in_order, loop_pieces, trace_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Channels = Mapping[str, NDArray[np.float64]]


def recording_figure(channels: Channels, units: Mapping[str, str]) -> Figure:
    """Return a figure of channels (n,), SI: command, torque and deflection over time, and torque over deflection.
    Raises WrongUse without matplotlib.
    """
    *over_time, loop = _panels(channels, units)
    names = ("command", "torque", "dtheta")
    layout = [[name, "loop"] for name in names]
    return mosaic(layout, dict(zip((*names, "loop"), (*over_time, loop), strict=True)), width_ratios=[2, 1])


def recording_chart(channels: Channels, units: Mapping[str, str]) -> Chart:
    """Return a chart of command, torque and deflection over time, and torque over deflection, one below the other."""
    return Chart(_panels(channels, units))


def _panels(channels: Channels, units: Mapping[str, str]) -> list[Panel]:
    known = {name: np.where(np.abs(values) < LARGEST, values, np.nan) for name, values in channels.items()}
    rows, time = trace_rows(known["torque"], known["dtheta"]), in_order(known["time"])
    labels = {"command": "command", "torque": "torque at the joint", "dtheta": "deflection"}
    shown = time[rows]
    panels = [
        Panel("time [s]", f"{label} [{units[name].replace('*', ' ')}]", [Line("", shown, known[name][rows])])
        for name, label in labels.items()
    ]
    dtheta, torque = loop_pieces(known["dtheta"], known["torque"])
    loop = Line("", dtheta, torque, width=0.6)
    return [*panels, Panel("deflection [rad]", "torque at the joint [N m]", [loop], title="torque over deflection")]
