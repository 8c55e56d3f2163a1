from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.servo import BadReply, Command, DeviceFault, DriverError, LinkLost, NoReply, Quantity, Status
from sim_backend.faults import (
    CorruptReplies,
    EncoderFreezes,
    Fault,
    FaultLatches,
    LinkDrops,
    RepliesRepeat,
    Silence,
    TorqueUnreadable,
)
from sim_backend.servo import SimServo

if TYPE_CHECKING:
    from drivers.servo import Limits, Sample
    from sim_backend.parameters import SimParameters

PUSH = Command(Quantity.TORQUE, 1e-3)


def faulty(parameters: SimParameters, limits: Limits, *faults: Fault) -> SimServo:
    servo = SimServo(parameters, seed=1, clock=VirtualClock(), faults=faults)
    servo.arm(limits)
    return servo


def outcomes(servo: SimServo, until: float) -> list[tuple[float, Sample | DriverError]]:
    """What each tick of 2 ms brought, with its time."""
    found: list[tuple[float, Sample | DriverError]] = []
    while (now := servo.clock.now()) < until:
        try:
            found.append((now, servo.exchange(PUSH)))
        except DriverError as error:
            found.append((now, error))
        servo.clock.sleep_until(now + 2e-3)
    return found


def test_a_lost_link_fails_every_call_from_its_time_on(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, LinkDrops(0.1))
    for t, outcome in outcomes(servo, 0.2):
        assert isinstance(outcome, LinkLost) == (t >= 0.1)
    with pytest.raises(LinkLost):
        servo.arm(limits)


def test_a_lost_link_leaves_the_torque_to_the_watchdog_and_only_a_torque_off_says_so(
    quiet: SimParameters, limits: Limits
) -> None:
    SimServo(quiet, seed=1, clock=VirtualClock(), faults=(LinkDrops(0.0),)).disarm()  # it was never armed
    servo = faulty(quiet, limits, LinkDrops(0.1))
    outcomes(servo, 0.11)
    for _ in range(2):
        with pytest.raises(LinkLost):
            servo.disarm()
    servo.close()
    servo.close()
    servo.disarm()
    assert servo.true_state().enabled
    servo.clock.sleep_until(0.1 + quiet.link.watchdog + 1e-3)
    assert not servo.true_state().enabled
    assert servo.true_state().motor_torque == 0.0


def test_a_silence_shorter_than_the_watchdog_is_a_gap(quiet: SimParameters, limits: Limits) -> None:
    found = outcomes(faulty(quiet, limits, Silence(0.1, 0.15)), 0.3)
    for t, outcome in found:
        assert isinstance(outcome, NoReply) == (0.1 <= t < 0.15)
    assert not isinstance(found[-1][1], DriverError)


def test_a_silence_longer_than_the_watchdog_ends_in_its_fault(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, Silence(0.1, 0.3))
    found = outcomes(servo, 0.4)
    assert isinstance(found[-1][1], DeviceFault)
    assert not servo.true_state().enabled


def test_a_servo_disarmed_in_a_silence_learns_of_it_when_the_silence_ends(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, Silence(0.1, 0.12))
    outcomes(servo, 0.11)
    with pytest.raises(DriverError, match="not confirmed"):
        servo.disarm()
    assert servo.true_state().enabled
    servo.clock.sleep_until(0.125)
    servo.exchange(Command.rest())
    assert not servo.true_state().enabled


def test_replies_can_be_corrupt_for_a_while(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, CorruptReplies(0.1, 0.15))
    bad = [t for t, outcome in outcomes(servo, 0.3) if isinstance(outcome, BadReply)]
    assert 0.095 < min(bad) < max(bad) < 0.15
    assert servo.true_state().motor_torque == pytest.approx(1e-3, rel=1e-3)


def test_a_planned_fault_latches_with_its_code_and_no_torque(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, FaultLatches(0.1, code=32))
    errors = [(t, outcome) for t, outcome in outcomes(servo, 0.2) if isinstance(outcome, DeviceFault)]
    assert errors[0][0] == pytest.approx(0.1, abs=3e-3)
    assert {error.code for _, error in errors} == {32}
    assert len(errors) > 40
    assert servo.true_state().motor_torque == 0.0
    with pytest.raises(DeviceFault):
        servo.arm(limits)
    servo.disarm()
    servo.close()


def test_a_frozen_encoder_repeats_itself_while_the_motor_goes_on(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, EncoderFreezes(0.02))
    samples = [(t, outcome) for t, outcome in outcomes(servo, 0.2) if not isinstance(outcome, DriverError)]
    frozen = [sample for t, sample in samples if t > 0.021]
    assert len({sample.motor_position for sample in frozen}) == 1
    assert {sample.motor_velocity for sample in frozen} == {0.0}
    assert not any(sample.status for sample in frozen)
    assert abs(servo.true_state().motor_position - frozen[-1].motor_position) > 0.1


def test_a_torque_off_that_is_not_heard_is_said_until_it_is(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, Silence(0.1, 0.15))
    outcomes(servo, 0.11)
    refused = 0
    while servo.true_state().enabled:
        servo.clock.sleep_until(servo.clock.now() + 2e-3)
        try:
            servo.disarm()
        except DriverError:
            refused += 1
    assert refused > 5
    assert servo.clock.now() == pytest.approx(0.15, abs=5e-3)
    servo.disarm()


def test_replies_can_repeat_themselves_and_say_so(quiet: SimParameters, limits: Limits) -> None:
    servo = faulty(quiet, limits, RepliesRepeat(0.02, 0.05))
    samples = [(t, outcome) for t, outcome in outcomes(servo, 0.1) if not isinstance(outcome, DriverError)]
    stale = [sample for t, sample in samples if 0.02 <= t + 3e-4 < 0.05]
    assert len(stale) == 15
    assert {Status.STALE in sample.status for sample in stale} == {True}
    assert len({sample.motor_position for sample in stale}) == 1
    assert not any(sample.status for t, sample in samples if t + 3e-4 >= 0.05 or t < 0.019)


def test_both_torques_can_be_unreadable_for_a_while(quiet: SimParameters, limits: Limits) -> None:
    for t, outcome in outcomes(faulty(quiet, limits, TorqueUnreadable(0.1, 0.15)), 0.3):
        assert not isinstance(outcome, DriverError)
        blind = 0.1 <= t + 3e-4 < 0.15
        assert math.isnan(outcome.motor_torque) == blind
        assert math.isnan(outcome.joint_torque) == blind
        assert math.isfinite(outcome.motor_position)


def test_samples_before_a_fault_are_those_of_a_run_without_it(quiet: SimParameters, limits: Limits) -> None:
    whole = outcomes(faulty(quiet, limits), 0.1)
    cut = outcomes(faulty(quiet, limits, LinkDrops(0.1), FaultLatches(0.2, 16)), 0.1)
    assert repr(whole) == repr(cut)


def test_a_fault_code_that_means_no_fault_is_refused() -> None:
    with pytest.raises(ValueError, match="fault code 0"):
        FaultLatches(1.0, 0)


def random_fault(rng: np.random.Generator, duration: float) -> Fault:
    """A fault of any kind within `duration` s, an interval up to a tenth of it."""
    at = float(rng.uniform(0.0, duration))
    end = at + float(rng.uniform(0.0, 0.1 * duration))
    kinds: tuple[Fault, ...] = (
        LinkDrops(at),
        Silence(at, end),
        CorruptReplies(at, end),
        FaultLatches(at, int(rng.integers(16, 32))),
        EncoderFreezes(at),
        TorqueUnreadable(at, end),
        RepliesRepeat(at, end),
    )
    return kinds[int(rng.integers(len(kinds)))]


@pytest.mark.parametrize("seed", range(12))
def test_whatever_goes_wrong_the_torque_is_off_a_watchdog_after_closing(
    quiet: SimParameters, limits: Limits, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    plan = tuple(random_fault(rng, 0.4) for _ in range(int(rng.integers(1, 4))))
    servo = SimServo(quiet, seed=1, clock=VirtualClock(), faults=plan)
    try:
        servo.arm(limits)
        outcomes(servo, 0.4)
    except DriverError:
        pass
    finally:
        servo.close()
    servo.clock.sleep_until(servo.clock.now() + quiet.link.watchdog + 1e-3)
    assert servo.true_state().motor_torque == 0.0
    assert not servo.true_state().enabled
