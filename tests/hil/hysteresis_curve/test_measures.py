"""The measures of a torsion test are those of the spring, friction and play that it was made with."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.errors import Untrustworthy
from hil.hysteresis_curve.branches import Torsion, reversals
from hil.hysteresis_curve.measures import measure

Array = NDArray[np.float64]
KC, PEAK = 500.0, 25.0


def torque(cycles: int = 2, rows: int = 4000) -> Array:
    phase = np.linspace(0.0, cycles, rows)
    return np.asarray(PEAK * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * phase)))


def played(set_torque: Array, friction: float, play: float = 0.0) -> Array:
    """The angle of a spring behind dry friction and play: it follows as far as the friction does not hold it."""
    elastic, angle = 0.0, []
    for one in set_torque:
        elastic = min(max(elastic, one - friction), one + friction)
        angle.append(elastic / KC + 0.5 * play * np.tanh(elastic / 0.02))
    return np.array(angle)


def made(friction: float = 0.0, play: float = 0.0, noise: float = 0.0, name: str = "a", cycles: int = 2) -> Torsion:
    set_torque = torque(cycles)
    read = set_torque + np.random.default_rng(1).normal(0.0, noise, len(set_torque))
    return Torsion(name, read, played(set_torque, friction, play))


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_friction_makes_the_loop_wide_and_leaves_the_loading_stiffness(noise: float) -> None:
    found = measure([made(friction=1.0, noise=noise)])
    assert found.loading.mean == pytest.approx(KC, rel=0.01)
    assert found.stiffness["unloading", "both", found.parts[-1]].mean > 1.005 * KC
    assert found.loops["hysteresis"].mean == pytest.approx(2.0 / KC, rel=0.1)
    assert found.loops["play"].mean == pytest.approx(-2.0 / KC, rel=0.1)
    assert found.loops["loss"].mean == pytest.approx(4.0 * (PEAK - 1.0) / KC, rel=0.1)


def test_play_is_the_angle_between_the_loading_lines_and_part_of_the_lost_motion() -> None:
    found = measure([made(play=0.02)], at=0.5)
    assert found.loops["play"].mean == pytest.approx(0.02, rel=0.05)
    assert found.loops["lost_motion"].mean == pytest.approx(0.02 + 2.0 * 0.5 / KC, rel=0.05)
    assert found.loops["hysteresis"].mean == pytest.approx(0.02, rel=0.05)


def test_noise_larger_than_the_torque_of_the_lost_motion_hardly_scatters_it() -> None:
    """Over six noises of six times that torque; read off the noisy torque it scatters by 5 mrad."""
    seeds = [np.random.default_rng(seed).normal(0.0, 3.0, 12_000) for seed in range(6)]
    set_torque = torque(6, 12_000)
    angle = played(set_torque, 0.2, 0.02)
    tests = [Torsion("a", set_torque + noise, angle, setpoint=set_torque) for noise in seeds]
    assert np.std([measure([one], at=0.5).loops["lost_motion"].mean for one in tests]) < 2e-3


def test_the_spread_is_that_of_cycles_and_recordings() -> None:
    soft = made(name="b")
    found = measure([made(), Torsion("b", soft.torque, 1.1 * soft.angle)])
    assert dict(found.by_recording) == pytest.approx({"a": KC, "b": KC / 1.1}, rel=1e-6)
    assert found.loading.recordings == pytest.approx(KC * (1.0 - 1.0 / 1.1) / 2.0**0.5, rel=1e-6)
    assert found.loops["loss"].count == 4


def test_one_ramp_that_begins_and_ends_without_torque_is_one_loop() -> None:
    found = measure([made(friction=1.0, cycles=1)])
    assert found.loops["loss"].count == 1
    assert found.loops["hysteresis"].mean == pytest.approx(2.0 / KC, rel=0.1)


def test_a_table_of_weights_on_one_side_has_a_stiffness_and_a_loss() -> None:
    up = np.linspace(0.0, 10.0, 6)
    weights = np.concatenate([up, up[-2::-1]])
    angle = np.concatenate([up / KC, (up[-2::-1] + 1.0) / KC])
    found = measure([Torsion("weights.csv", weights, angle)])
    assert found.loading.mean == pytest.approx(KC, rel=1e-6)
    assert found.loops["loss"].mean == pytest.approx(10.0 / KC, rel=0.2)
    assert "lost_motion" not in found.loops


def test_the_stated_parts_of_the_range_are_measured() -> None:
    set_torque = torque()
    stiffening = np.sign(set_torque) * np.interp(np.abs(set_torque), [0.0, 5.0, 25.0], [0.0, 0.05, 0.09])
    found = measure([Torsion("a", set_torque, stiffening)], parts=[(0.0, 5.0), (5.0, 24.0)])
    assert [round(found.stiffness["loading", "+", part].mean) for part in found.parts] == [100, 500]


def test_a_torque_that_is_too_small_or_has_the_wrong_sign_has_no_stiffness() -> None:
    test = made()
    for wrong, rated in ((test, 100.0), (Torsion("a", -test.torque, test.angle), None)):
        with pytest.raises(Untrustworthy, match=r"no branch of a loads the joint in .* the torque's sign"):
            measure([wrong], rated=rated)


def test_noise_makes_no_reversals() -> None:
    guide = torque(cycles=3) + np.random.default_rng(2).normal(0.0, 2.0, 4000)
    assert len(reversals(guide)) == 8
