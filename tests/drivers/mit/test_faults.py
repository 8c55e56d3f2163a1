"""What can go wrong with a motor on MIT frames: a counted gap or a named error with its remedy, the torque off."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.mit.frames import RESTARTED
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
from sim_backend.wire.mit.device import LOST_COMMUNICATION, OVER_CURRENT, TOO_HOT, MitDevice

Make = Callable[..., Any]
LIMITS = Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 1.0)
MOTORS = ["ak80-9", "dm-j4310"]


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
    state = rig.device._state

    def frame() -> Any:
        made.append(rig.clock.now())
        reply = state()
        counts = 20_000 + len(made)
        return type(reply)(reply.ident, reply.data[:1] + counts.to_bytes(2, "big") + reply.data[3:])

    rig.device._state = frame
    return made


def when_made(made: list[float], servo: Any, position: float) -> float:
    lsb: float = servo.info.position_lsb
    return made[round((position + 12.5) / lsb) - 20_001]


@pytest.mark.parametrize("model", MOTORS)
def test_nobody_at_that_id_is_no_reply_that_says_what_to_look_at(make_mit: Make, model: str) -> None:
    rig = make_mit(model)
    with pytest.raises(NoReply, match=r"no motor 9 answers.*mit\.reply_id"):
        rig.open(id=9)
    assert rig.wire.closed


def test_a_reply_with_another_identifier_is_not_ours(make_mit: Make) -> None:
    with pytest.raises(NoReply, match=r"mit\.reply_id"):
        make_mit(reply_id=0x11).open()
    make_mit(reply_id=0x11).open(reply_id=0x11).close()


def test_the_wrong_model_is_an_error_that_names_both(make_mit: Make) -> None:
    rig = make_mit("dm-j6006")
    with pytest.raises(DriverError, match=r"torque_range is 20, and \[mit\] means 10 for the dm-j4310"):
        rig.open(model="dm-j4310", velocity_range=45.0)
    with pytest.raises(DriverError, match=r"velocity_range is 45"):
        make_mit("dm-j6006").open(model="dm-j4310")


def test_ranges_that_somebody_changed_can_be_said_in_the_stand_file(make_mit: Make) -> None:
    rig = make_mit()
    rig.device.values[23] = 5.0
    servo = rig.open(torque_range=5.0)
    assert servo.info.torque_lsb == pytest.approx(10.0 / 4095)


@pytest.mark.parametrize("model", MOTORS)
def test_two_motors_at_one_id_are_told_from_one(make_mit: Make, model: str) -> None:
    rig = make_mit(model)
    rig.bus.nodes.append(MitDevice(model))
    rig.bus.nodes[1]._zero = 1.0
    with pytest.raises(BadReply, match="two motors with that id"):
        rig.open()


def test_an_answer_that_comes_twice_is_two_motors(make_mit: Make) -> None:
    rig = make_mit()
    rig.bus.faults.inject(DuplicateReplies())
    with pytest.raises(BadReply, match="answers twice"):
        rig.open()


@pytest.mark.parametrize("model", MOTORS)
def test_a_motor_that_another_program_left_running_is_off_once_it_is_opened(make_mit: Make, model: str) -> None:
    rig = make_mit(model)
    rig.device.motor.enable()
    rig.open()
    assert not rig.device.motor.enabled


@pytest.mark.parametrize("model", MOTORS)
def test_a_latched_error_keeps_it_from_arming(make_mit: Make, model: str) -> None:
    rig = make_mit(model)
    servo = rig.open()
    code = OVER_CURRENT[rig.device.damiao]
    rig.device.fail(code)
    with pytest.raises(DeviceFault, match="current was too high") as caught:
        servo.arm(LIMITS)
    assert caught.value.code == code
    assert not rig.device.motor.enabled


def test_a_register_that_is_refused_stops_the_arming_with_the_torque_off(make_mit: Make) -> None:
    rig = make_mit()
    servo = rig.open()
    rig.device.refused.add(9)
    with pytest.raises(DriverError, match="keeps 0 in timeout where 2000 was written"):
        servo.arm(LIMITS)
    assert not rig.device.motor.enabled


@pytest.mark.parametrize("model", MOTORS)
def test_a_frame_lost_at_any_point_of_the_arming_leaves_no_torque(make_mit: Make, model: str) -> None:
    rig = make_mit(model)
    rig.open().arm(LIMITS)
    for number in range(rig.bus.faults.replies):
        for fault in (DropReplies(after=number), DropRequests(after=number)):
            rig = make_mit(model)
            rig.bus.faults.inject(fault)
            try:
                servo = rig.open()
                servo.arm(LIMITS)
            except DriverError:
                assert not rig.device.motor.enabled
            else:
                assert abs(rig.device.motor.demand) <= 0.51 * servo.info.torque_lsb
                servo.close()


def test_silence_becomes_no_reply_within_its_deadline_and_one_lost_reply_is_only_that(make_mit: Make) -> None:
    rig = make_mit()
    servo = armed(rig)
    rig.bus.faults.inject(DropReplies())
    begin = rig.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(PUSH)
    assert rig.clock.now() - begin <= 0.008 + 1e-4
    assert servo.exchange(PUSH).motor_torque > 0.0


@pytest.mark.parametrize("keep", [0, 3, 7])
def test_a_truncated_reply_is_a_gap_and_the_next_one_is_good(make_mit: Make, keep: int) -> None:
    rig = make_mit()
    servo = armed(rig)
    rig.bus.faults.inject(TruncateReplies(keep=keep))
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_a_position_at_the_end_of_its_range_is_no_sample(make_mit: Make) -> None:
    rig = make_mit()
    servo = rig.open()
    rig.device._zero = 20.0
    with pytest.raises(BadReply, match="end of its range"):
        servo.exchange(Command.rest())


@pytest.mark.parametrize("model", MOTORS)
def test_a_late_reply_is_never_taken_for_the_next_answer(make_mit: Make, model: str) -> None:
    for late in np.arange(0.001, 0.027, 0.001):
        rig = make_mit(model)
        servo = armed(rig)
        made = numbered(rig)
        rig.bus.faults.inject(DelayReplies(seconds=float(late)))
        for _ in range(20):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            assert when_made(made, servo, sample.motor_position) >= sample.t
        servo.close()


@pytest.mark.parametrize("late", [0.03, 0.045, 0.06])
def test_replies_later_than_anyone_waits_for_are_noticed_after_few_samples(make_mit: Make, late: float) -> None:
    rig = make_mit()
    servo = armed(rig, watchdog=1.0)
    made = numbered(rig)
    rig.bus.faults.inject(DelayReplies(seconds=late, count=5))
    old, said = 0, ""
    for _ in range(40):
        rig.wait(2e-3)
        try:
            sample = servo.exchange(PUSH)
            old += when_made(made, servo, sample.motor_position) < sample.t
        except (NoReply, BadReply) as error:
            said += str(error)
    assert old <= 3
    assert "an old answer" in said
    servo.exchange(PUSH)


def test_a_second_motor_that_comes_onto_the_bus_in_the_run_is_noticed(make_mit: Make) -> None:
    rig = make_mit()
    servo = armed(rig)
    rig.bus.faults.inject(DuplicateReplies(count=50))
    rig.wait(2e-3)
    servo.exchange(PUSH)
    rig.wait(2e-3)
    with pytest.raises(BadReply, match="a second drive with the same id"):
        servo.exchange(PUSH)


def test_whatever_happens_to_the_replies_no_sample_is_old_and_torque_off_works(make_mit: Make) -> None:
    rng = np.random.default_rng(3)
    kinds = (DelayReplies, DropReplies, TruncateReplies, DropRequests)
    accepted = 0
    for _ in range(10):
        rig = make_mit()
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
            assert when_made(made, servo, sample.motor_position) >= sample.t
        rig.bus.faults.clear()
        servo.disarm()
        assert not rig.device.motor.enabled
    assert accepted > 400


@pytest.mark.parametrize("model", MOTORS)
def test_an_error_in_the_run_is_a_fault_with_its_code_and_the_torque_is_off(make_mit: Make, model: str) -> None:
    rig = make_mit(model)
    servo = armed(rig)
    rig.device.motor.warm_to(121.0)
    rig.wait(2e-3)
    assert not rig.device.motor.enabled
    with pytest.raises(DeviceFault, match="too hot") as caught:
        servo.exchange(PUSH)
    assert caught.value.code == TOO_HOT[rig.device.damiao]
    servo.disarm()


@pytest.mark.parametrize("model", MOTORS)
def test_a_motor_that_reboots_in_the_run_is_a_fault(make_mit: Make, model: str) -> None:
    rig = make_mit(model)
    servo = armed(rig)
    rig.bus.faults.inject(Reboots())
    with pytest.raises(DeviceFault, match="restarted") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == RESTARTED
    assert not rig.device.motor.enabled
    servo.close()


@pytest.mark.parametrize("fault", [BusOff(), Unplug()])
def test_a_bus_that_is_gone_is_a_lost_link_and_close_is_harmless(make_mit: Make, fault: WireFault) -> None:
    rig = make_mit()
    servo = armed(rig)
    rig.bus.faults.inject(fault)
    with pytest.raises(LinkLost, match="cut the"):
        ask_through_gaps(rig, servo, 3)
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    servo.close()
    servo.close()


def test_when_the_client_vanishes_a_damiao_stops_by_itself_and_says_so(make_mit: Make) -> None:
    rig = make_mit()
    servo = armed(rig)
    rig.wait(0.095)
    assert rig.device.motor.torque > 0.0
    rig.wait(0.01)
    assert rig.device.motor.torque == 0.0
    with pytest.raises(DeviceFault, match="heard nothing") as caught:
        servo.exchange(PUSH)
    assert caught.value.code == LOST_COMMUNICATION
    servo.disarm()
    servo.arm(LIMITS)  # what it stopped for is over
    assert rig.device.motor.enabled
    servo.close()


def test_a_torque_off_that_is_not_done_is_said_loudly(make_mit: Make) -> None:
    rig = make_mit()
    servo = armed(rig)
    rig.device.ignores_off = True
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    servo.close()


@pytest.mark.parametrize("lost", [1, 2])
@pytest.mark.parametrize("model", MOTORS)
def test_torque_off_gets_through_though_frames_are_lost(make_mit: Make, model: str, lost: int) -> None:
    rig = make_mit(model)
    servo = armed(rig)
    rig.bus.faults.inject(DropRequests(count=lost))
    servo.disarm()
    assert not rig.device.motor.enabled
