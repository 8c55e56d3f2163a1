"""A motion with fewer samples, for the genetic algorithm: it remembers and is delayed as the dense one is."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from ga.model.coupling import parse
from ga.model.separable import FEW, Problem, descend
from ga.model.trajectory import Motion
from hil.signals.rate.low_pass import low_pass_for
from hil.signals.rate.windows import window_for

Array = NDArray[np.float64]

OMEGA: Final = 2.0 * np.pi * 2.0
TIME: Final[Array] = 1e-3 * np.arange(20_000, dtype=np.float64)
FEWEST: Final = 600


def sine(time: Array = TIME) -> Motion:
    """A motion of 2 Hz, of which a quarter radian is 20 samples at 1 kHz."""
    wave = 0.2 * np.exp(1j * OMEGA * time)
    return Motion(time, wave.imag, OMEGA * wave.real, -(OMEGA**2) * wave.imag, np.zeros(len(time)))


def test_it_has_as_few_samples_as_interpolation_needs() -> None:
    coarse, chosen = sine().coarser(FEWEST)
    assert len(coarse.whole[0]) == pytest.approx(len(TIME) * 1e-3 * OMEGA / 0.25, rel=0.06)
    assert np.array_equal(coarse.time, TIME[chosen])


def test_it_keeps_no_fewer_samples_than_it_is_asked_for() -> None:
    coarse, chosen = sine().coarser(4000)
    assert len(coarse) == len(chosen) == 4000


@pytest.mark.parametrize("left_out", [slice(0, 0), slice(5003, 5990)])
def test_lag_friction_mean_and_delay_are_those_of_the_dense_motion(left_out: slice) -> None:
    used = np.ones(len(TIME), dtype=bool)
    used[left_out] = used[:7] = False
    motion = sine().of(used)
    coarse, chosen = motion.coarser(FEWEST)
    assert len(chosen) < len(motion) / 10
    whole, rows = motion.whole
    assert isinstance(rows, np.ndarray)
    sparse, kept = coarse.whole
    after = slice(20, -2)  # the states begin some samples later, and at the ends a mean is over what there is
    for constant in (0.005, 0.02):
        dense = whole.lagged(whole.dtheta, constant)[rows][chosen]
        assert sparse.lagged(sparse.dtheta, constant)[kept][after] == pytest.approx(dense[after], abs=2e-4)
        friction = whole.presliding(constant)[rows][chosen]
        assert sparse.presliding(constant)[kept][after] == pytest.approx(friction[after], abs=5e-3)
        late = motion.delayed(constant).dtheta[chosen]
        assert coarse.delayed(constant).dtheta[after] == pytest.approx(late[after], abs=2e-4)
        mean = motion.averaged(whole.dtheta, constant)[chosen]
        assert coarse.averaged(sparse.dtheta, constant)[after] == pytest.approx(mean[after], abs=2e-4)


def test_a_jerky_motion_stays_as_dense_as_it_is() -> None:
    square = np.sign(np.sin(OMEGA * TIME + 0.1))
    rate, acceleration = np.gradient(square, TIME), np.gradient(np.gradient(square, TIME), TIME)
    motion = Motion(TIME, square, rate, acceleration, np.zeros(len(TIME)))
    assert motion.coarser(FEWEST)[0] is motion


def test_a_stretch_that_would_lose_its_last_samples_keeps_all() -> None:
    motion = replace(sine(), starts=(0, 10_000, 10_200))
    assert motion.coarser(FEWEST)[0] is motion


def test_stretches_begin_at_their_first_sample_that_is_left() -> None:
    coarse, _ = replace(sine(), starts=(0, 9_990)).coarser(FEWEST)
    whole = coarse.whole[0]
    assert len(whole.starts) == 2
    assert 9.99 <= whole.time[whole.starts[1]] < 9.99 + 0.02


def test_the_torques_filter_passes_the_same_at_fewer_samples() -> None:
    rng = np.random.default_rng(0)
    window = window_for(TIME, sine().dtheta + 0.01 * rng.standard_normal(len(TIME)), sine().dtheta)
    assert window.low_pass is not None
    motion = replace(sine(), behind=window)
    coarse, chosen = motion.coarser(FEWEST)
    assert len(chosen) < len(TIME) / 10
    values = np.tanh(10.0 * np.sin(OMEGA * TIME))  # corners, as those of friction, which the filter rounds
    inside = slice(100, -100)
    dense = motion.filtered(values)[chosen]
    assert np.abs(dense - values[chosen])[inside].max() > 0.1
    assert coarse.whole[0].filtered(values[chosen])[inside] == pytest.approx(dense[inside], abs=0.03)


def test_no_samples_are_further_apart_than_the_filter_needs() -> None:
    found = low_pass_for(TIME, 40.0, 6)
    assert found is not None
    wave = np.exp(1j * 2.0 * np.pi * 64.0 * TIME)  # where the stop band begins
    every = int(found.longest_step / 1e-3)
    assert every >= 2
    for step in (1, every):
        weights = found.of_every(step).kernels()[0]
        middle = slice(0, len(weights) * step, step)
        assert abs(weights @ wave[middle]) < 2e-3
        assert weights.sum() == pytest.approx(1.0, abs=1e-12)


def test_a_sketch_has_the_genes_of_all_rows_and_its_lowest_place_where_theirs_is() -> None:
    """Dahl's friction and a branch, both of which remember, in two sines."""
    slow, fast = sine(0.31 * TIME), sine()
    both = Motion(
        TIME,
        fast.dtheta + slow.dtheta,
        fast.dtheta_dot + 0.31 * slow.dtheta_dot,
        fast.dtheta_ddot + 0.31**2 * slow.dtheta_ddot,
        np.zeros(len(TIME)),
    )
    model = parse("linear+maxwell+dahl").anchored(both)
    true = np.array([{"tau1": 0.05, "reach": 0.04}[parameter.name] for parameter in model.nonlinear])
    torque = model.columns(both, true) @ np.array([0.3, 0.003, 0.02, 0.1])
    problem = Problem(model, both, torque, *model.bounds(both, 3.0))
    sketch = problem.sketched(FEW)
    assert FEW <= len(sketch.torque) < 2 * FEW
    assert len(sketch.motion.whole[0]) < len(TIME) / 10
    assert sketch.solve(true).optimum.genes == pytest.approx(problem.solve(true).optimum.genes, rel=0.05)
    assert descend(sketch, 1.3 * true).nonlinear == pytest.approx(true, rel=0.1)
