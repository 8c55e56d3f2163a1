from __future__ import annotations

import numpy as np
import pytest

from hil.signals.angle import bursts, far_zero, frozen, outliers, spikes, unwrapped

TIME = np.arange(5000) / 500.0
ANGLE = 0.3 * np.sin(2.0 * np.pi * TIME)
TORQUE = 0.2 * ANGLE


@pytest.mark.parametrize("zero", [0.0, 0.3, -0.5])
def test_a_zero_near_the_motion_stays(zero: float) -> None:
    assert far_zero(ANGLE + zero) == 0.0


@pytest.mark.parametrize("zero", [1.5, -6.0, 1e3])
def test_a_zero_far_away_is_moved_into_the_middle_of_the_range(zero: float) -> None:
    assert far_zero(ANGLE + zero) == pytest.approx(zero, abs=1e-6)


def test_an_angle_that_passes_a_whole_turn_is_unwrapped() -> None:
    found, jumps = unwrapped(np.mod(ANGLE + 0.1, 2.0 * np.pi), TORQUE)

    assert jumps == 20
    np.testing.assert_allclose(np.diff(found), np.diff(ANGLE), atol=1e-12)


def test_an_angle_that_passes_a_whole_turn_every_few_readings_is_unwrapped() -> None:
    fast = 0.3 * np.sin(2.0 * np.pi * 25.0 * TIME + 0.1)

    found, jumps = unwrapped(np.mod(fast, 2.0 * np.pi), TORQUE)

    assert jumps > 0.09 * len(fast)
    np.testing.assert_allclose(np.diff(found), np.diff(fast), atol=1e-12)


def test_an_angle_with_gaps_that_passes_a_whole_turn_is_unwrapped() -> None:
    left = np.delete(ANGLE, np.r_[100:200, 2030:2150])  # steps in the gaps are more than a tenth of a turn's jump

    found, _ = unwrapped(np.mod(4.0 * left, 2.0 * np.pi), TORQUE)

    assert np.ptp(found) == pytest.approx(np.ptp(4.0 * left))


@pytest.mark.parametrize("turn", [np.pi, 2.0 * np.pi / 4.0, 2.0 * np.pi / 9.0, 2.0])
def test_an_angle_that_passes_the_end_of_its_encoder_is_unwrapped(turn: float) -> None:
    found, jumps = unwrapped(2e-4 * np.round(np.mod(ANGLE + 0.1, turn) / 2e-4), TORQUE)

    assert jumps == 20
    np.testing.assert_allclose(found - found.mean(), ANGLE - ANGLE.mean(), atol=1e-3)


def test_a_joint_that_is_moved_in_steps_has_not_passed_the_end_of_its_encoder() -> None:
    square = np.where(np.mod(TIME, 1.0) < 0.5, 0.2, -0.2)

    assert unwrapped(square, 0.3 * square)[1] == 0


def test_a_cable_that_slipped_once_has_not_passed_the_end_of_its_encoder() -> None:
    assert unwrapped(ANGLE + np.where(TIME > 5.0, 0.5, 0.0), TORQUE)[1] == 0


def test_an_angle_without_jumps_is_left_as_it_is() -> None:
    found, jumps = unwrapped(ANGLE + 6.0, TORQUE)

    assert jumps == 0
    np.testing.assert_array_equal(found, ANGLE + 6.0)


def test_jumps_are_not_taken_back_where_the_angle_moves_as_fast_as_they_do() -> None:
    spinning = np.mod(np.cumsum(np.random.default_rng(0).uniform(-3.0, 3.0, 1000)), 2.0 * np.pi)

    assert unwrapped(spinning, TORQUE[:1000])[1] == 0


def test_an_angle_that_stops_while_the_torque_goes_on_is_frozen() -> None:
    angle = np.where(TIME >= 8.0, ANGLE[4000], ANGLE)

    found = frozen(TIME, angle, TORQUE)

    assert found.sum() == 999
    assert not found[:4000].any()


def test_a_pause_is_not_frozen() -> None:
    held = np.minimum(TIME, 5.0)

    assert not frozen(TIME, np.sin(held), 0.2 * np.sin(held) + 1e-3 * np.sin(50.0 * TIME)).any()


def test_a_rest_that_ends_with_the_torque_of_an_inertia_is_not_frozen() -> None:
    """The torque of a step comes at once, and the angle has not moved by a count yet."""
    moving = np.where((TIME > 3.0) & (TIME < 4.0), 3.0, TIME)
    torque = 0.2 * np.sin(moving)
    torque[(TIME > 3.995) & (TIME < 4.0)] += 0.3
    assert not frozen(TIME, np.sin(moving), torque).any()


def test_coarse_counts_are_not_frozen() -> None:
    slow = 0.3 * np.sin(2.0 * np.pi * 0.1 * TIME)

    assert not frozen(TIME, np.round(slow / 0.02) * 0.02, TORQUE).any()


@pytest.mark.parametrize("size", [1.0, 0.01, -0.01])
def test_single_wrong_readings_are_found_whatever_the_counts(size: float) -> None:
    places = np.array([4, 700, 1703, 1709, 4990])
    read = 1e-4 * np.round(ANGLE / 1e-4)
    read[places] += size

    assert np.array_equal(np.flatnonzero(spikes(TIME, read)), places)


@pytest.mark.parametrize(
    "angle",
    [
        np.abs(ANGLE),  # a kink
        np.where(ANGLE > 0.0, 0.3, -0.3),  # a jump
        np.where(TIME > 5.0, np.maximum(ANGLE, 0.0), 0.0),  # long at rest
        np.repeat(ANGLE[::5], 5),  # held
        0.01 * np.random.default_rng(0).standard_t(3, 5000),
        np.mod(ANGLE, 0.5),
        ANGLE * 0.0,
    ],
)
@pytest.mark.parametrize("count", [1e-9, 1e-3])
def test_no_reading_of_a_sharp_held_or_noisy_motion_counts_as_wrong(angle: np.ndarray, count: float) -> None:
    read = count * np.round(angle / count)
    assert not spikes(TIME, read).any()
    assert not bursts(TIME, read, 0.3 * angle + 0.01 * np.gradient(angle)).any()
    assert np.count_nonzero(outliers(TIME, read, ANGLE)) <= 1  # as a torque


@pytest.mark.parametrize("rows", [1, 5])
def test_wrong_readings_of_a_torque_are_found_but_not_its_steps(rows: int) -> None:
    steps = 0.02 * np.sign(np.gradient(ANGLE)) + 1e-4 * np.random.default_rng(0).standard_normal(5000)
    wrong = (np.arange(5000) - 17) % 173 < rows

    assert np.array_equal(outliers(TIME, np.where(wrong, -1.0, TORQUE + steps), ANGLE), wrong)


@pytest.mark.parametrize("seed", range(5))
def test_no_torque_of_dry_friction_counts_as_wrong_where_a_fast_motion_reverses_twice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = 0.05 * np.convolve(rng.standard_normal(5000), np.hanning(60), "same")
    torque = 0.02 * angle + 0.01 * np.sign(np.gradient(angle))

    assert not outliers(TIME, torque, angle + 1e-4 * rng.standard_normal(5000)).any()


@pytest.mark.parametrize("seed", range(5))
def test_no_reading_of_a_chirp_counts_as_wrong_where_stamps_jitter_and_replies_are_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, 0.002)[rng.random(10_000) > 0.05]
    read_at = time + rng.uniform(-1e-4, 1e-4, len(time))

    assert not spikes(time, 0.35 * np.sin(2.0 * np.pi * 0.1 * np.expm1(read_at * 0.25) / 0.25)).any()


@pytest.mark.parametrize("late", [0.0, 0.0015])
def test_no_reading_counts_as_wrong_after_a_lost_reply_or_where_a_row_was_read_late(late: float) -> None:
    time = np.delete(TIME, [2061, 2062, 3301])
    time[[1500, 2999]] += late
    angle = 0.3 * np.sin(2.0 * np.pi * 1.0 * time) + 0.02 * np.sin(2.0 * np.pi * 4.0 * time)

    assert not spikes(time, angle).any()
    assert not bursts(time, angle, 0.3 * np.sin(2.0 * np.pi * time + 0.8)).any()  # at its peak there


@pytest.mark.parametrize("kind", ["random", "held", "zero", "displaced"])
def test_a_short_burst_of_wrong_readings_is_found_as_the_torque_does_not_follow_it(kind: str) -> None:
    rng = np.random.default_rng(3)
    torque, read = 0.3 * ANGLE + 1e-4 * rng.standard_normal(len(ANGLE)), ANGLE.copy()
    for start, rows in ((700, 8), (1650, 30), (4000, 20)):
        part = slice(start, start + rows)
        wrong = {"random": rng.uniform(-1.0, 1.0, rows), "held": read[start - 1], "zero": 0.0}
        read[part] = wrong.get(kind, read[part] + 0.4)
        assert bursts(TIME, read, torque)[start + 1 : start + rows].all()
    assert np.count_nonzero(bursts(TIME, read, torque)) < 80
    assert not bursts(TIME, read, 0.3 * read).any()
