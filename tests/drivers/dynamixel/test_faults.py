"""Everything that issue and manual say can go wrong: a counted gap or a named error with its remedy, the torque off."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.faults import RESTARTED, WATCHDOG
from drivers.dynamixel.models import POSITION_LSB
from drivers.dynamixel.servo import DynamixelServo
from drivers.servo import (
    BadReply,
    Command,
    DeviceFault,
    DriverError,
    Limits,
    LinkLost,
    NoReply,
    Quantity,
)
from drivers.uart.port import POLL
from sim_backend.wire.dynamixel.bus import DynamixelBus, Reply
from sim_backend.wire.dynamixel.device import OVERHEAT, OVERLOAD, VOLTAGE, DynamixelDevice
from sim_backend.wire.faults import (
    CorruptReplies,
    DelayReplies,
    DropReplies,
    DropRequests,
    DuplicateReplies,
    NoiseBefore,
    Reboots,
    TruncateReplies,
    Unplug,
    WireFault,
)
from sim_backend.wire.uart.pty_line import PtyLine

Rig = Any
Make = Callable[..., Rig]
PUSH = Command(Quantity.TORQUE, 0.01)


def config(port: Path | str, **changes: Any) -> DynamixelConfig:
    return DynamixelConfig(port=str(port), model="xl330-m288", **changes)


def armed(rig: Rig, limits: Limits, **changes: Any) -> DynamixelServo:
    servo: DynamixelServo = rig.open(**changes)
    servo.arm(limits)
    rig.wait(2e-3)
    servo.exchange(PUSH)
    return servo


def ask_through_gaps(servo: DynamixelServo, tries: int) -> None:
    """Go on as a recorder does, until something ends it."""
    for _ in range(tries):
        with contextlib.suppress(NoReply, BadReply):
            servo.exchange(PUSH)


# -- opening --------------------------------------------------------------------------------------------------------


def test_a_port_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="there is no such port"):
        DynamixelServo(config(tmp_path / "nothing"))


def test_a_file_that_is_no_port_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("not a port")
    with pytest.raises(DriverError, match="cannot be opened"):
        DynamixelServo(config(path))


def test_a_port_without_permission_says_which_group_to_join(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port: Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DriverError, match="dialout"):
        DynamixelServo(config("/dev/ttyUSB0"))


def test_a_port_that_another_program_holds_is_refused(tmp_path: Path) -> None:
    bus = DynamixelBus([])
    with PtyLine(tmp_path / "tty", bus) as line:
        bus.devices.append(DynamixelDevice("xl330-m288", now=line.now()))
        first = DynamixelServo(config(line.link, reply_timeout=0.3, watchdog=1.0))
        with pytest.raises(DriverError, match="another program has it open"):
            DynamixelServo(config(line.link))
        first.close()


def test_the_wrong_baud_rate_is_no_reply_that_names_the_factorys(make_rig: Make) -> None:
    with pytest.raises(NoReply, match="57600 baud"):
        make_rig(baudrate=57600).open(baudrate=1_000_000)


def test_nobody_at_that_id_is_no_reply_and_the_port_is_let_go_of(rig: Rig) -> None:
    with pytest.raises(NoReply, match="no servo 9 answers"):
        rig.open(id=9)
    assert rig.port.opened == 0


def test_the_wrong_model_is_an_error_that_names_both(make_rig: Make) -> None:
    with pytest.raises(DriverError, match=r"xm430-w210 \(model number 1030\), not the xl330-m288"):
        make_rig("xm430-w210").open(model="xl330-m288")


@pytest.mark.parametrize("other", ["xm430-w210", "xl330-m288"])
def test_two_servos_at_one_id_are_told_from_one(rig: Rig, other: str) -> None:
    rig.bus.devices.append(DynamixelDevice(other, now=0.0))
    rig.bus.devices[1].registers.put("homing_offset", 1234)
    with pytest.raises(BadReply, match="two servos with that id"):
        rig.open()


def test_firmware_without_a_watchdog_is_refused_unless_the_watchdog_is_given_up(make_rig: Make) -> None:
    rig = make_rig("xm430-w350", firmware=36)
    with pytest.raises(DriverError, match="firmware 36"):
        rig.open()
    rig.open(watchdog=0.0).close()


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"model": "ax-12"}, "dynamixel.model"),
        ({"baudrate": 4_500_000}, "dynamixel.baudrate"),
        ({"model": "xl430-w250", "mode": "current"}, "dynamixel.mode"),
        ({"watchdog": 0.01}, "dynamixel.watchdog"),
    ],
)
def test_a_table_that_cannot_work_is_refused_with_its_key(changes: dict[str, Any], key: str) -> None:
    with pytest.raises(ValueError, match=key):
        replace(config("p"), **changes)


# -- arming ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bits", "word"), [(OVERLOAD, "load"), (VOLTAGE, "supply"), (OVERHEAT, "hot"), (0x40, "unknown error bits 0x40")]
)
def test_a_latched_hardware_error_keeps_it_from_arming(rig: Rig, limits: Limits, bits: int, word: str) -> None:
    servo = rig.open()
    rig.device.fail(bits)
    with pytest.raises(DeviceFault, match=word) as caught:
        servo.arm(limits)
    assert caught.value.code == bits
    assert not rig.device.torque_on
    servo.close()


def test_a_register_that_refuses_stops_the_arming_with_the_torque_off(rig: Rig, limits: Limits) -> None:
    servo = rig.open()
    rig.device.write(64, b"\x01")  # somebody left it on
    items = rig.device.registers._items
    items[38] = replace(items[38], high=10)
    with pytest.raises(DriverError, match="refused writing 83 to 38"):
        servo.arm(limits)
    assert not rig.device.torque_on


def test_a_reply_lost_at_any_point_of_the_arming_leaves_the_torque_off(make_rig: Make, limits: Limits) -> None:
    rig = make_rig()
    rig.open().arm(limits)
    replies = rig.bus.faults.replies
    for number in range(replies):
        rig = make_rig()
        rig.bus.faults.inject(DropReplies(after=number))
        try:
            servo = rig.open()
            servo.arm(limits)
        except NoReply:
            assert not rig.device.torque_on
        else:
            assert rig.device.motor.torque == 0.0
            servo.close()


def test_a_torque_limit_below_one_count_is_refused(rig: Rig) -> None:
    with pytest.raises(DriverError, match="below one count"):
        rig.open().arm(Limits(torque=1e-4, velocity=1.0, temperature=60.0, position=(-1.0, 1.0)))


# -- running --------------------------------------------------------------------------------------------------------


def test_silence_becomes_no_reply_within_its_deadline_and_one_lost_reply_is_only_that(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.bus.faults.inject(DropReplies())
    begin = rig.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(PUSH)
    assert rig.clock.now() - begin <= 0.008 + 69 * 10e-6 + 2 * POLL
    assert servo.exchange(PUSH).motor_torque > 0.0


@pytest.mark.parametrize(
    "fault",
    [CorruptReplies(), TruncateReplies(keep=20), TruncateReplies(keep=37), TruncateReplies(keep=5)],
)
def test_a_damaged_reply_is_a_gap_and_the_next_one_is_good(rig: Rig, limits: Limits, fault: WireFault) -> None:
    servo = armed(rig, limits)
    rig.bus.faults.inject(fault)
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    assert servo.exchange(PUSH).motor_position == rig.device.registers.get("present_position") * POSITION_LSB


def test_a_request_that_arrives_damaged_is_a_gap_and_not_the_end(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    write = rig.port.writePort
    rig.port.writePort = lambda data: write(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(BadReply, match="damaged"):
        servo.exchange(PUSH)
    rig.port.writePort = write
    servo.exchange(PUSH)


def test_noise_before_a_reply_is_passed_over(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.bus.faults.inject(NoiseBefore(noise=b"\x00\x55\xff\xff\xfd\x13\x37"))
    assert servo.exchange(PUSH).motor_torque > 0.0


def test_a_late_reply_is_never_taken_for_the_next_answer(rig: Rig, limits: Limits) -> None:
    for late in np.arange(0.0075, 0.06, 0.0005):
        rig.bus.faults.clear()
        servo = armed(rig, limits)
        rig.bus.faults.inject(DelayReplies(seconds=float(late)))
        for _ in range(30):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            assert sample.motor_position == rig.device.registers.get("present_position") * POSITION_LSB
        servo.close()


def test_whatever_happens_to_the_replies_no_sample_is_wrong_and_torque_off_works(
    make_rig: Make, limits: Limits
) -> None:
    rng = np.random.default_rng(11)
    kinds = (CorruptReplies, DelayReplies, DropReplies, DuplicateReplies, NoiseBefore, TruncateReplies, DropRequests)
    accepted = 0
    for _ in range(12):
        rig = make_rig()
        servo = armed(rig, limits)
        for kind in rng.choice(np.array(kinds), size=4):
            rig.bus.faults.inject(kind(after=int(rng.integers(60)), count=int(rng.integers(1, 4))))
        for _ in range(80):
            rig.wait(2e-3)
            try:
                sample = servo.exchange(PUSH)
            except (NoReply, BadReply):
                continue
            accepted += 1
            assert sample.motor_position == rig.device.registers.get("present_position") * POSITION_LSB
        rig.bus.faults.clear()
        servo.disarm()
        assert not rig.device.torque_on
    assert accepted > 700


def test_no_mutated_reply_is_taken_for_a_sample(rig: Rig) -> None:
    rng = np.random.default_rng(5)
    servo = rig.open()
    receive = rig.bus.receive

    def mutated(data: bytes, now: float, baudrate: int | None) -> list[Reply]:
        out = []
        for at, reply in receive(data, now, baudrate):
            damaged = bytearray(reply)
            for place in rng.integers(len(reply), size=int(rng.integers(1, 4))):
                damaged[place] ^= int(rng.integers(1, 256))
            kept = damaged[: int(rng.integers(1, len(reply) + 1))] if rng.random() < 0.3 else damaged
            out.append(Reply(at, bytes(kept)))
        return out

    for _ in range(1500):
        rig.bus.receive = mutated
        with pytest.raises((BadReply, NoReply)):
            servo.exchange(Command.rest())
        rig.bus.receive = receive
    servo.exchange(Command.rest())


def test_a_line_that_never_falls_silent_is_named_and_does_not_hold_us(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)

    def noise(length: int) -> bytes:
        rig.clock.sleep_until(rig.clock.now() + 1e-5 * length)
        return b"\xff\xff\xfd\x00\x01\x08\x00\x55"[:length].ljust(length, b"\xff")

    rig.port.read = noise
    begin = rig.clock.now()
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    with pytest.raises(BadReply, match="never falls silent"):
        servo.exchange(PUSH)
    assert rig.clock.now() - begin < 0.5
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    assert not rig.device.torque_on  # it heard, though nobody could hear it


@pytest.mark.parametrize("counts", [-131073, 0xFFFD - 0x10000, -3, -1])
def test_replies_that_need_stuffing_are_read_right(rig: Rig, counts: int) -> None:
    rig.device.registers.put("homing_offset", counts)
    rig.device.registers.put("goal_velocity", -515)  # FD FD behind the position: the SDK loses bytes of this one
    servo = rig.open()
    assert servo.exchange(Command.rest()).motor_position == counts * POSITION_LSB


def test_set_points_that_need_stuffing_arrive(rig: Rig) -> None:
    servo = rig.open(mode="extended-position")
    servo.arm(Limits(torque=0.1, velocity=40.0, temperature=65.0, position=(-400.0, 400.0)))
    for counts in (-131073, -65539, -3, -1, 0xFDFF):
        servo.exchange(Command(Quantity.POSITION, counts * POSITION_LSB))
        assert rig.device.registers.get("goal_position") == counts
    assert b"\xff\xff\xfd\xfd" in rig.port.sent


def test_a_hardware_error_in_the_run_is_a_fault_with_its_code_and_the_torque_is_off(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.device.fail(OVERLOAD)
    with pytest.raises(DeviceFault, match="load") as caught:
        servo.exchange(PUSH)
    assert caught.value.code == OVERLOAD
    servo.disarm()
    servo.close()
    assert not rig.device.torque_on


def test_overheating_turns_the_torque_off_and_says_so(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.device.motor.warm_to(66.0)
    rig.wait(2e-3)
    assert not rig.device.torque_on
    with pytest.raises(DeviceFault, match="hot"):
        servo.exchange(PUSH)


@pytest.mark.parametrize("mute", [False, True])
def test_a_servo_that_reboots_in_the_run_is_a_fault(rig: Rig, limits: Limits, mute: bool) -> None:
    servo = armed(rig, limits)
    rig.bus.faults.inject(Reboots())
    with pytest.raises(NoReply):
        servo.exchange(PUSH)
    if mute:  # it is back before the host asks again
        rig.wait(0.35)
    with pytest.raises(DeviceFault) as caught:
        ask_through_gaps(servo, 100)
    assert caught.value.code == RESTARTED
    assert not rig.device.torque_on
    servo.close()


def test_a_servo_that_restarts_between_two_ticks_is_noticed(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits, watchdog=0.0)
    rig.wait(1.0)
    rig.device.reboot(rig.clock.now() - 0.5)
    with pytest.raises(DeviceFault) as caught:
        servo.exchange(PUSH)
    assert caught.value.code == RESTARTED


def test_torque_that_another_program_left_on_is_off_once_the_servo_is_opened(rig: Rig) -> None:
    rig.device.write(64, b"\x01")
    rig.open()
    assert not rig.device.torque_on


# -- stopping -------------------------------------------------------------------------------------------------------


def test_when_the_client_vanishes_the_watchdog_takes_the_current_away(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.wait(0.09)
    assert rig.device.motor.torque > 0.0
    rig.wait(0.03)
    assert rig.device.tripped
    assert abs(rig.device.motor.torque) < 1e-6
    with pytest.raises(DeviceFault, match="heard nothing") as caught:
        servo.exchange(PUSH)
    assert caught.value.code == WATCHDOG
    servo.close()
    assert not rig.device.tripped


def test_a_watchdog_that_does_not_stop_the_motor_is_still_noticed(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.device.watchdog_broken = True
    rig.wait(0.2)
    assert rig.device.motor.torque > 0.0
    with pytest.raises(DeviceFault):
        servo.exchange(PUSH)
    servo.disarm()
    assert not rig.device.torque_on


def test_a_torque_off_that_is_not_done_is_said_loudly(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.device.ignores_torque_off = True
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    servo.close()


@pytest.mark.parametrize("lost", [1, 2])
def test_torque_off_gets_through_though_replies_are_lost(rig: Rig, limits: Limits, lost: int) -> None:
    servo = armed(rig, limits)
    rig.bus.faults.inject(DropReplies(count=lost))
    servo.disarm()
    assert not rig.device.torque_on


def test_a_pulled_cable_is_a_lost_link_and_close_is_harmless(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.bus.faults.inject(Unplug())
    with pytest.raises((LinkLost, NoReply)):
        servo.exchange(PUSH)
    with pytest.raises(LinkLost):
        servo.exchange(PUSH)
    with pytest.raises(LinkLost, match="cut the drive's power"):
        servo.disarm()
    servo.close()
    servo.close()
    rig.wait(0.2)
    assert abs(rig.device.motor.torque) < 1e-6


def test_a_pulled_cable_is_a_lost_link_on_a_real_port(tmp_path: Path, limits: Limits) -> None:
    bus = DynamixelBus([])
    with PtyLine(tmp_path / "tty", bus) as line:
        bus.devices.append(DynamixelDevice("xl330-m288", now=line.now()))
        servo = DynamixelServo(config(line.link, reply_timeout=0.3, watchdog=1.0))
        servo.arm(limits)
        with line.lock:
            bus.faults.inject(Unplug())
        with pytest.raises(LinkLost):
            ask_through_gaps(servo, 3)
        servo.close()
        servo.close()
