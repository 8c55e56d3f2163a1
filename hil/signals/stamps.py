"""Time stamps of a recording: repeats spread, gapless stretches, rows of a block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_COARSE = 0.05  # share of repeated stamps above which a clock is called coarse
_APART = 4.0  # median steps between two samples above which they belong to two stretches
_SHORTEST = 8  # samples of a stretch, below which nothing is interpolated on it


def spread_stamps(time: Array) -> tuple[Array, bool]:
    """Return the stamps (n,) s with repeats spread evenly up to the next stamp, and whether repeats are many.

    A clock that ticks every 15.6 ms gives several rows one stamp; their order is known and their spacing is even to
    within the loop's own jitter. The rows of the last stamp continue at the rate of the rows before.
    """
    starts = np.flatnonzero(np.concatenate(([True], np.diff(time) > 0.0)))
    if len(time) - len(starts) == 0:
        return time, False
    rows = np.arange(len(time), dtype=np.float64)
    last, before = starts[-1], starts[max(0, len(starts) - 50)]
    pace = (time[last] - time[before]) / max(last - before, 1)
    anchors = np.append(starts.astype(np.float64), len(time))
    at_anchors = np.append(time[starts], time[last] + pace * (len(time) - last))
    return np.interp(rows, anchors, at_anchors), (len(time) - len(starts)) > _COARSE * len(time)


def stretches(time: Array, sound: NDArray[np.bool_], step: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return where each gapless stretch of sound samples begins, and which samples (n,) are in one long enough."""
    places = np.flatnonzero(sound)
    breaks = np.flatnonzero((np.diff(places) > 1) & (np.diff(time[places]) > _APART * step)) + 1
    parts = [part for part in np.split(places, breaks) if len(part) >= _SHORTEST]
    kept = np.zeros(len(time), dtype=bool)
    for part in parts:
        kept[part] = True
    return np.array([part[0] for part in parts], dtype=np.int64), kept


def starts_within(starts: NDArray[np.int64], kept: NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the starts as indices into the samples that are kept."""
    counted = np.unique(np.concatenate([[0], np.cumsum(kept)[starts] - kept[starts]]))
    return tuple(counted[counted < np.count_nonzero(kept)].tolist()) or (0,)


def within(row: NDArray[np.int64], rows: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which rows (n,) of a file are from the first up to the second of `rows`."""
    return (row >= rows[0]) & (row < rows[1])
