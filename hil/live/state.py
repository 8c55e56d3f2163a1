"""The state of a run, from its rows so far: rate, jitter, lost replies, margins to the limits, first estimates of Kc
and Bc.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from hil.recording.channels import Rows

Array = NDArray[np.float64]

WINDOW = 5.0
"""The time that the traces show, s."""

_LOST = np.uint64(int(Status.NO_REPLY | Status.BAD_REPLY))
_MISSED = np.uint64(int(Status.MISSED))  # the drive was not asked: such a tick is late, and no reply of it is lost
_RECENT = 500  # intervals from which rate and jitter are taken
_FEWEST = 100  # rows for an estimate
_DISTINCT = 1e-8  # reciprocal condition from which the three columns are distinct


@dataclass(slots=True)
class LeastSquares:
    """Estimates Kc, Bc and an offset of the torque by recursive least squares over all rows so far.

    Only sums of products are stored (information form). So no starting covariance is needed, and no row is forgotten
    (Ljung 1999, section 11.2).
    """

    products: Array = field(default_factory=lambda: np.zeros((3, 3)))
    targets: Array = field(default_factory=lambda: np.zeros(3))
    count: int = 0

    def add(self, dtheta: Array, rate: Array, torque: Array) -> None:
        """Add rows (n,) of deflection, rad, its rate, rad/s, and torque, N m. Rows with a NaN are left out."""
        columns = np.stack([dtheta, rate, np.ones_like(dtheta)], axis=1)
        good = np.isfinite(columns).all(axis=1) & np.isfinite(torque)
        self.products += columns[good].T @ columns[good]
        self.targets += columns[good].T @ torque[good]
        self.count += int(good.sum())

    @property
    def estimate(self) -> tuple[float, float] | None:
        """Kc, N m/rad, and Bc, N m s/rad; None as long as the rows do not determine both."""
        size = np.sqrt(np.diag(self.products))
        if self.count < _FEWEST or not (size > 0.0).all():
            return None
        scaled = self.products / np.outer(size, size)
        if np.linalg.cond(scaled) > 1.0 / _DISTINCT:
            return None
        kc, bc, _ = np.linalg.solve(scaled, self.targets / size) / size
        return float(kc), float(bc)


@dataclass(frozen=True, slots=True)
class Margin:
    """The largest reading of a quantity so far, compared with its limit. unit: SI unit of reading and limit."""

    name: str
    reading: float
    limit: float
    unit: str

    @property
    def used(self) -> float:
        """The reading as a fraction of the limit; above 1 the run ends."""
        return self.reading / self.limit


class State:
    """The state of a run in progress. rows: the rows of its file. duration: planned, s. limits: by name, SI at the
    joint.
    """

    def __init__(self, rows: Rows, duration: float, limits: Mapping[str, float]) -> None:
        self._rows, self._limits = rows, limits
        self._duration = duration
        self.count = 0
        self.lost = 0
        self.fit = LeastSquares()
        self._peaks: dict[str, float] = {}

    def update(self) -> None:
        """Take over the rows that were written since the last call."""
        before, self.count = self.count, self._written()
        new = self._rows[before : self.count]
        if not len(new):
            return
        lost, missed = new["status"] & _LOST, new["status"] & _MISSED
        self.lost += int(np.count_nonzero((lost != 0) & (missed == 0)))
        # from the row before on, so that the rate has its difference
        part = self._rows[max(0, before - 1) : self.count]
        rate = np.array(part["dtheta_dot"])
        if not np.isfinite(rate).any() and len(part) > 2:
            rate = np.gradient(part["dtheta"], part["time"])
        self.fit.add(np.array(part["dtheta"]), rate, np.array(part["torque"]))
        for name, values in (("torque", new["torque"]), ("deflection", new["dtheta"]), ("velocity", new["dtheta_dot"])):
            self._peaks[name] = max(self._peaks.get(name, 0.0), _largest(values))
        warm = new["temperature"][np.isfinite(new["temperature"])]
        if len(warm):
            self._peaks["temperature"] = float(warm[-1])

    def since(self, first: int) -> Rows:
        """Return all rows so far, beginning with row number `first`."""
        return self._rows[first : self.count]

    @property
    def left(self) -> float:
        """The time until the planned end of the run, s."""
        return max(0.0, self._duration - self._elapsed)

    @property
    def _elapsed(self) -> float:
        return float(np.nanmax(self._recent)) if self.count else 0.0

    @property
    def _recent(self) -> Array:
        return np.array(self._rows[max(0, self.count - _RECENT) : self.count]["time"])

    @property
    def rate(self) -> float:
        """The sampling rate over the most recent samples, Hz; NaN before there are two samples."""
        recent = self._recent
        return (len(recent) - 1) / float(np.nanmax(recent) - np.nanmin(recent)) if len(recent) > 1 else math.nan

    @property
    def jitter(self) -> float:
        """The deviation of the recent sampling intervals from their median, s: 99 % deviate less. NaN before there are
        two samples.
        """
        steps = np.diff(self._recent)
        return float(np.nanquantile(np.abs(steps - np.nanmedian(steps)), 0.99)) if len(steps) else math.nan

    @property
    def margins(self) -> list[Margin]:
        """For each limit, the largest reading so far; for the temperature, the last reading."""
        units = {"torque": "N m", "deflection": "rad", "velocity": "rad/s", "temperature": "degC"}
        return [
            Margin(name, self._peaks[name], limit, units[name])
            for name, limit in self._limits.items()
            if name in self._peaks and limit > 0.0
        ]

    def points(self, first: str, second: str, most: int) -> tuple[Array, Array]:
        """Return two channels (m,) over the last `WINDOW` s, thinned to about `most` rows; rows with a NaN are left
        out.
        """
        begin = self.count - 1
        while begin > 0 and not self._elapsed - float(self._rows["time"][begin]) > WINDOW:
            begin -= min(begin, _RECENT)
        part = self._rows[max(0, begin) : self.count]
        part = part[:: max(1, len(part) // most)]
        good = np.isfinite(part[first]) & np.isfinite(part[second])
        return np.array(part[first][good]), np.array(part[second][good])

    @property
    def last(self) -> tuple[float, float]:
        """The last torque, N m, and deflection, rad; NaN if the last reply was lost."""
        return (float(self._rows["torque"][self.count - 1]), float(self._rows["dtheta"][self.count - 1]))

    def _written(self) -> int:
        """Return the number of rows written so far. A row is written if its `seq` equals its index; rows are written in
        order, so the last one is found by bisection.
        """
        low, high = self.count, len(self._rows)
        while low < high:
            middle = (low + high) // 2
            if self._rows["seq"][middle] == middle:
                low = middle + 1
            else:
                high = middle
        return low


def _largest(values: Array) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if len(finite) else 0.0
