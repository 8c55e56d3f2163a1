"""A RobStride motor over its emulator: frames against the maker's manual, limits that arrive, what is refused."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.robstride import frames
from drivers.robstride.frames import Codec, models
from drivers.servo import BadReply, Command, DeviceFault, DriverError, Limits
from sim_backend.wire.can_families import robstride as serve
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.robstride.device import (
    CANOPEN,
    MIT,
    OVERHEAT,
    OVERVOLTAGE,
    STALL,
    UNCALIBRATED,
    UNDERVOLTAGE,
    RobstrideDevice,
)
from sim_backend.wire.robstride.tables import MODELS

from ..conftest import torque

Make = Callable[..., Any]
LIMITS = Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0))


def put(rig: Any, kind: int, field: int, to: int) -> None:
    """A frame of another program or motor arrives."""
    message = can.Message(arbitration_id=frames.identifier(kind, field, to), data=bytes(8), is_extended_id=True)
    receive, waiting = rig.port._recv_internal, [message]
    rig.port._recv_internal = lambda timeout: (waiting.pop(), False) if waiting else receive(timeout)


def test_both_sides_know_the_same_motors() -> None:
    """Two tables written apart: a slip in one of them shows here."""
    assert set(models()) == set(serve.known)
    for name, model in models().items():
        assert (model.velocity, model.torque) == MODELS[name].span[:2]
        assert MODELS[name].firmware[: len(model.line)] == model.line


def test_identifiers_are_those_of_the_manual_and_of_a_capture() -> None:
    assert frames.identifier(frames.READ, 0xFD, 0x7F) == 0x1100FD7F  # the manual's example, 4.1.14
    assert frames.parts(0x11007FFD) == (frames.READ, 0x7F, 0xFD)
    assert frames.parts(0x20_07E854 >> 3) == (frames.STOP, 0xFD, 10)  # MotorStudio and an RS03
    state = Codec(frames.position_range((0, 3, 1, 41)), 20.0, 60.0).state(0x000A, bytes.fromhex("a6d4808c7fff0140"))
    assert (state.temperature, state.faults, state.mode) == (32.0, 0, frames.STOPPED)
    assert state.position == pytest.approx(0xA6D4 / 65535 * 25.1327 - 12.5664, abs=1e-3)
    assert abs(state.torque) < 120.0 / 65535


def test_the_range_of_the_angle_follows_the_firmware() -> None:
    assert frames.position_range((0, 0, 2, 5)) == 12.5
    assert (
        frames.position_range((0, 0, 2, 6)) == frames.position_range((0, 3, 1, 41)) == pytest.approx(12.566, abs=1e-3)
    )


def test_what_the_motor_has_parameters_for_is_written_read_back_and_put_back(make_robstride: Make) -> None:
    rig = make_robstride()
    rig.device.values |= {"run_mode": 5.0, "limit_torque": 3.0, "canTimeout": 1.0}
    servo = rig.armed(LIMITS)
    names = ("run_mode", "limit_torque", "canTimeout")
    assert [rig.device.values[name] for name in names] == [0.0, 2.0, 2000.0]
    servo.close()
    assert [rig.device.values[name] for name in names] == [5.0, 3.0, 1.0]


def test_a_watchdog_of_zero_leaves_the_motors_own_and_says_so(make_robstride: Make) -> None:
    rig = make_robstride()
    servo = rig.armed(LIMITS, watchdog=0.0)
    assert rig.device.values["canTimeout"] == 0.0
    assert (servo.info.watchdog, servo.info.watchdog_remedy) == (0.0, "set robstride.watchdog = 0.1")


def test_a_limit_of_the_motor_does_not_bind_in_operation_mode_and_ours_does(make_robstride: Make) -> None:
    rig = make_robstride()
    servo = rig.armed(LIMITS, torque_scale=0.5)
    assert servo.exchange(torque(1e9)).status
    assert rig.motor.demand == pytest.approx(4.0, abs=1e-3)


def test_no_torque_is_sent_to_a_motor_that_is_not_armed_and_a_tick_is_one_frame_each_way(make_robstride: Make) -> None:
    rig = make_robstride()
    servo = rig.open()
    servo.exchange(Command.rest())
    kinds = {frames.parts(message.arbitration_id)[0] for message in rig.port.sent}
    assert kinds == {frames.IDENTITY, frames.STOP, frames.REPORTING}
    servo.arm(LIMITS)
    before = len(rig.port.sent)
    servo.exchange(torque(0.5))
    assert len(rig.port.sent) - before == 1


def test_the_motor_of_another_line_is_refused_unless_its_ranges_are_given(make_robstride: Make) -> None:
    rig = make_robstride("rs03")
    with pytest.raises(DriverError, match=r"firmware 0\.3\.1\.41, and that of an rs04 begins with 0\.4"):
        rig.open(model="rs04")
    rig.open(model="rs04", torque_range=60.0).close()


def test_an_old_firmware_has_another_range_and_one_that_does_not_tell_is_refused(make_robstride: Make) -> None:
    rig = make_robstride(firmware=(0, 0, 2, 5))
    rig.device._zero = -7.0
    servo = rig.open()
    assert servo.info.position_lsb == pytest.approx(25.0 / 65535)
    assert servo.exchange(Command.rest()).motor_position == pytest.approx(7.0, abs=1e-3)
    rig.device._zero = -20.0
    with pytest.raises(BadReply, match="end of its range"):
        servo.exchange(Command.rest())
    servo.close()
    silent = make_robstride()
    private = silent.device._private
    silent.device._private = lambda kind, field, data: private(kind, field, b"\0" * 8 if kind == 4 else data)
    with pytest.raises(DriverError, match=r"robstride\.position_range to 12\.5 rad"):
        silent.open()
    assert silent.open(position_range=12.5).info.firmware == ""


@pytest.mark.parametrize(("protocol", "words"), [(MIT, r"MIT frames.*001#FF"), (CANOPEN, r"CANopen.*00000FFF#01")])
def test_a_motor_in_another_protocol_is_recognised_and_the_way_back_is_said(
    make_robstride: Make, protocol: int, words: str
) -> None:
    rig = make_robstride(protocol=protocol)
    with pytest.raises(DriverError, match=f"motor 1 speaks {words}.*switch its power off and on"):
        rig.open()
    assert rig.closed


def test_a_fault_latched_before_it_is_opened_keeps_it_from_arming(make_robstride: Make) -> None:
    for bit, code, words in (
        (OVERHEAT, 4, "too hot"),
        (UNDERVOLTAGE, 1, "too low"),
        (UNCALIBRATED, 32, "not calibrated"),
        (STALL, 16, "too high for too long"),
        (OVERVOLTAGE, 8, "encoder failed"),
    ):
        rig = make_robstride()
        rig.device.fail(bit)
        rig.device._fault_due = float("inf")
        servo = rig.open()
        with pytest.raises(DeviceFault, match=words) as caught:
            servo.arm(LIMITS)
        assert caught.value.code == code
        assert not rig.motor.enabled


def test_a_fault_frame_alone_is_a_fault(make_robstride: Make) -> None:
    rig = make_robstride()
    servo = rig.armed(LIMITS)
    rig.device.fail(512)  # no bit of a feedback tells it
    rig.wait(2e-3)
    with pytest.raises(DeviceFault, match="angle at power-on could not be found") as caught:
        servo.exchange(torque(0.1))
    assert caught.value.code == frames.REPORTED | 512


@pytest.mark.parametrize(
    ("kind", "field", "to", "words"),
    [(kind, 0xAA, 1, "host id 170") for kind in (3, 4, 18)]
    + [(2, 1, 0xAA, "host id 170"), (1, 0x9000, 1, "its set-points carry no host id")],
)
def test_a_second_host_is_noticed_by_its_commands_and_by_its_replies(
    make_robstride: Make, kind: int, field: int, to: int, words: str
) -> None:
    rig = make_robstride()
    put(rig, kind, field, to)
    with pytest.raises(DeviceFault, match=rf"another program \({words}\) commands motor 1"):
        rig.open()
    servo = rig.armed(LIMITS)
    put(rig, 1, frames.Codec(12.5, 33.0, 14.0).torque.of(0.0), 1)  # the guardian's
    servo.exchange(torque(0.1))
    put(rig, kind, field, to)
    with pytest.raises(DeviceFault, match=words):
        servo.exchange(torque(0.1))
    servo.disarm()
    assert not rig.motor.enabled


def test_frames_of_other_motors_and_hosts_disturb_nothing(make_robstride: Make) -> None:
    rig = make_robstride()
    servo = rig.armed(LIMITS)
    for kind, field, to in ((2, 2, 0xFD), (2, 2, 0xAA), (3, 0xAA, 2), (17, 2, 0xFD), (21, 2, 0xFD), (24, 1, 0xFD)):
        put(rig, kind, field, to)
        assert servo.exchange(torque(0.1)).motor_torque is not None


def test_the_refusal_of_a_read_is_no_value(make_robstride: Make) -> None:
    """A captured one: 0x110115FD with eight bytes of zero."""
    rig = make_robstride(ident=21)
    (refusal,) = rig.device.handle(CanFrame(0x1100FD15, b"\x03\x10" + bytes(6), extended=True), 0.0)
    assert (refusal.ident, refusal.data) == (0x110115FD, bytes(8))
    del rig.device._items[0x7028]
    servo = rig.open(id=21)
    with pytest.raises(DriverError, match=r"no parameter canTimeout \(0x7028\): update its firmware"):
        servo.arm(LIMITS)
    assert not rig.motor.enabled


def test_a_value_that_is_no_number_is_refused(make_robstride: Make) -> None:
    rig = make_robstride()
    rig.device.values["limit_torque"] = float("nan")
    with pytest.raises(BadReply, match="no number in limit_torque"):
        rig.open().arm(LIMITS)
    assert not rig.motor.enabled


def test_reports_that_another_program_asked_for_are_ended(make_robstride: Make) -> None:
    rig = make_robstride()
    rig.device.handle(CanFrame(0x1800FD01, bytes([1, 2, 3, 4, 5, 6, 1, 8]), extended=True), 0.0)
    rig.wait(0.05)
    servo = rig.armed(LIMITS)
    rig.wait(0.05)
    assert rig.device.due() == float("inf")
    servo.exchange(torque(0.1))
    servo.close()


def test_two_motors_on_one_bus_are_distinguished_by_their_id(make_robstride: Make) -> None:
    rig = make_robstride()
    rig.bus.nodes.append(RobstrideDevice("rs00", 2, serial=2))
    rig.bus.nodes[1]._zero = 1.0
    first, second = rig.open(), rig.open(id=2)
    assert first.exchange(Command.rest()).motor_position == pytest.approx(0.0, abs=1e-3)
    assert second.exchange(Command.rest()).motor_position == pytest.approx(-1.0, abs=1e-3)
    assert second.info.serial == struct.pack("<Q", 2).hex()


def test_the_page_on_it_shows_the_counts_that_are_used() -> None:
    page = (Path(__file__).parents[3] / "docs" / "robstride.md").read_text(encoding="utf-8")
    for name, model in models().items():
        codec = Codec(frames.position_range(()), model.velocity, model.torque)
        label = "el05 (EduLite 05)" if name == "el05" else name
        row = f"| {label} | {model.velocity:g} | {model.torque:g} | {codec.torque.lsb * 1e3:.3g} mN m "
        assert row + f"| {model.torque_uncertainty:.0%} |" in page
