"""The function that measures the loops of slow torsion tests, and the class of its result."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil import units
from hil.api.wording import worded
from hil.errors import Untrustworthy, WrongUse
from hil.exchange.columns import Table, open_table
from hil.exchange.headings import listed, unit_of
from hil.hysteresis_curve.branches import Torsion
from hil.hysteresis_curve.measures import Measures, measure
from hil.recording.channels import LARGEST, TorqueScale
from hil.report.loops import hysteresis as hysteresis_report
from hil.report.pictures.canvas import drawn
from hil.signals.angle import unwrapped
from hil.signals.source import open_sources

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AnyPath = str | os.PathLike[str]
_FEWEST = 6  # rows of a test
_RECORDINGS = frozenset({".h5", ".hdf5", ".part"})


@dataclass(frozen=True, slots=True)
class HysteresisResult:
    """The result of `hysteresis`. `str(result)` is the answer: stiffness, and below it lost motion, play and loss.

    measures: all numbers. torque_scale: how well the torque's scale is known; its uncertainty is not in the numbers.
    """

    measures: Measures
    paths: tuple[Path, ...]
    torque_scale: TorqueScale

    def __repr__(self) -> str:
        return f"<{hysteresis_report.answers(self.measures)[0]}>"

    def __str__(self) -> str:
        return "\n".join(hysteresis_report.answers(self.measures))

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil hysteresis --json`."""
        return hysteresis_report.as_json(self.measures, self.torque_scale)

    def plot(self) -> Figure:
        """Return a figure of the loops: torque over angle."""
        return drawn(hysteresis_report.chart(self.measures))

    @worded
    def report(self, path: AnyPath, command: str = "", *, force: bool = True) -> Path:
        """Write the HTML report to `path` and return the path. command: printed in the report. Raises WrongUse."""
        measured = (self.measures, self.torque_scale)
        return hysteresis_report.write_page(*measured, self.paths, Path(path), command, force=force)


@worded
def hysteresis(
    runs: AnyPath | Sequence[AnyPath],
    *,
    rated: float | None = None,
    parts: Sequence[tuple[float, float]] = (),
    lost_motion: float | None = None,
    torque: str | None = None,
    dtheta: str | None = None,
    torque_unit: str | None = None,
    dtheta_unit: str | None = None,
) -> HysteresisResult:
    """Measure stiffness, lost motion, hysteresis, play and loss of slow torsion tests of one joint.

    runs: recordings of hil, or tables of torque and angle in the order in which they were read, without a time. rated,
    parts, lost_motion: torques, N m, as in `hil.hysteresis_curve.measures.measure`. torque, dtheta: the columns of a
    table; None: the only column whose heading has a unit of torque, or of an angle. torque_unit, dtheta_unit: the
    columns' units; None: the units in the headings. Raises WrongUse, and Untrustworthy if no branch loads the joint.
    """
    paths = [Path(run) for run in ([runs] if isinstance(runs, str | os.PathLike) else runs)]
    columns = (("torque", torque, torque_unit), ("angle", dtheta, dtheta_unit))
    scales: list[TorqueScale] = []
    tests = [
        _recording(path, scales) if path.suffix.lower() in _RECORDINGS else _table(path, columns) for path in paths
    ]
    return HysteresisResult(measure(tests, rated, parts, lost_motion), tuple(paths), TorqueScale.widest(scales))


def _recording(path: Path, scales: list[TorqueScale]) -> Torsion:
    with open_sources([path]) as (source,):
        source.verify()
        scales.append(source.torque_scale)
        names = ("torque", "dtheta", "command", "time")
        torque, angle, command, time = (source.recording.channel(name) for name in names)
    good = (np.abs(torque) < LARGEST) & (np.abs(angle) < LARGEST) & np.isfinite(time)
    known = bool(np.isfinite(command[good]).all() and np.ptp(command[good]) > 0.0) if good.any() else False
    return _test(path, torque[good], angle[good], command[good] if known else None, time[good])


def _table(path: Path, columns: Sequence[tuple[str, str | None, str | None]]) -> Torsion:
    table = open_table(path)
    titles = [_title(table, dimension, name) for dimension, name, _ in columns]
    factors = []
    for title, (dimension, _, given) in zip(titles, columns, strict=True):
        unit = given or unit_of(title, dimension)
        if unit is None:
            option = "--torque-unit" if dimension == "torque" else "--dtheta-unit"
            raise WrongUse(f"{path} does not say the unit of {title!r}: give it with {option}, or in the heading")
        factors.append(units.factor(dimension, unit))
    (torque, angle), _ = table.read(titles, ())
    good = (np.abs(torque) < LARGEST) & (np.abs(angle) < LARGEST)
    return _test(path, torque[good] * factors[0], angle[good] * factors[1])


def _title(table: Table, dimension: str, name: str | None) -> str:
    """Return the heading of the column `name`; without a name, of the only column with a unit of `dimension`."""
    if name is not None:
        return table.titles[table.place(name)]
    found = []
    for title in table.titles:
        try:
            found += [title] if unit_of(title, dimension) is not None else []
        except WrongUse:  # a unit of another dimension
            continue
    if len(found) != 1:
        option = "--torque" if dimension == "torque" else "--dtheta"
        has = f"{len(found)} columns" if found else "no column"
        raise WrongUse(
            f"{table.source} has {has} with a unit of {dimension}: name the column with {option}; it has "
            f"{listed(table.titles)}"
        )
    return found[0]


def _test(path: Path, torque: Any, angle: Any, command: Any = None, time: Any = (math.nan,)) -> Torsion:
    if len(torque) < _FEWEST or not np.ptp(torque) > 0.0 or not np.ptp(angle) > 0.0:
        raise Untrustworthy(
            f"{path}: torque or angle never changes in {len(torque)} rows with both, so there is no loop: check the "
            "columns, or load the joint"
        )
    return Torsion(str(path), torque, unwrapped(angle, torque)[0], command, float(np.ptp(time)))
