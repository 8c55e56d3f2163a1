"""Compile the search of the `default` preset ahead of its use: `python -m ga.trials.ahead`, in a separate process.

Half of the compilation in a first run is the search, which comes last. A second process compiles the search while the
first process prepares the recording and selects the model; `ga.compiled` prevents that both compile the same function.
"""

from __future__ import annotations

import numpy as np

from ga.bounds import Bounds
from ga.compiled import is_compiled
from ga.evolution.evolution import PRESETS, advance, begin
from ga.evolution.generational import generational
from ga.fitness.dense import pack
from ga.model.memory import lagged, presliding
from ga.start import Start
from ga.trials.trials import run_trials


def is_worthwhile() -> bool:
    """Return whether the search is not compiled yet."""
    return not is_compiled(generational)


def compile_search() -> None:
    """Compile the search by running a search with three parameters. The functions that take longest come first.

    The first process compiles the short functions itself if it needs them before this process comes to them.
    """
    angle, settings = np.linspace(0.0, 20.0, 200), PRESETS["default"]
    columns = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(angle)])
    torque, bounds = columns @ np.ones(3) + 0.01 * angle, Bounds(np.full(3, -2.0), np.full(3, 2.0))
    engine, start = pack(columns, torque), Start(np.zeros(3), np.eye(3), np.eye(3), 1.0)
    population = begin(engine, bounds, settings, 0, 0, start=start)
    advance(engine, bounds, settings, population, until=1)
    run_trials(columns, torque, bounds, settings, trials=1, seed=0, workers=1)


def compile_states() -> None:
    """Compile the functions of model selection and averaging. The last needed come first, because the first process
    begins with those needed first.
    """
    time = np.linspace(0.0, 1.0, 200)
    lagged(time, time, 0.1)
    presliding(time, time, 0.1)


if __name__ == "__main__":
    compile_search()
    compile_states()
