"""The picture of a recording, before anything is identified from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


def recording_figure(name: str, channels: Mapping[str, Array], units: Mapping[str, str]) -> Figure:
    """Return the picture of channels (n,), SI: command, torque, deflection over time, and torque against deflection."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    panels = figure.subplot_mosaic([["command", "loop"], ["torque", "loop"], ["dtheta", "loop"]], width_ratios=[2, 1])
    labels = {"command": "command", "torque": "torque at the joint", "dtheta": "deflection"}
    for channel, label in labels.items():
        panels[channel].plot(channels["time"], channels[channel], lw=0.7)
        panels[channel].set(ylabel=f"{label} [{_shown(units[channel])}]")
    panels["command"].set(title=name)
    panels["dtheta"].set(xlabel="time [s]")
    panels["loop"].plot(channels["dtheta"], channels["torque"], lw=0.4)
    panels["loop"].set(xlabel="deflection [rad]", ylabel="torque at the joint [N m]", title="torque over deflection")
    for panel in panels.values():
        panel.grid(visible=True, lw=0.3)
    return figure


def _shown(unit: str) -> str:
    return unit.replace("*", " ")
