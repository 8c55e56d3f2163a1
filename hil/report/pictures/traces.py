"""Figures of the measured torque and the model's torque: over time, and over the deflection."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.report.chart import Chart, Line, Panel
from hil.report.formatting import people_unit
from hil.report.identification import milli
from hil.report.pictures.canvas import canvas, literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hil.identification.result import Identification

Array = NDArray[np.float64]

_SHOWN: Final = 300  # stretches of a recording in the pictures of a page
_CHARTED: Final = 1200  # stretches of it in the charts, which can be zoomed
_LOOP: Final = 2000  # samples of the loop in the pictures of a page
_RUN: Final = 8  # of them that follow each other: a line between others would cross the loop where nothing was measured
_ARRAYS: Final = ("time", "measured", "modelled", "residuals", "dtheta")


@dataclass(frozen=True, slots=True)
class Traces:
    """The signals of a result for figures: arrays (n,), NaN where a line is interrupted.

    time: s. measured, modelled, residuals: torques in `unit`. dtheta: deflection, rad. model: name of the model.
    """

    time: Array
    measured: Array
    modelled: Array
    residuals: Array
    dtheta: Array
    unit: str
    model: str

    @classmethod
    def of(cls, found: Identification) -> Traces:
        """Return the signals of a result for figures; lines are interrupted between recordings and at gaps."""
        motion, torque, model = found.signals.motion, found.signals.torque, modelled(found)
        factor, unit = people_unit("N*m", milli=milli(found))
        time, measured, calculated, residuals, dtheta = (
            _broken(values, motion.starts)
            for values in (motion.time, torque * factor, model * factor, (torque - model) * factor, motion.dtheta)
        )
        return cls(time, measured, calculated, residuals, dtheta, unit, literal(found.model.name))

    @property
    def error(self) -> str:
        """Return the mean absolute residual, with the unit."""
        return f"{float(np.nanmean(np.abs(self.residuals))):.3g} {self.unit}"

    def thinned(self, number: int = _SHOWN) -> Traces:
        """Return only the samples with the highest and the lowest residual in each of `number` intervals, so that a
        page loads quickly.
        """
        count = len(self.time)
        if count <= 2 * number:
            return self
        stretches = np.array_split(np.arange(count), number)
        residuals = np.nan_to_num(self.residuals)
        ends = [(one[residuals[one].argmin()], one[residuals[one].argmax()]) for one in stretches]
        return self._of(np.unique(np.concatenate([np.ravel(ends), np.flatnonzero(np.isnan(self.time))])))

    def pieces(self) -> Traces:
        """Return short pieces of the signals, evenly distributed, at most `_LOOP` samples in all; each piece is an
        uninterrupted line.
        """
        if len(self.time) <= _LOOP:
            return self
        firsts = np.linspace(0, len(self.time) - _RUN, _LOOP // _RUN).astype(np.intp)
        places = firsts[:, None] + np.arange(_RUN)
        broken: dict[str, Any] = {}
        for name in _ARRAYS:
            broken[name] = np.pad(getattr(self, name)[places], ((0, 0), (0, 1)), constant_values=np.nan).ravel()
        return replace(self, **broken)

    def _of(self, kept: NDArray[np.intp]) -> Traces:
        return replace(self, **{name: getattr(self, name)[kept] for name in _ARRAYS})

    def drawn(self) -> Figure:
        """Return a figure of measured torque, modelled torque and residuals over time."""
        figure, panels = canvas(2, 1, (9, 5), sharex=True, gridspec_kw={"height_ratios": [2, 1]})
        self.draw(*panels)
        return figure

    def draw(self, torque: Axes, residuals: Axes) -> None:
        """Draw measured and modelled torque over time into panel `torque`, and the residuals into panel `residuals`."""
        torque.plot(self.time, self.measured, lw=0.8, color="0.65", label="measured")
        torque.plot(self.time, self.modelled, lw=0.6, color="C0", label=self.model)
        torque.set(ylabel=f"torque at the joint [{self.unit}]")
        torque.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
        residuals.plot(self.time, self.residuals, lw=0.4, color="C3")
        residuals.set(xlabel="time [s]", ylabel=f"error [{self.unit}]")

    def loop_drawn(self) -> Figure:
        """Return a figure of measured and modelled torque over the deflection."""
        figure, (panel,) = canvas(1, 1, (9, 5))
        self.draw_loop(panel)
        panel.legend(loc="upper left")
        return figure

    def draw_loop(self, loop: Axes) -> None:
        """Draw measured and modelled torque over the deflection into panel `loop`."""
        loop.plot(self.dtheta, self.measured, lw=1.0, color="0.65", label="measured")
        loop.plot(self.dtheta, self.modelled, lw=0.6, color="C0", label=self.model)
        loop.set(xlabel="deflection [rad]", ylabel=f"torque at the joint [{self.unit}]")

    def chart(self) -> Chart | None:
        """Return the signals as a chart that can be zoomed; None for pooled recordings whose times overlap."""
        if not (np.diff(self.time[np.isfinite(self.time)]) > 0.0).all():
            return None
        light = self.thinned(_CHARTED)
        lines = [Line("measured", light.measured, "soft"), Line("model", light.modelled, "first")]
        errors = Panel(f"error [{self.unit}]", [Line("error", light.residuals, "error")])
        return Chart("time [s]", light.time, [Panel(f"torque [{self.unit}]", lines), errors])


def modelled(found: Identification) -> Array:
    """Return the model's torque, (n,) N m, for the measured motion."""
    columns, target = linear_problem(found)
    return np.asarray(found.signals.torque - target + columns @ found.values[: columns.shape[1]])


def linear_problem(found: Identification) -> tuple[Array, Array]:
    """Return the columns (n, p) of the linear parameters, and the torque (n,), N m, that these parameters must
    explain.
    """
    signals, p = found.signals, len(found.model.linear)
    values = found.values
    nonlinear = values[p:]
    lag = max(0.0, values[1] / values[0]) if found.model.needs_ratio and values[0] > 0.0 else 0.0
    columns = found.model.columns(signals.motion, nonlinear, lag)
    return columns, found.model.target(signals.motion, signals.torque, nonlinear)


def _broken(values: Array, starts: tuple[int, ...]) -> Array:
    """Return values with a NaN before each piece except the first, so that a drawn line is interrupted there."""
    return np.insert(values, starts[1:], np.nan)
