"""Pictures of the measured torque and the model's torque: over time, and over the deflection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import lag_of
from hil.report.chart import Chart, Line, Panel
from hil.report.formatting import people_unit
from hil.report.identification import milli
from hil.report.pictures.thinning import in_order, loop_pieces, trace_rows

if TYPE_CHECKING:
    from hil.identification.result import Identification

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Traces:
    """The signals of a result for pictures: arrays (n,), NaN where a line is interrupted.

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
        """Return the signals of a result for pictures; lines are interrupted between recordings and at gaps."""
        motion, torque, model = found.signals.motion, found.signals.torque, modelled(found)
        factor, unit = people_unit("N*m", milli=milli(found))
        time, measured, calculated, residuals, dtheta = (
            _broken(values, motion.starts)
            for values in (motion.time, torque * factor, model * factor, (torque - model) * factor, motion.dtheta)
        )
        return cls(time, measured, calculated, residuals, dtheta, unit, found.model.name)

    @property
    def error(self) -> str:
        """Return the mean absolute residual, with the unit."""
        return f"{float(np.nanmean(np.abs(self.residuals))):.3g} {self.unit}"

    def panels(self) -> tuple[Panel, Panel]:
        """Return panels of measured and modelled torque over time, and of the residuals over time."""
        rows = trace_rows(self.measured, self.modelled, self.residuals)
        time = in_order(self.time)[rows]
        torque = [
            Line("measured", time, self.measured[rows], "soft", width=2.0),
            Line(f"model {self.model}", time, self.modelled[rows]),
        ]
        error = [Line("error", time, self.residuals[rows], "error", width=0.6)]
        return (
            Panel("time [s]", f"torque at the joint [{self.unit}]", torque),
            Panel("time [s]", f"error [{self.unit}]", error),
        )

    def chart(self) -> Chart:
        """Return measured torque, modelled torque and residuals over time."""
        return Chart(self.panels(), common=True)

    def loop(self) -> Panel:
        """Return a panel of measured and modelled torque over the deflection."""
        dtheta, measured, calculated = loop_pieces(self.dtheta, self.measured, self.modelled)
        lines = [
            Line("measured", dtheta, measured, "soft", width=2.0),
            Line(f"model {self.model}", dtheta, calculated, width=0.6),
        ]
        return Panel("deflection [rad]", f"torque at the joint [{self.unit}]", lines)


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
    lag = lag_of(*values[:2].tolist()) if found.model.needs_ratio else 0.0
    columns = found.model.columns(signals.motion, nonlinear, lag)
    return columns, found.model.target(signals.motion, signals.torque, nonlinear)


def _broken(values: Array, starts: tuple[int, ...]) -> Array:
    """Return values with a NaN before each piece except the first, so that a drawn line is interrupted there."""
    return np.insert(values, starts[1:], np.nan)
