"""Statistics of how late the set-points of a run were sent; the memory needed does not grow with the length of the
run.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Status
from hil.recording.channels import Rows

_EDGES: NDArray[np.float64] = np.geomspace(1e-7, 100.0, 4000)  # s, 0.5 % apart
_UPPER: NDArray[np.float64] = np.array([0.0, *_EDGES[1:], np.inf])
_MISSED = np.uint64(int(Status.MISSED))


class Lateness:
    """Collects the lateness of set-points, s: the time at which each was sent less the time at which it was planned.

    rate: of the set-points, Hz. Without a rate the lateness is NaN.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._counts = np.zeros(len(_EDGES) + 1, dtype=np.int64)
        self._most = 0.0
        self._missed = 0

    def add(self, rows: Rows) -> None:
        """Add rows, (n,) of ROW. Missed ticks are counted; rows without a time are skipped."""
        missed = (rows["status"] & _MISSED) != 0
        late = (rows["time"] - rows["seq"] / self._rate)[~missed]
        late = late[np.isfinite(late)]
        self._missed += int(missed.sum())
        self._counts += np.bincount(np.searchsorted(_EDGES, late), minlength=len(self._counts))
        self._most = max(self._most, float(late.max(initial=0.0)))

    def attributes(self) -> dict[str, float | int]:
        """Return the attributes that a recording stores: median and 99 % quantile, each within 0.5 %, the largest
        lateness (s), and the number of missed ticks.
        """
        quantiles = {f"lateness_p{percent}": self._quantile(percent / 100) for percent in (50, 99)}
        most = self._most if self._counts.any() else np.nan
        return quantiles | {"lateness_max": most, "missed": self._missed}

    def _quantile(self, share: float) -> float:
        """Return the quantile `share` of the lateness as the upper edge of its bin: 0 below the first bin, NaN without
        any tick.
        """
        if not self._counts.any():
            return np.nan
        place = int(np.searchsorted(np.cumsum(self._counts), share * self._counts.sum()))
        return min(float(_UPPER[place]), self._most)
