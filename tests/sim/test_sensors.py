"""Each imperfection, measured from the samples alone."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.servo import Command, Limits, NoReply, Quantity, Sample
from sim_backend.servo import SimServo

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sim_backend.parameters import SimParameters

PERIOD = 2e-3


def recorded(parameters: SimParameters, commands: NDArray[np.float64], limits: Limits | None) -> list[Sample]:
    """One sample a tick; disarmed and at rest where there are no limits."""
    servo = SimServo(parameters, seed=1, clock=VirtualClock())
    if limits is not None:
        servo.arm(limits)
    samples = []
    for tick, value in enumerate(commands):
        servo.clock.sleep_until(tick * PERIOD)
        try:
            samples.append(servo.exchange(Command(Quantity.TORQUE, float(value))))
        except NoReply:
            samples.append(Sample.missing(servo.clock.now()))
    return samples


def channel(samples: list[Sample], name: str) -> NDArray[np.float64]:
    return np.array([getattr(sample, name) for sample in samples])


def at_rest(parameters: SimParameters, ticks: int) -> list[Sample]:
    return recorded(parameters, np.zeros(ticks), None)


def spoiled(parameters: SimParameters, **sensors: Any) -> SimParameters:
    return replace(parameters, sensors=replace(parameters.sensors, **sensors))


def test_perfect_sensors_show_nothing_at_rest(quiet: SimParameters) -> None:
    samples = at_rest(quiet, 20)
    for name in ("motor_position", "motor_velocity", "motor_torque", "joint_position", "joint_torque"):
        assert not channel(samples, name).any()
    assert channel(samples, "temperature") == pytest.approx(23.0)
    assert channel(samples, "voltage") == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("key", "name", "level"),
    [("torque_cell_noise", "joint_torque", 2e-4), ("motor_torque_noise", "motor_torque", 3e-5)],
)
def test_noise_has_the_level_asked_for_and_no_memory(quiet: SimParameters, key: str, name: str, level: float) -> None:
    noise = channel(at_rest(spoiled(quiet, **{key: level}), 6000), name)
    assert np.std(noise) == pytest.approx(level, rel=0.04)
    assert abs(np.mean(noise)) < 4.0 * level / math.sqrt(6000)
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4.0 / math.sqrt(6000)


def test_the_torque_cell_starts_at_its_offset_and_drifts(quiet: SimParameters) -> None:
    samples = at_rest(spoiled(quiet, torque_cell_offset=3e-4, torque_cell_drift=-2e-5), 500)
    slope, offset = np.polyfit(channel(samples, "t_read"), channel(samples, "joint_torque"), 1)
    assert offset == pytest.approx(3e-4, rel=1e-6)
    assert slope == pytest.approx(-2e-5, rel=1e-4)


@pytest.mark.parametrize(
    ("sensors", "name", "lsb"),
    [
        ({"motor_counts": 1000}, "motor_position", 2.0 * math.pi / 1000),
        ({"joint_counts": 2**20}, "joint_position", 2.0 * math.pi / 2**20),
        ({"current_lsb": 2e-3}, "motor_torque", 2e-3 * 0.0145),
        ({"torque_cell_lsb": 5e-5}, "joint_torque", 5e-5),
        ({"velocity_lsb": 0.1}, "motor_velocity", 0.1),
    ],
)
def test_a_reading_is_a_whole_number_of_counts_and_half_a_count_off_at_most(
    quiet: SimParameters, limits: Limits, sensors: dict[str, float], name: str, lsb: float
) -> None:
    commands = 1.5e-3 * np.sin(2.0 * np.pi * 3.0 * PERIOD * np.arange(400))
    coarse = channel(recorded(spoiled(quiet, **sensors), commands, limits), name)
    fine = channel(recorded(quiet, commands, limits), name)
    counts = coarse / lsb
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert len(np.unique(np.round(counts))) > 5
    assert np.max(np.abs(coarse - fine)) <= 0.5 * lsb * (1.0 + 1e-3)


def delay(late: NDArray[np.float64], prompt: NDArray[np.float64], hertz: float) -> float:
    """How much later one sine is than another, s, from their correlation with the same phasor."""
    phasor = np.exp(-2j * np.pi * hertz * PERIOD * np.arange(late.size))
    return float(np.angle(np.dot(prompt, phasor) / np.dot(late, phasor)) / (2.0 * np.pi * hertz))


@pytest.mark.parametrize(
    ("key", "name", "age"),
    [
        ("motor_position_delay", "motor_position", 1.3e-4),
        ("motor_position_delay", "motor_position", 5e-3),
        ("motor_torque_delay", "motor_torque", 4e-3),  # whole ticks: the torque follows the set-points in steps
        ("joint_position_delay", "joint_position", 1.3e-4),
        ("joint_torque_delay", "joint_torque", 1.3e-4),
        ("joint_torque_delay", "joint_torque", 5e-3),
    ],
)
def test_a_channel_read_late_shows_an_earlier_instant(
    quiet: SimParameters, limits: Limits, key: str, name: str, age: float
) -> None:
    hertz, ticks = 5.0, 1000  # whole periods are left when the first have been dropped
    commands = 1e-3 * np.sin(2.0 * np.pi * hertz * PERIOD * np.arange(ticks))
    prompt = channel(recorded(quiet, commands, limits), name)[500:]
    late = channel(recorded(spoiled(quiet, **{key: age}), commands, limits), name)[500:]
    # The set-points come in steps, whose ripple keeps time with the reading and shifts the phase by a little.
    assert delay(late, prompt, hertz) == pytest.approx(age, rel=0.03)


def test_the_filter_of_the_torque_cell_delays_by_its_time_constant(quiet: SimParameters, limits: Limits) -> None:
    commands = 1e-3 * np.sin(2.0 * np.pi * 5.0 * PERIOD * np.arange(1000))
    fast = recorded(spoiled(quiet, torque_cell_bandwidth=20_000.0), commands, limits)
    slow = recorded(spoiled(quiet, torque_cell_bandwidth=100.0), commands, limits)
    measured = delay(channel(slow, "joint_torque")[500:], channel(fast, "joint_torque")[500:], 5.0)
    expected = (math.atan(5.0 / 100.0) - math.atan(5.0 / 20_000.0)) / (2.0 * math.pi * 5.0)
    assert measured == pytest.approx(expected, rel=0.01)


def test_replies_are_lost_at_the_rate_asked_for_and_cost_the_timeout(quiet: SimParameters) -> None:
    samples = at_rest(replace(quiet, link=replace(quiet.link, lost_reply=0.1)), 4000)
    lost = np.isnan(channel(samples, "t_read"))
    assert abs(lost.sum() - 400) < 4.0 * math.sqrt(4000 * 0.1 * 0.9)
    first = int(np.flatnonzero(lost)[0])
    assert samples[first].t == pytest.approx(first * PERIOD + quiet.link.reply_timeout)


def test_a_round_trip_takes_its_time_and_jitters_as_told(quiet: SimParameters) -> None:
    steady = at_rest(quiet, 10)
    assert channel(steady, "t_read") - channel(steady, "t") == pytest.approx(3e-4)
    shaky = at_rest(replace(quiet, link=replace(quiet.link, jitter=3e-5)), 4000)
    half = channel(shaky, "t_read") - channel(shaky, "t")
    assert np.mean(half) == pytest.approx(3e-4, rel=0.01)
    assert np.std(half) == pytest.approx(3e-5 / math.sqrt(2.0), rel=0.05)


def test_the_stamp_is_wrong_by_the_imbalance_of_the_two_ways(quiet: SimParameters, limits: Limits) -> None:
    drift = replace(quiet.sensors, torque_cell_offset=0.0, torque_cell_drift=1.0)  # a cell that tells the time
    shaky = replace(quiet, sensors=drift, link=replace(quiet.link, jitter=3e-5))
    samples = recorded(shaky, np.zeros(4000), limits)
    error = channel(samples, "joint_torque") - channel(samples, "t_read")
    assert np.std(error) == pytest.approx(3e-5 / math.sqrt(2.0), rel=0.05)


@pytest.mark.parametrize(
    ("switch", "name"),
    [("joint_encoder", "joint_position"), ("torque_cell", "joint_torque"), ("reports_velocity", "motor_velocity")],
)
def test_a_sensor_the_stand_has_not_reads_nan_and_moves_no_other(
    quiet: SimParameters, limits: Limits, switch: str, name: str
) -> None:
    commands = np.full(50, 1e-3)
    noisy = spoiled(quiet, motor_torque_noise=1e-5, torque_cell_noise=1e-4)
    whole = recorded(noisy, commands, limits)
    without = recorded(spoiled(noisy, **{switch: False}), commands, limits)
    assert np.isnan(channel(without, name)).all()
    for other in ("t_read", "motor_position", "motor_torque", "joint_position", "joint_torque", "motor_velocity"):
        if other != name:
            np.testing.assert_array_equal(channel(without, other), channel(whole, other))


def test_one_source_of_noise_does_not_move_another(quiet: SimParameters) -> None:
    alone = channel(at_rest(spoiled(quiet, torque_cell_noise=2e-4), 300), "joint_torque")
    everything = spoiled(quiet, torque_cell_noise=2e-4, motor_torque_noise=1e-5)
    everything = replace(everything, link=replace(quiet.link, jitter=2e-5, lost_reply=0.05))
    together = channel(at_rest(everything, 300), "joint_torque")
    arrived = ~np.isnan(together)
    assert 200 < arrived.sum() < 300
    np.testing.assert_array_equal(together[arrived], alone[arrived])


def test_the_reported_velocity_is_the_filtered_rate_of_the_motor(quiet: SimParameters, limits: Limits) -> None:
    commands = 1e-3 * np.sin(2.0 * np.pi * 5.0 * PERIOD * np.arange(1000))
    samples = recorded(quiet, commands, limits)
    rate = np.gradient(channel(samples, "motor_position"), PERIOD)[500:]
    measured = delay(channel(samples, "motor_velocity")[500:], rate, 5.0)
    assert measured == pytest.approx(math.atan(5.0 / 200.0) / (2.0 * math.pi * 5.0), rel=0.02)
