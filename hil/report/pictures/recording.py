"""The figure of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.recording.channels import LARGEST
from hil.report.pictures.canvas import GRID

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def recording_figure(channels: Mapping[str, NDArray[np.float64]], units: Mapping[str, str]) -> Figure:
    """Return a figure of channels (n,), SI: command, torque and deflection over time, and torque over deflection."""
    from matplotlib.figure import Figure

    channels = {name: np.where(np.abs(values) < LARGEST, values, np.nan) for name, values in channels.items()}
    drawn = Figure(figsize=(10, 6), layout="constrained")
    panels = drawn.subplot_mosaic([["command", "loop"], ["torque", "loop"], ["dtheta", "loop"]], width_ratios=[2, 1])
    for channel, label in (("command", "command"), ("torque", "torque at the joint"), ("dtheta", "deflection")):
        panels[channel].plot(channels["time"], channels[channel], lw=0.7)
        panels[channel].set(ylabel=f"{label} [{units[channel].replace('*', ' ')}]")
    panels["dtheta"].set(xlabel="time [s]")
    panels["loop"].plot(channels["dtheta"], channels["torque"], lw=0.4)
    panels["loop"].set(xlabel="deflection [rad]", ylabel="torque at the joint [N m]", title="torque over deflection")
    for panel in panels.values():
        panel.grid(visible=True, lw=GRID)
    return drawn
