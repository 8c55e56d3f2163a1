"""What can go wrong with a CiA 402 drive on CANopen: a counted gap or a named error with its remedy, torque off."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import can
import numpy as np
import pytest

from drivers.cia402.profiles import NOT_ENABLED, RESTARTED
from drivers.cia402.scan import search
from drivers.servo import BadReply, Command, DeviceFault, DriverError, Limits, LinkLost, NoReply, Quantity
from sim_backend.wire.canopen.node import HEARTBEAT_LOST, PRE_OPERATIONAL
from sim_backend.wire.cia402.device import FOLLOWING_ERROR, OVERCURRENT, OVERTEMPERATURE, Cia402Device
from sim_backend.wire.cia402.machine import Cia402State
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

Make = Callable[..., Any]
LIMITS = Limits(torque=0.04, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.01)
MODELS = ["epos4", "epos2", "generic"]
POSITION = (0x6064, 0)


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


def numbered(rig: Any) -> dict[int, float]:
    """Make each reading of the position a number of its own; the time each was made, by that number."""
    made: dict[int, float] = {}

    def value() -> int:
        made[len(made) + 1] = rig.clock.now()
        return len(made)

    rig.device.objects.read_hooks[POSITION] = value
    return made


def number(sample: Any) -> int:
    return int(sample.motor_position / (2.0 * np.pi / 4096) + 0.5)


# -- opening --------------------------------------------------------------------------------------------------------


def test_nobody_at_that_id_is_no_reply_that_says_what_to_look_at(make_cia402: Make) -> None:
    rig = make_cia402()
    with pytest.raises(NoReply, match=r"no CANopen node 5 answers.*1000000 bit/s.*termination"):
        rig.open(id=5)
    assert rig.wire.closed


def test_two_drives_at_one_id_are_told_from_one(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.bus.nodes.append(Cia402Device("epos4", 1, serial=0x62004412))
    with pytest.raises((NoReply, BadReply), match="two drives with that node id"):
        rig.open()


def test_an_answer_that_comes_twice_is_two_drives(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.bus.faults.inject(DuplicateReplies(count=5))
    with pytest.raises(BadReply, match="answers twice"):
        rig.open()


@pytest.mark.parametrize(
    ("model", "profile", "words"),
    [
        ("epos2", "epos4", r"\(EPOS2\) has no object 0x6071:00: it is no epos4"),
        ("epos4", "epos2", r"has no object 0x2030:00: it is no epos2"),
        ("generic", "epos4", "vendor 0x2E3, not of maxon"),
    ],
)
def test_another_kind_of_drive_than_the_stand_file_says_is_refused(
    make_cia402: Make, model: str, profile: str, words: str
) -> None:
    with pytest.raises(DriverError, match=words):
        make_cia402(model).open(profile=profile, torque_constant=0.02)


def test_a_node_that_is_no_drive_is_refused(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.device.objects.put(0x1000, 0, 0x000F0191)
    with pytest.raises(DriverError, match="is no drive: its device profile is 401"):
        rig.open()


def test_a_drive_that_another_program_left_enabled_is_without_torque_once_it_is_opened(make_cia402: Make) -> None:
    rig = make_cia402()
    armed(rig)
    assert rig.device.motor.enabled
    rig.open()
    assert not rig.device.motor.enabled


def test_a_drive_that_is_refused_when_it_is_opened_is_left_without_torque(make_cia402: Make) -> None:
    rig = make_cia402()
    armed(rig, watchdog=2.0)
    with pytest.raises(DriverError, match="resolution"):
        rig.open(resolution=500)
    assert not rig.device.motor.enabled


def test_a_search_names_every_node_and_touches_nothing(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.bus.nodes.append(Cia402Device("epos2", 9))
    before = [dict(node.objects.values) for node in rig.bus.nodes]
    assert search(rig.config, rig.clock, rig.wire) == [
        "EPOS4 Module 24/1.5 (profile CiA 402) answers with node id 1",
        "EPOS2 (profile CiA 402) answers with node id 9",
    ]
    assert [node.objects.values for node in rig.bus.nodes] == before
    assert {message.data[0] for message in rig.wire.sent} <= {0x40, 0x60, 0x70}


# -- arming ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_a_latched_fault_keeps_it_from_arming(make_cia402: Make, model: str) -> None:
    rig = make_cia402(model)
    servo = rig.open()
    rig.device.fail(OVERCURRENT)
    with pytest.raises(DeviceFault, match="over-current: check the motor's wires") as caught:
        servo.arm(LIMITS)
    assert caught.value.code == OVERCURRENT
    assert not rig.device.motor.enabled


def test_a_fault_from_before_we_listened_is_read_from_the_drive(make_cia402: Make) -> None:
    for model in MODELS:
        rig = make_cia402(model)
        rig.device.fail(OVERCURRENT)
        rig.device.node._pending.clear()
        servo = rig.open()
        with pytest.raises(DeviceFault) as caught:
            servo.arm(LIMITS)
        assert caught.value.code == OVERCURRENT


def test_a_heartbeat_that_stopped_before_we_came_is_no_fault(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.device.fail(HEARTBEAT_LOST)
    servo = armed(rig)
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_any_fault_is_reset_where_the_stand_file_allows_and_the_drive_does(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.device.fail(FOLLOWING_ERROR)
    assert armed(rig, reset_faults=True).exchange(PUSH).motor_torque > 0.0
    rig = make_cia402()
    rig.device.fail(OVERCURRENT)
    rig.device.machine.can_reset = False
    servo = rig.open(reset_faults=True)
    with pytest.raises(DeviceFault) as caught:
        servo.arm(LIMITS)
    assert caught.value.code == OVERCURRENT


def test_a_power_stage_that_does_not_come_on_says_what_to_look_at(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.open()
    rig.device.machine.ignores_controlword = True
    with pytest.raises(DriverError, match=r"switch on disabled.*safe-torque-off"):
        servo.arm(LIMITS)


def test_a_frame_lost_at_any_point_of_the_arming_leaves_no_torque(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.open().arm(LIMITS)
    for place in range(0, rig.bus.faults.replies, 7):
        for fault in (DropReplies(after=place), DropRequests(after=place)):
            rig = make_cia402()
            rig.bus.faults.inject(fault)
            try:
                servo = rig.open()
                servo.arm(LIMITS)
            except DriverError:
                assert not rig.device.motor.enabled
            else:
                assert rig.device.motor.torque == 0.0
                servo.exchange(PUSH)
                servo.close()


# -- running --------------------------------------------------------------------------------------------------------


def test_silence_becomes_no_reply_within_its_deadline_and_one_lost_reply_is_only_that(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.wait(2e-3)
    rig.bus.faults.inject(DropReplies())
    begin = rig.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(PUSH)
    assert rig.clock.now() - begin <= 0.01 + 1e-3
    assert servo.exchange(PUSH).motor_torque > 0.0


@pytest.mark.parametrize("keep", [0, 3, 7])
def test_a_truncated_reply_is_a_gap_and_the_next_one_is_good(make_cia402: Make, keep: int) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.bus.faults.inject(TruncateReplies(keep=keep))
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_a_late_reply_is_never_taken_for_the_next_answer(make_cia402: Make) -> None:
    for late in np.arange(0.001, 0.029, 0.002):
        rig = make_cia402()
        servo = armed(rig)
        made = numbered(rig)
        rig.bus.faults.inject(DelayReplies(seconds=float(late)))
        for _ in range(15):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            assert made[number(sample)] >= sample.t
        servo.close()


def test_whatever_happens_to_the_replies_no_sample_is_old_and_torque_off_works(make_cia402: Make) -> None:
    rng = np.random.default_rng(3)
    kinds = (DelayReplies, DropReplies, DuplicateReplies, TruncateReplies, DropRequests)
    accepted = 0
    for _ in range(8):
        rig = make_cia402()
        servo = armed(rig)
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
            assert made[number(sample)] >= sample.t
        rig.bus.faults.clear()
        servo.disarm()
        assert not rig.device.motor.enabled
    assert accepted > 350


@pytest.mark.parametrize("model", MODELS)
def test_a_fault_in_the_run_comes_with_its_code_and_the_torque_is_off(make_cia402: Make, model: str) -> None:
    rig = make_cia402(model)
    servo = armed(rig)
    rig.device.fail(FOLLOWING_ERROR)
    with pytest.raises(DeviceFault, match=r"0x8611: the following error") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == FOLLOWING_ERROR
    servo.disarm()
    assert not rig.device.motor.enabled


def test_overheating_turns_the_torque_off_and_says_so(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.device.motor.warm_to(81.0)  # above the limit that was written, below the drive's own
    with pytest.raises(DeviceFault, match="too hot") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == OVERTEMPERATURE
    assert rig.device.motor.torque == 0.0


def test_a_drive_that_somebody_else_switches_off_is_a_fault(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.device.machine.quick_stop()
    rig.device.machine.ignores_controlword = True
    with pytest.raises(DeviceFault, match="somebody else on the bus") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == NOT_ENABLED


def test_a_node_that_somebody_else_stops_is_a_fault_and_is_started_again(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.wire.send(can.Message(arbitration_id=0, data=[2, 1], is_extended_id=False))
    with pytest.raises(DeviceFault, match="somebody else on the bus") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == NOT_ENABLED
    assert not rig.device.motor.enabled
    servo.disarm()
    servo.arm(LIMITS)
    servo.exchange(PUSH)


@pytest.mark.parametrize("model", MODELS)
def test_a_drive_that_reboots_in_the_run_is_a_fault_and_can_be_armed_again(make_cia402: Make, model: str) -> None:
    rig = make_cia402(model)
    servo = armed(rig)
    rig.bus.faults.inject(Reboots())
    with pytest.raises(DeviceFault, match="restarted") as caught:
        ask_through_gaps(rig, servo, 400)
    assert caught.value.code == RESTARTED
    assert not rig.device.motor.enabled
    servo.disarm()
    servo.arm(LIMITS)
    rig.wait(2e-3)
    assert servo.exchange(PUSH).motor_torque > 0.0
    servo.close()


def test_a_drive_that_reboots_while_it_is_disarmed_is_read_again_though_the_first_tries_fail(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.open()
    rig.device.reboot(rig.clock.now())
    rig.wait(0.6)
    rig.bus.faults.inject(DropReplies(after=6, count=4))
    samples = 0
    for _ in range(20):
        rig.wait(2e-3)
        with contextlib.suppress(NoReply):
            servo.exchange(Command.rest())
            samples += 1
    assert samples > 10


@pytest.mark.parametrize("fault", [BusOff(), Unplug()])
def test_a_bus_that_is_gone_is_a_lost_link_and_close_is_harmless(make_cia402: Make, fault: WireFault) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.bus.faults.inject(fault)
    with pytest.raises(LinkLost, match="cut the"):
        ask_through_gaps(rig, servo, 3)
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    servo.close()
    servo.close()


# -- stopping -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_when_the_client_vanishes_the_drive_misses_its_heartbeat_and_the_torque_is_off(
    make_cia402: Make, model: str
) -> None:
    rig = make_cia402(model)
    servo = armed(rig)
    rig.wait(0.07)
    assert rig.device.motor.torque > 0.0
    rig.wait(0.05)
    assert not rig.device.motor.enabled
    with pytest.raises(DeviceFault, match="heard no heartbeat") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == HEARTBEAT_LOST
    servo.disarm()
    servo.arm(LIMITS)  # it says only that nobody spoke to it


def test_a_torque_off_that_is_not_done_is_said_loudly(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.device.machine.ignores_controlword = True
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    rig.wait(1e-3)
    assert rig.device.motor.demand == 0.0  # zero torque was asked for as well
    servo.close()


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_torque_off_gets_through_though_frames_are_lost(make_cia402: Make, lost: int) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.bus.faults.inject(DropRequests(count=lost))
    servo.disarm()
    assert not rig.device.motor.enabled


def test_torque_off_gets_through_though_the_node_takes_no_pdo(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.device.node.state = PRE_OPERATIONAL
    servo.disarm()
    assert rig.device.machine.state is Cia402State.SWITCH_ON_DISABLED


def test_a_client_that_stays_away_after_torque_off_leaves_no_fault_behind(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    servo.disarm()
    rig.wait(5.0)
    assert rig.device.machine.state is Cia402State.SWITCH_ON_DISABLED
    servo.exchange(Command.rest())
