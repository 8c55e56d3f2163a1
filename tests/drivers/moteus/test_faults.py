"""What can go wrong with a moteus: a counted gap or a named error with its remedy, the torque off."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.moteus.frames import RESTARTED, WATCHDOG
from drivers.servo import BadReply, Command, DeviceFault, DriverError, Limits, LinkLost, NoReply, Quantity
from sim_backend.wire.faults import (
    BusOff,
    DelayReplies,
    DropReplies,
    DropRequests,
    DuplicateReplies,
    Reboots,
    TruncateReplies,
    Unplug,
    WireFault,
)
from sim_backend.wire.moteus.device import (
    DRIVER_FAULT,
    FAULT,
    OUTSIDE_LIMIT,
    OVER_TEMPERATURE,
    POSITION,
    STOPPED,
    TIMEOUT,
    MoteusDevice,
)

Make = Callable[..., Any]
LIMITS = Limits(torque=0.4, velocity=60.0, temperature=70.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.1)


def armed(rig: Any, **changes: Any) -> Any:
    servo = rig.open(**changes)
    servo.arm(LIMITS)
    rig.wait(2e-3)
    servo.exchange(PUSH)
    return servo


def ask_through_gaps(rig: Any, servo: Any, tries: int = 100) -> None:
    """Go on as a recorder does, until something ends it."""
    for _ in range(tries):
        rig.wait(2e-3)
        with contextlib.suppress(NoReply, BadReply):
            servo.exchange(PUSH)


def numbered(rig: Any) -> list[float]:
    """Make each reply's position a number of its own; the time each was made, by that number."""
    made: list[float] = []

    class Numbered(MoteusDevice):
        @property
        def turns(self) -> float:
            made.append(rig.clock.now())
            return float(len(made) - 1)

    rig.device.__class__ = Numbered
    return made


def test_nobody_at_that_id_is_no_reply_that_says_what_to_look_at(make_moteus: Make) -> None:
    rig = make_moteus()
    with pytest.raises(NoReply, match=r"no moteus 9 answers.*CAN FD"):
        rig.open(id=9)
    assert rig.wire.closed


def test_two_controllers_at_one_id_are_told_from_one(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.bus.nodes.append(MoteusDevice(serial=(1, 2, 3)))
    with pytest.raises(BadReply, match="two controllers with that id"):
        rig.open()


def test_an_answer_that_comes_twice_is_two_controllers(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.bus.faults.inject(DuplicateReplies())
    with pytest.raises(BadReply, match="answers twice"):
        rig.open()


def test_firmware_without_a_register_is_named_with_its_remedy(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.device.unknown.add(0x070)
    with pytest.raises(DriverError, match=r"refuses reading register 0x070.*moteus_tool --flash"):
        rig.open()


def test_firmware_without_a_limit_is_named_and_stays_stopped(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = rig.open()
    del rig.device.console.values["servo.timeout_mode"]
    with pytest.raises(DriverError, match=r"servo\.timeout_mode.*firmware"):
        servo.arm(LIMITS)
    assert rig.device.mode == STOPPED


def test_a_controller_that_another_program_left_running_is_stopped_once_it_is_opened(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.device.mode = POSITION
    rig.device.motor.enable()
    rig.open()
    assert rig.device.mode == STOPPED


def test_a_latched_fault_keeps_it_from_arming(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.device.fail(DRIVER_FAULT)
    servo = rig.open()
    with pytest.raises(DeviceFault, match="motor driver failed") as caught:
        servo.arm(LIMITS)
    assert caught.value.code == DRIVER_FAULT
    assert not rig.device.motor.enabled


def test_a_position_outside_its_bounds_is_said_when_it_starts(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = rig.open()
    rig.device.console.values["servopos.position_min"] = 0.5
    with pytest.raises(DeviceFault, match=r"servopos\.position_min") as caught:
        servo.arm(LIMITS)
    assert caught.value.code == OUTSIDE_LIMIT


def test_a_limit_that_is_refused_stops_the_arming(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = rig.open()
    rig.device.console.refused.add("servo.timeout_mode")
    with pytest.raises(DriverError, match=r"keeps 12 in servo\.timeout_mode where 0 was written"):
        servo.arm(LIMITS)
    assert rig.device.mode == STOPPED


def test_a_frame_lost_at_any_point_of_the_arming_leaves_no_torque(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.open().arm(LIMITS)
    for number in range(0, rig.bus.faults.replies, 2):
        for fault in (DropReplies(after=number), DropRequests(after=number)):
            rig = make_moteus()
            rig.bus.faults.inject(fault)
            try:
                servo = rig.open()
                servo.arm(LIMITS)
            except DriverError:
                assert rig.device.mode == STOPPED
            else:
                assert rig.device.motor.torque == 0.0
                servo.close()


def test_silence_becomes_no_reply_within_its_deadline_and_one_lost_reply_is_only_that(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.bus.faults.inject(DropReplies())
    begin = rig.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(PUSH)
    assert rig.clock.now() - begin <= 0.008 + 1e-4
    assert servo.exchange(PUSH).motor_torque > 0.0


@pytest.mark.parametrize("keep", [0, 2, 3, 13, 14, 20, 30])
def test_a_truncated_reply_is_a_gap_and_the_next_one_is_good(make_moteus: Make, keep: int) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.bus.faults.inject(TruncateReplies(keep=keep))
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_a_late_reply_is_never_taken_for_the_next_answer_however_late(make_moteus: Make) -> None:
    for late in [*np.arange(0.001, 0.03, 0.001), 0.05, 0.08]:
        rig = make_moteus()
        servo = armed(rig, watchdog=1.0)
        made = numbered(rig)
        rig.bus.faults.inject(DelayReplies(seconds=float(late), count=3))
        for _ in range(30):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            assert made[round(sample.motor_position / (2.0 * np.pi))] >= sample.t - 2.5e-3
        servo.close()


def test_whatever_happens_to_the_replies_no_sample_is_old_and_a_stop_works(make_moteus: Make) -> None:
    rng = np.random.default_rng(3)
    kinds = (DelayReplies, DropReplies, DuplicateReplies, TruncateReplies, DropRequests)
    accepted = 0
    for _ in range(10):
        rig = make_moteus()
        servo = armed(rig, watchdog=1.0)
        made = numbered(rig)
        for kind in rng.choice(np.array(kinds), size=4):
            rig.bus.faults.inject(kind(after=int(rng.integers(60)), count=int(rng.integers(1, 4))))
        for _ in range(60):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            accepted += 1
            assert made[round(sample.motor_position / (2.0 * np.pi))] >= sample.t - 2.5e-3
        rig.bus.faults.clear()
        servo.disarm()
        assert rig.device.mode == STOPPED
    assert accepted > 400


def test_a_fault_in_the_run_has_its_code_and_the_torque_is_off(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.device.motor.warm_to(71.0)
    rig.wait(2e-3)
    assert rig.device.mode == FAULT
    with pytest.raises(DeviceFault, match="too hot") as caught:
        servo.exchange(PUSH)
    assert caught.value.code == OVER_TEMPERATURE
    assert not rig.device.motor.enabled
    servo.disarm()


def test_a_controller_that_reboots_in_the_run_is_a_fault(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.bus.faults.inject(Reboots())
    with pytest.raises(DeviceFault, match="restarted") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == RESTARTED
    assert not rig.device.motor.enabled
    servo.close()


@pytest.mark.parametrize("fault", [BusOff(), Unplug()])
def test_a_bus_that_is_gone_is_a_lost_link_and_close_is_harmless(make_moteus: Make, fault: WireFault) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.bus.faults.inject(fault)
    with pytest.raises(LinkLost, match="cut the"):
        ask_through_gaps(rig, servo, 3)
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    servo.close()
    servo.close()


def test_when_the_client_vanishes_the_watchdog_takes_the_torque_away_and_does_not_hold(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.wait(0.095)
    assert rig.device.motor.torque > 0.0
    rig.wait(0.01)
    assert (rig.device.mode, rig.device.motor.torque) == (TIMEOUT, 0.0)
    rig.wait(0.5)
    assert rig.device.motor.demand == 0.0
    with pytest.raises(DeviceFault, match="heard nothing") as caught:
        servo.exchange(PUSH)
    assert caught.value.code == WATCHDOG
    servo.close()


def test_a_stop_that_is_not_done_is_said_loudly(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.device.ignores_stop = True
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    servo.close()


@pytest.mark.parametrize("lost", [1, 2])
def test_a_stop_gets_through_though_frames_are_lost(make_moteus: Make, lost: int) -> None:
    rig = make_moteus()
    servo = armed(rig)
    rig.bus.faults.inject(DropRequests(count=lost))
    servo.disarm()
    assert rig.device.mode == STOPPED
