"""Every limit ends a run at what it is there for, and at nothing else."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.servo import BadReply, Sample
from hil.acquisition.guard import Guard
from hil.acquisition.limits import AtJoint, LimitReached
from hil.stand.file import LimitsTable

LIMITS = LimitsTable(torque=0.1, deflection=1.0, velocity=50.0, temperature=70.0)
RATE = 500.0
Reading = tuple[Sample, AtJoint]
Change = Callable[[int, Sample, AtJoint], Reading]
_noise = np.random.default_rng(5).standard_normal(200_000)


def swinging(tick: int, size: float = 0.5, rate: float = RATE) -> Reading:
    """A spring of 0.1 N m/rad at `size` of its limits, with the noise of a good sensor; the winding warms."""
    t, omega = tick / rate, 2.0 * math.pi * 2.0
    phase = omega * t
    dtheta = size * math.sin(phase) + 1e-4 * _noise[tick % len(_noise)]
    torque = 0.1 * dtheta + 1e-5 * _noise[-1 - tick % len(_noise)]
    sample = Sample(t, t, motor_position=dtheta, temperature=30.0 + t / 60.0, voltage=12.0, joint_position=0.0)
    return sample, AtJoint(torque, dtheta, size * omega * math.cos(phase))


def ended(
    change: Change, *, seconds: float = 10.0, size: float = 0.5, rate: float = RATE
) -> tuple[int, Exception] | None:
    """The tick, counted from the one at 1 s, that ends a run in which `change` acts from then on, and its error."""
    guard = Guard(LIMITS, moves=0.05)
    rest = swinging(0)
    guard.check_start([rest[0]] * 16, [rest[1]] * 16)
    first = round(rate)
    for tick in range(first + round(seconds * rate)):
        reading = swinging(tick, size, rate)
        try:
            guard.check(*(change(tick - first, *reading) if tick >= first else reading))
        except (LimitReached, BadReply) as error:
            return tick - first, error
    return None


def said_at_the_end(size: float, noise: float, frequency: float = 2.0, rate: float = RATE) -> list[str]:
    """What a run of 10 s names whose torque swings, or holds, at `size` of its limit under noise of this share."""
    guard = Guard(LIMITS, moves=0.05)
    for tick in range(round(10.0 * rate)):
        t = tick / rate
        torque = size * math.cos(2.0 * math.pi * frequency * t + 0.3 * (frequency > 0.0)) + noise * _noise[tick]
        guard.check(Sample(t, t, motor_position=1e-6 * tick), AtJoint(0.1 * torque, 0.0, 0.0))
    return guard.exceeded(-1.0)


def torque(value: Callable[[int, float], float]) -> Change:
    return lambda tick, sample, joint: (sample, joint._replace(torque=value(tick, joint.torque)))


def angle(value: Callable[[int, float], float]) -> Change:
    def change(tick: int, sample: Sample, joint: AtJoint) -> Reading:
        dtheta = value(tick, joint.dtheta)
        return replace(sample, motor_position=dtheta), joint._replace(dtheta=dtheta)

    return change


@pytest.mark.parametrize("size", [0.01, 1.0])
def test_a_sound_run_up_to_its_limits_is_never_ended(size: float) -> None:
    assert ended(lambda _tick, *reading: reading, size=size, seconds=20.0) is None


@pytest.mark.parametrize(
    ("name", "change", "within", "kind", "words"),
    [
        (
            "1.05 of the limit for ever",
            torque(lambda k, _: 0.105 + 1e-6 * (k % 2)),
            0.28,
            LimitReached,
            "the torque reached 0.105",
        ),
        ("1.05 at every peak", torque(lambda _, value: 2.1 * value), 10.0, LimitReached, "its limit is 0.1"),
        ("a spike every second sample", torque(lambda k, v: 0.12 if k % 2 else v), 0.011, LimitReached, "torque"),
        ("far beyond once", torque(lambda k, v: 0.16 if k == 0 else v), 0.0, LimitReached, "0.16 N m"),
        ("an encoder that jumps", angle(lambda _, value: value + 0.3), 0.005, BadReply, "jumped by 0.3"),
        ("an encoder that jumps to and fro", angle(lambda k, v: v + 0.3 * (k % 2)), 0.011, BadReply, "jumped"),
        ("a noisy encoder", angle(lambda k, v: v + 0.03 * _noise[k]), 1.0, BadReply, "to and fro"),
        ("a stuck cell", torque(lambda _, __: 0.02), 1.0, BadReply, "the torque stayed at 0.02 N m"),
        ("a saturated cell", torque(lambda _, value: max(value, -0.01)), 1.0, BadReply, "the end of its range"),
        (
            "a low supply",
            lambda _, sample, joint: (replace(sample, voltage=8.0), joint),
            0.005,
            LimitReached,
            "from 12 V at rest to 8 V",
        ),
        (
            "a slipping lock",
            lambda k, sample, joint: (replace(sample, joint_position=2e-3 * k), joint),
            0.21,
            LimitReached,
            "it is not locked",
        ),
        (
            "a warm winding",
            lambda _, sample, joint: (replace(sample, temperature=66.0), joint),
            0.0,
            LimitReached,
            "the winding reached 66 degC",
        ),
    ],
)
def test_what_must_end_a_run_does_within_its_time(
    name: str, change: Change, within: float, kind: type[Exception], words: str
) -> None:
    end = ended(change)
    assert end is not None, name
    tick, error = end
    assert isinstance(error, kind)
    assert words in str(error)
    assert tick / RATE <= within


@pytest.mark.parametrize(("frequency", "rate"), [(0.0, 500.0), (2.0, 100.0), (7.0, 500.0)])
@pytest.mark.parametrize(("size", "noise"), [(1.01, 0.0), (1.01, 2e-3), (1.005, 1e-3), (1.019, 3e-3)])
def test_what_lies_over_a_limit_by_more_than_its_noise_is_named_at_the_end(
    size: float, noise: float, frequency: float, rate: float
) -> None:
    (said,) = said_at_the_end(size, noise, frequency, rate)
    words = r"the torque was above its limit of 0.1 N m in \d+ rows from 1(\.\d+)? s on, by .* % at most"
    assert re.fullmatch(words, said)


@pytest.mark.parametrize(("frequency", "rate"), [(0.0, 500.0), (2.0, 100.0), (7.0, 500.0)])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2, 3e-2])
def test_noise_at_a_limit_ends_no_run_and_is_not_named(noise: float, frequency: float, rate: float) -> None:
    assert said_at_the_end(1.0, noise, frequency, rate) == []


def test_a_step_to_one_percent_above_a_limit_is_named_and_what_its_last_count_may_be_is_not() -> None:
    for count, named in ((math.nan, 1), (0.0015, 1), (0.0025, 0)):  # N m: half of it is less or more than 1 mN m
        guard = Guard(LIMITS, moves=0.05, counts=AtJoint(torque=count))
        for tick in range(500):
            torque = 0.101 if 100 <= tick < 114 else 0.02
            guard.check(Sample(0.002 * tick, 0.0, motor_position=1e-6 * tick), AtJoint(torque, 0.0, 0.0))
        assert len(guard.exceeded(0.0)) == named


@pytest.mark.study
def test_a_frozen_temperature_is_noticed_under_load_only() -> None:
    def frozen(_: int, sample: Sample, joint: AtJoint) -> Reading:
        return replace(sample, temperature=30.0), joint

    end = ended(frozen, size=0.9, seconds=700.0, rate=20.0)
    assert end is not None
    assert "sensor is frozen" in str(end[1])
    assert 300.0 < end[0] / 20.0 < 700.0  # the torque is above half its limit for six tenths of the time
    assert ended(frozen, size=0.3, seconds=700.0, rate=20.0) is None


@pytest.mark.study
def test_a_temperature_that_comes_to_its_balance_may_stay_there_and_one_that_stops_in_the_middle_may_not() -> None:
    def warming(until: float, steps: float) -> Change:
        """From 30 degC towards 33.4 with a time constant of 150 s in steps of a sensor, which stops at `until` s."""

        def change(tick: int, sample: Sample, joint: AtJoint) -> Reading:
            t = min(tick / 20.0, until)
            value = 30.0 + 3.4 * (1.0 - math.exp(-t / 150.0)) + 0.005 * math.sin(4.0 * math.pi * t)  # within a cycle
            return replace(sample, temperature=steps * math.floor(value / steps)), joint

        return change

    assert ended(warming(math.inf, 1.0), size=0.9, seconds=1200.0, rate=20.0) is None
    end = ended(warming(60.0, 0.1), size=0.9, seconds=900.0, rate=20.0)
    assert end is not None
    assert "sensor is frozen" in str(end[1])
    assert 360.0 < end[0] / 20.0 < 760.0


@pytest.mark.parametrize(
    "change",
    [
        torque(lambda k, v: 0.12 if k % 6 == 0 and k < 12 else v),
        torque(lambda k, v: math.nan if k in {3, 4} else v),
        angle(lambda k, v: v + (0.3 if k == 5 else 0.0)),
        torque(lambda _, v: 0.0 if abs(v) < 0.01 else v),  # play: no torque in a fifth of the way
    ],
)
def test_what_a_sound_stand_does_now_and_then_ends_nothing(change: Change) -> None:
    assert ended(change) is None
