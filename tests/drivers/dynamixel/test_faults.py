"""Faults that only a DYNAMIXEL on a serial line has; those of every drive are in test_fault_contract.py."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.models import POSITION_LSB
from drivers.dynamixel.servo import DynamixelServo
from drivers.servo import BadReply, Command, DeviceFault, DriverError, Limits, LinkLost, NoReply, Quantity
from sim_backend.fault_plan import FaultPlan, PlannedFault
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.faults import DelayReplies, NoiseBefore, Unplug
from sim_backend.wire.packets.bus import PacketBus, Reply
from sim_backend.wire.uart.pty_line import PtyLine

from ..conftest import SERVO_LIMITS, new_rig, sampled

Rig = Any
Make = Callable[..., Rig]
PUSH = Command(Quantity.TORQUE, 0.01)


def config(port: Path | str, **changes: Any) -> DynamixelConfig:
    return DynamixelConfig(port=str(port), model="xl330-m288", **changes)


def armed(rig: Rig, limits: Limits, **changes: Any) -> DynamixelServo:
    servo: DynamixelServo = rig.armed(limits, **changes)
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


def test_a_port_without_permission_names_the_group_to_join(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port: Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DriverError, match="dialout"):
        DynamixelServo(config("/dev/ttyUSB0"))


def test_a_port_that_another_program_holds_is_refused(tmp_path: Path) -> None:
    bus = PacketBus([])
    with PtyLine(tmp_path / "tty", bus) as line:
        bus.devices.append(DynamixelDevice("xl330-m288", now=line.now()))
        first = DynamixelServo(config(line.link, reply_timeout=0.3, watchdog=1.0))
        with pytest.raises(DriverError, match="open in this program already"):
            DynamixelServo(config(line.link))
        first.close()


def test_the_wrong_baud_rate_is_no_reply_that_names_the_factorys(make_rig: Make) -> None:
    with pytest.raises(NoReply, match="57600 baud"):
        make_rig(baudrate=57600).open(baudrate=1_000_000)


def test_the_wrong_model_is_an_error_that_names_both(make_rig: Make) -> None:
    with pytest.raises(DriverError, match=r"xm430-w210 \(model number 1030\), not the xl330-m288"):
        make_rig("xm430-w210").open(model="xl330-m288")


def test_firmware_without_a_watchdog_is_refused_unless_the_watchdog_is_given_up(make_rig: Make) -> None:
    rig = make_rig("xm430-w350", firmware=36)
    with pytest.raises(DriverError, match="firmware 36"):
        rig.open()
    rig.open(watchdog=0.0).close()


# -- running --------------------------------------------------------------------------------------------------------


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


@sampled(6)
def test_no_mutated_reply_is_taken_for_a_sample(rig: Rig, nth: int) -> None:
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

    for _ in range(1500 // nth):
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

    rig.port.ser.read = noise
    begin = rig.clock.now()
    with pytest.raises((BadReply, NoReply)):
        servo.exchange(PUSH)
    with pytest.raises(BadReply, match="never falls silent"):
        servo.exchange(PUSH)
    assert rig.clock.now() - begin < 0.5
    with pytest.raises(DriverError, match="cut the drive's power"):
        servo.disarm()
    assert not rig.device.motor.enabled  # it received the request, though its replies were lost


@pytest.mark.parametrize("counts", [-131073, 0xFFFD - 0x10000, -3, -1])
def test_replies_that_need_stuffing_are_read_right(rig: Rig, counts: int) -> None:
    rig.device.registers.put("homing_offset", counts)
    rig.device.registers.put("goal_velocity", -515)  # FD FD behind the position: the SDK loses bytes of this one
    servo = rig.open()
    assert servo.exchange(Command.rest()).motor_position == counts * POSITION_LSB


def test_set_points_that_need_stuffing_arrive(rig: Rig) -> None:
    servo = rig.armed(
        Limits(torque=0.1, velocity=40.0, temperature=65.0, position=(-400.0, 400.0)), mode="extended-position"
    )
    for counts in (-131073, -65539, -3, -1, 0xFDFF):
        servo.exchange(Command(Quantity.POSITION, counts * POSITION_LSB))
        assert rig.device.registers.get("goal_position") == counts
    assert b"\xff\xff\xfd\xfd" in rig.port.sent


# -- stopping -------------------------------------------------------------------------------------------------------


def test_a_watchdog_that_does_not_stop_the_motor_is_still_noticed(rig: Rig, limits: Limits) -> None:
    servo = armed(rig, limits)
    rig.device.motor.follow_plan(FaultPlan([PlannedFault("broken-watchdog", at=0.0)]))
    rig.wait(0.2)
    assert rig.device.motor.torque > 0.0
    with pytest.raises(DeviceFault):
        servo.exchange(PUSH)
    servo.disarm()
    assert not rig.device.motor.enabled


def test_a_pulled_cable_is_a_lost_link_on_a_real_port(tmp_path: Path, limits: Limits) -> None:
    bus = PacketBus([])
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


def test_a_reply_that_comes_late_is_never_taken_for_a_setting_or_for_an_error() -> None:
    """Taken for the temperature limit, it would be written to the memory of the servo at the end, and 23 degC above it
    be too hot.
    """
    for nth in range(40):
        rig = new_rig()
        memory, servo = bytes(rig.device.registers.memory[:64]), rig.open()
        rig.faults.inject(DelayReplies(after=nth, seconds=0.03))
        with contextlib.suppress(NoReply, BadReply):
            servo.arm(SERVO_LIMITS)
        servo.close()
        rig.wait(0.1)
        assert bytes(rig.device.registers.memory[:64]) == memory, nth
