"""Predict the time that a search will take."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ga.bounds import Bounds
from ga.evolution.evolution import Settings
from ga.trials.trials import duration
from hil.recording.ahead import Progress
from hil.signals import constants as c

Array = NDArray[np.float64]


def forecast(
    columns: Array,
    torque: Array,
    bounds: Bounds,
    settings: Settings,
    *,
    trials: int,
    workers: int,
    progress: Progress,
) -> None:
    """Report the predicted duration of a long steady-state search, measured on a short one.

    For a resumed search, the part that is already done is subtracted.
    """
    if settings.generations < c.LONG_SEARCH:
        return
    seconds = duration(columns, torque, bounds, settings, trials=trials, workers=workers)
    count = f"{trials * settings.generations:,} evaluations"
    progress(f"searching with {count}: about {_in_words(seconds)}; Ctrl-C ends it and keeps its result", math.nan)


def _in_words(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} minutes"
