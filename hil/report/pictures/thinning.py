"""Choose the rows of a long recording that a page draws, so that its size does not grow with the recording."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PARTS: Final = 2000  # of a recording over time: with the extremes of each, zoomed four times, as many as a screen has
_LOOP: Final = 20_000  # samples of a loop: all of 20 s at 1 kHz
_PIECE: Final = 500  # of them that follow each other


def trace_rows(*signals: Array) -> NDArray[np.intp]:
    """Return the rows of the lowest and the highest value of each signal (n,) in each part of the recording, in
    order; every row of a short recording.

    A row with a NaN, at which lines are interrupted, is always returned.
    """
    count = len(signals[0])
    if count <= 2 * len(signals) * _PARTS:
        return np.arange(count)
    starts = np.linspace(0, count, _PARTS + 1).astype(np.intp)
    rows = [np.flatnonzero(np.isnan(signals[0]))]
    for signal in signals:
        known = np.nan_to_num(signal)
        for first, end in pairwise(starts.tolist()):
            part = known[first:end]
            rows.append(first + np.array([part.argmin(), part.argmax()]))
    return np.unique(np.concatenate(rows))


def loop_pieces(*signals: Array) -> list[Array]:
    """Return signals (n,) for a line in which only samples that follow each other are joined.

    Of a long recording, only evenly distributed pieces without gaps are returned, each followed by a NaN.
    """
    count = len(signals[0])
    if count <= _LOOP:
        return list(signals)
    firsts = np.linspace(0, count - _PIECE, _LOOP // _PIECE).astype(np.intp)
    places = firsts[:, None] + np.arange(_PIECE)
    return [np.pad(one[places], ((0, 0), (0, 1)), constant_values=np.nan).ravel() for one in signals]


def in_order(time: Array) -> Array:
    """Return times (n,), s, in which each NaN, at which lines are interrupted, is replaced by the middle of its
    neighbours.
    """
    unknown = np.isnan(time)
    if not unknown.any() or unknown.all():
        return time
    rows = np.arange(len(time))
    return np.where(unknown, np.interp(rows, rows[~unknown], time[~unknown]), time)
