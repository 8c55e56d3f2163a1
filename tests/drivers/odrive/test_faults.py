"""What can go wrong with an ODrive on CAN: a counted gap or a named error with its remedy, the axis idle."""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.odrive.messages import RESTARTED
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
from sim_backend.wire.odrive.device import DRIVER_FAULT, IDLE, OVERHEAT, OVERSPEED, WATCHDOG, OdriveDevice
from sim_backend.wire.odrive.endpoints import flat_endpoints

Make = Callable[..., Any]
LIMITS = Limits(torque=0.4, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.1)
FIRMWARES = ["0.5.6", "0.6.10"]


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


def numbered(device: Any, rig: Any) -> dict[float, float]:
    """Make each estimate of the position a number of its own; the time each was made, by that number."""
    made: dict[float, float] = {}

    def data() -> bytes:
        number = float(len(made) + 1)
        made[number] = rig.clock.now()
        return struct.pack("<ff", number, 0.0)

    device._encoder_data = data
    return made


# -- opening --------------------------------------------------------------------------------------------------------


def test_nobody_at_that_id_is_no_reply_that_says_what_to_look_at(make_odrive: Make) -> None:
    rig = make_odrive()
    with pytest.raises(NoReply, match=r"no ODrive axis 5 is heard.*heartbeat"):
        rig.open(id=5)
    assert rig.wire.closed


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_two_axes_at_one_id_are_told_from_one(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    rig.bus.nodes.append(OdriveDevice(0, firmware=firmware))
    rig.bus.nodes[1]._offset = 1.0
    with pytest.raises((NoReply, BadReply), match="two drives with that node id"):
        rig.open()


def test_an_answer_that_comes_twice_is_two_axes(make_odrive: Make) -> None:
    rig = make_odrive()
    rig.bus.faults.inject(DuplicateReplies())
    with pytest.raises(BadReply, match="answers twice"):
        rig.open()


def test_an_axis_that_another_program_left_running_is_idle_once_it_is_opened(make_odrive: Make) -> None:
    rig = make_odrive()
    rig.device._request_state(8)
    rig.open()
    assert rig.device.state == IDLE


def test_parameters_over_can_are_refused_for_firmware_that_has_none(make_odrive: Make, tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="drop it"):
        make_odrive("0.5.6").open(endpoints=str(tmp_path))


# -- arming ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_latched_error_keeps_it_from_arming(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    servo = rig.open()
    bits = DRIVER_FAULT[rig.device.layout]
    rig.device.fail(bits)
    with pytest.raises(DeviceFault, match="failed") as caught:
        servo.arm(LIMITS)
    assert caught.value.code == bits
    assert rig.device.state == IDLE


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_watchdog_that_ran_out_before_we_came_is_no_fault(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    rig.device.endpoints.put("axis0.config.enable_watchdog", 1.0)
    rig.device.endpoints.put("axis0.config.watchdog_timeout", 0.2)
    rig.device.fail(WATCHDOG[rig.device.layout])
    servo = armed(rig)
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_an_axis_that_is_not_calibrated_says_so(make_odrive: Make) -> None:
    rig = make_odrive()
    servo = rig.open()
    rig.device.calibrated = False
    with pytest.raises(DriverError, match="calibrate motor and encoder"):
        servo.arm(LIMITS)


def test_a_frame_lost_at_any_point_of_the_arming_leaves_no_torque(make_odrive: Make, tmp_path: Path) -> None:
    path = tmp_path / "endpoints.json"
    path.write_text(json.dumps(flat_endpoints("0.6.10")), encoding="utf-8")
    rig = make_odrive()
    rig.open(endpoints=str(path)).arm(LIMITS)
    for number in range(0, rig.bus.faults.replies, 3):
        for fault in (DropReplies(after=number), DropRequests(after=number)):
            rig = make_odrive()
            rig.bus.faults.inject(fault)
            try:
                servo = rig.open(endpoints=str(path))
                servo.arm(LIMITS)
            except DriverError:
                assert rig.device.state == IDLE
            else:
                assert rig.device.motor.torque == 0.0
                servo.close()


# -- running --------------------------------------------------------------------------------------------------------


def test_silence_becomes_no_reply_within_its_deadline_and_one_lost_reply_is_only_that(make_odrive: Make) -> None:
    rig = make_odrive()
    servo = armed(rig)
    rig.device._estimates = 1e9  # what it sends unasked would do as well
    rig.wait(2e-3)
    rig.bus.faults.inject(DropReplies())
    begin = rig.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(PUSH)
    assert rig.clock.now() - begin <= 0.008 + 1e-3
    assert servo.exchange(PUSH).motor_torque > 0.0


@pytest.mark.parametrize("keep", [0, 3, 7])
def test_a_truncated_reply_is_a_gap_and_the_next_one_is_good(make_odrive: Make, keep: int) -> None:
    rig = make_odrive()
    servo = armed(rig)
    rig.bus.faults.inject(TruncateReplies(keep=keep))
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_a_late_reply_is_never_taken_for_the_next_answer(make_odrive: Make) -> None:
    for late in np.arange(0.001, 0.026, 0.001):
        rig = make_odrive()
        servo = armed(rig)
        made = numbered(rig.device, rig)
        rig.bus.faults.inject(DelayReplies(seconds=float(late)))
        for _ in range(20):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            number = round(sample.motor_position / (2.0 * np.pi))
            assert made[number] >= sample.t - 1e-3  # an estimate sent unasked may be on the wire already
        servo.close()


@pytest.mark.parametrize("late", [0.03, 0.045, 0.06])
def test_replies_later_than_anyone_waits_for_are_noticed_after_few_samples(make_odrive: Make, late: float) -> None:
    rig = make_odrive()
    servo = armed(rig)
    made = numbered(rig.device, rig)
    rig.bus.faults.inject(DelayReplies(seconds=late, count=10))
    old, said = 0, ""
    for _ in range(40):
        rig.wait(2e-3)
        try:
            sample = servo.exchange(PUSH)
            old += made[round(sample.motor_position / (2.0 * np.pi))] < sample.t - 1e-3
        except (NoReply, BadReply) as error:
            said += str(error)
    assert old <= 3
    assert "an old answer" in said
    servo.disarm()


def test_a_second_axis_that_comes_onto_the_bus_in_the_run_is_noticed(make_odrive: Make) -> None:
    rig = make_odrive()
    servo = armed(rig)
    rig.bus.faults.inject(DuplicateReplies(count=50))
    rig.wait(2e-3)
    servo.exchange(PUSH)
    rig.wait(2e-3)
    with pytest.raises(BadReply, match="a second drive with the same id"):
        servo.exchange(PUSH)


def test_cyclic_messages_of_torque_are_no_offence(make_odrive: Make) -> None:
    rig = make_odrive()
    rig.device.endpoints.put("axis0.config.can.torques_msg_rate_ms", 10.0)
    servo = armed(rig)
    for _ in range(50):
        rig.wait(2e-3)
        assert servo.exchange(PUSH).motor_torque > 0.0


def test_whatever_happens_to_the_replies_no_sample_is_old_and_idle_works(make_odrive: Make) -> None:
    rng = np.random.default_rng(3)
    kinds = (DelayReplies, DropReplies, DuplicateReplies, TruncateReplies, DropRequests)
    accepted = 0
    for _ in range(10):
        rig = make_odrive()
        servo = armed(rig)
        made = numbered(rig.device, rig)
        for kind in rng.choice(np.array(kinds), size=4):
            rig.bus.faults.inject(kind(after=int(rng.integers(60)), count=int(rng.integers(1, 4))))
        for _ in range(60):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            accepted += 1
            assert made[round(sample.motor_position / (2.0 * np.pi))] >= sample.t - 1e-3
        rig.bus.faults.clear()
        servo.disarm()
        assert rig.device.state == IDLE
    assert accepted > 400


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_an_error_in_the_run_is_a_fault_with_its_code_and_the_axis_is_idle(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    servo = armed(rig)
    bits = OVERSPEED[rig.device.layout]
    rig.device.fail(bits)
    with pytest.raises(DeviceFault, match="faster than its limit") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == bits
    servo.disarm()
    assert rig.device.state == IDLE


def test_overheating_turns_the_torque_off_and_says_so(make_odrive: Make) -> None:
    rig = make_odrive()
    servo = armed(rig)
    rig.device.motor.warm_to(121.0)
    with pytest.raises(DeviceFault, match="too hot") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == OVERHEAT["0.6"]


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_an_axis_that_reboots_in_the_run_is_a_fault(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    servo = armed(rig)
    rig.bus.faults.inject(Reboots())
    with pytest.raises(DeviceFault, match="restarted") as caught:
        ask_through_gaps(rig, servo, 400)
    assert caught.value.code == RESTARTED
    assert rig.device.state == IDLE
    servo.close()


@pytest.mark.parametrize("fault", [BusOff(), Unplug()])
def test_a_bus_that_is_gone_is_a_lost_link_and_close_is_harmless(make_odrive: Make, fault: WireFault) -> None:
    rig = make_odrive()
    servo = armed(rig)
    rig.bus.faults.inject(fault)
    with pytest.raises(LinkLost, match="cut the"):
        ask_through_gaps(rig, servo, 3)
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    servo.close()
    servo.close()


# -- stopping -------------------------------------------------------------------------------------------------------


def test_when_the_client_vanishes_the_watchdog_takes_the_torque_away(make_odrive: Make, tmp_path: Path) -> None:
    path = tmp_path / "endpoints.json"
    path.write_text(json.dumps(flat_endpoints("0.6.10")), encoding="utf-8")
    rig = make_odrive()
    servo = armed(rig, endpoints=str(path))
    rig.wait(0.095)
    assert rig.device.motor.torque > 0.0
    rig.wait(0.01)
    assert rig.device.motor.torque == 0.0
    with pytest.raises(DeviceFault, match="heard nothing") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == WATCHDOG["0.6"]


def test_an_idle_that_is_not_done_is_said_loudly(make_odrive: Make) -> None:
    rig = make_odrive()
    servo = armed(rig)
    rig.device.ignores_idle = True
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    assert abs(rig.device.motor.torque) < 1e-3  # zero torque was asked for as well
    servo.close()


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_torque_off_gets_through_though_frames_are_lost(make_odrive: Make, lost: int) -> None:
    rig = make_odrive()
    servo = armed(rig)
    rig.bus.faults.inject(DropRequests(count=lost))
    servo.disarm()
    assert rig.device.state == IDLE
