from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ga.bounds import bounds_from_data
from ga.evolution.evolution import PRESETS
from ga.evolution.generational import generational
from ga.fitness.engine import errors_of
from ga.model.memory import lag_behind, slide_along
from ga.model.trajectory import Motion
from ga.trials.ahead import compile_search, compile_states, is_worthwhile
from ga.trials.trials import run_trials

if TYPE_CHECKING:
    from tests.ga.conftest import Making

KERNELS: tuple[Any, ...] = (generational, errors_of)


def signatures() -> set[tuple[str, str]]:
    return {(one.py_func.__name__, str(signature)) for one in KERNELS for signature in one.signatures}


def test_a_search_of_a_recording_needs_nothing_that_was_not_compiled_ahead(made: Making) -> None:
    compile_search()
    ahead = signatures()
    assert {name for name, _ in ahead} == {one.py_func.__name__ for one in KERNELS}
    data = made([17.75e-3, 0.19e-3, 1e-3, 5e-4], noise=2e-4, count=1000, seed=0)
    bounds = bounds_from_data(data.columns, data.torque)
    run_trials(data.columns, data.torque, bounds, PRESETS["default"], trials=2, seed=0, workers=2)
    assert signatures() == ahead


def test_a_lag_and_friction_of_a_motion_need_nothing_that_was_not_compiled_ahead() -> None:
    states: tuple[Any, ...] = (lag_behind, slide_along)
    compile_states()
    ahead = [list(one.signatures) for one in states]
    time = np.linspace(0.0, 1.0, 100)
    motion = Motion(time, np.sin(9.0 * time), 9.0 * np.cos(9.0 * time), -81.0 * np.sin(9.0 * time), np.zeros(100))
    motion.lagged(motion.dtheta, 0.1)
    motion.presliding(0.1)
    assert [len(signatures) for signatures in ahead] == [1, 1]
    assert [list(one.signatures) for one in states] == ahead


def test_nothing_is_compiled_ahead_a_second_time() -> None:
    compile_search()
    assert not is_worthwhile()
