"""The emulated axis, byte by byte, held against the vendor's firmware 0.5.6, its DBC and its can_enumerate.py."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from sim_backend.wire.can_families import odrive as serve
from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.odrive.device import BROADCAST, ESTOP, OdriveDevice
from sim_backend.wire.odrive.endpoints import flat_endpoints
from sim_backend.wire.odrive.states import CLOSED_LOOP, IDLE

ESTOP_COMMAND, ADDRESS, STATE, MODE, INPUT_POS, INPUT_VEL, TORQUE = 0x02, 0x06, 0x07, 0x0B, 0x0C, 0x0D, 0x0E
REBOOT, CLEAR = 0x16, 0x18
SUCCESS, BUSY, CANCELLED, NO_ENDSTOP, INVALID = 0, 1, 2, 12, 13
FIRMWARES = ["0.5.6", "0.6.10"]


def tell(device: OdriveDevice, command: int, data: bytes = b"", now: float = 0.1) -> list[CanFrame]:
    return device.handle(CanFrame(device.ident << 5 | command, data), now)


def driven(firmware: str = "0.6.10", mode: int = 1) -> OdriveDevice:
    device = OdriveDevice(3, firmware=firmware)
    tell(device, MODE, struct.pack("<II", mode, 1))
    tell(device, STATE, struct.pack("<I", CLOSED_LOOP))
    assert device.state == CLOSED_LOOP
    return device


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("data", [b"", bytes(8)])
def test_estop_clear_errors_and_reboot_act_whatever_their_length(firmware: str, data: bytes) -> None:
    device = driven(firmware)
    assert tell(device, ESTOP_COMMAND, data) == []
    assert (device.state, device.errors) == (IDLE, ESTOP[device.layout])
    assert tell(device, CLEAR, data) == []
    assert device.errors == 0
    assert tell(device, REBOOT, data) == []
    assert tell(device, 0x09, now=0.2) == []  # it boots
    assert len(tell(device, 0x09, now=1.0)) == 1


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_command_that_lacks_its_data_does_nothing(firmware: str) -> None:
    device = driven(firmware)
    tell(device, TORQUE, struct.pack("<f", 0.2))
    for command in (STATE, MODE, INPUT_POS, INPUT_VEL, TORQUE):
        tell(device, command)
    assert device.state == CLOSED_LOOP
    assert device.motor.demand == pytest.approx(0.2)


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_position_brings_its_feed_forward_and_an_old_torque_does_not_stay(firmware: str) -> None:
    device = driven(firmware)
    tell(device, TORQUE, struct.pack("<f", 0.3))
    tell(device, MODE, struct.pack("<II", 3, 1))
    tell(device, INPUT_POS, struct.pack("<fhh", 0.0, 0, 0))
    assert device.motor.demand == pytest.approx(0.0, abs=1e-6)
    tell(device, INPUT_POS, struct.pack("<fhh", 0.0, 0, 250))
    assert device.motor.demand == pytest.approx(0.25, rel=1e-6)
    tell(device, INPUT_POS, struct.pack("<fhh", 0.0, -1500, 0))
    gain = device.endpoints.get("axis0.controller.config.vel_gain")
    assert device.motor.demand == pytest.approx(-1.5 * gain, rel=1e-6)
    tell(device, INPUT_VEL, struct.pack("<ff", 0.0, 0.1))
    assert device.motor.demand == pytest.approx(0.1, rel=1e-6)


def test_position_control_begins_where_the_motor_is() -> None:
    device = driven()
    tell(device, TORQUE, struct.pack("<f", 0.2))
    device.advance(1.0)
    turned = device.motor.position
    assert turned > 0.0
    tell(device, TORQUE, struct.pack("<f", 0.0), 1.0)
    tell(device, MODE, struct.pack("<II", 3, 1), 1.0)
    device.advance(3.0)
    loop, joint = 20.0 / 6.0 / (2.0 * math.pi), 0.8  # N m/rad: pos_gain times vel_gain, and the joint against it
    assert device.motor.position == pytest.approx(turned * loop / (loop + joint), rel=0.05)


def introductions(bus: CanBus, begin: float) -> dict[int, int]:
    """Ask all for their addresses; return the node ids by serial number."""
    asked = bus.receive(CanFrame(BROADCAST << 5 | ADDRESS, remote=True), begin) + bus.advance(begin + 0.1)
    replies = [delivery.frame for delivery in asked if delivery.frame.ident & 0x1F == ADDRESS]
    assert not any(delivery.frame.error for delivery in asked)
    return {int.from_bytes(reply.data[1:7], "little"): reply.data[0] for reply in replies}


def assign(bus: CanBus, serial: int, ident: int, now: float) -> None:
    bus.receive(CanFrame(BROADCAST << 5 | ADDRESS, bytes([ident]) + serial.to_bytes(6, "little")), now)


def test_every_drive_answers_at_the_broadcast_address_and_takes_the_id_that_its_serial_number_is_given() -> None:
    bus = CanBus([OdriveDevice(0, serial=0x385F_0000_0001), OdriveDevice(1, serial=0x385F_0000_0002)])
    assert introductions(bus, 0.1) == {0x385F_0000_0001: 0, 0x385F_0000_0002: 1}
    assign(bus, 0x385F_0000_0001, 7, 0.3)
    assert introductions(bus, 0.4) == {0x385F_0000_0001: 7, 0x385F_0000_0002: 1}
    # who already has the id becomes unaddressed
    assign(bus, 0x385F_0000_0001, 1, 0.6)
    assert introductions(bus, 0.7) == {0x385F_0000_0001: 1, 0x385F_0000_0002: BROADCAST}
    assign(bus, 0x385F_0000_0002, 2, 0.9)
    assert introductions(bus, 1.0) == {0x385F_0000_0001: 1, 0x385F_0000_0002: 2}


def test_drives_without_an_id_are_found_beside_each_other_and_are_silent_otherwise() -> None:
    bus = CanBus([OdriveDevice(BROADCAST, serial=serial) for serial in (5, 6, 1000)])
    assert bus.advance(1.0) == []
    assert introductions(bus, 1.0) == dict.fromkeys((5, 6, 1000), BROADCAST)


def test_estop_at_the_broadcast_address_stops_every_drive_with_firmware_0_6_only() -> None:
    drives: list[Any] = [driven("0.6.10"), driven("0.6.11"), driven("0.5.6")]
    CanBus(drives).receive(CanFrame(BROADCAST << 5 | ESTOP_COMMAND), 0.2)
    assert [drive.state for drive in drives] == [IDLE, IDLE, CLOSED_LOOP]


def test_erasing_the_configuration_takes_the_id_away() -> None:
    device = OdriveDevice(3)
    device.endpoints.put("axis0.config.can.heartbeat_msg_rate_ms", 17.0)
    tell(device, REBOOT, b"\x02")
    assert device.ident == BROADCAST
    assert device.endpoints.get("axis0.config.can.heartbeat_msg_rate_ms") == 100.0


def test_firmware_0_5_6_takes_its_node_id_from_the_message_of_that_number() -> None:
    device = OdriveDevice(3, firmware="0.5.6")
    tell(device, ADDRESS, struct.pack("<I", 9))
    assert device.ident == 9
    assert device.handle(CanFrame(3 << 5 | 0x09, remote=True), 0.2) == []
    (reply,) = tell(device, 0x09, now=0.2)
    assert reply.ident == 9 << 5 | 0x09


def test_the_axes_that_are_served_differ_in_their_serial_numbers() -> None:
    serials = {drive.serial for drive in _made((0, 1, 2))}
    assert len(serials) == 3
    assert all(serial < 1 << 48 and math.isfinite(serial) for serial in serials)


def _made(idents: tuple[int, ...]) -> list[OdriveDevice]:
    made = [serve.make("0.6.10", ident, None, 0.0) for ident in idents]
    assert all(isinstance(drive, OdriveDevice) for drive in made)
    return made  # type: ignore[return-value]  # checked above


def test_position_control_keeps_to_the_velocity_limit() -> None:
    device = driven(mode=3)
    tell(device, 0x0F, struct.pack("<ff", 0.5, 50.0))
    tell(device, INPUT_POS, struct.pack("<fhh", 10.0, 0, 0))
    gain = device.endpoints.get("axis0.controller.config.vel_gain")
    assert device.motor.demand == pytest.approx(0.5 * gain, rel=1e-6)


def heartbeat(device: OdriveDevice, now: float) -> tuple[int, int, int]:
    """Errors, state and procedure result (0.5.6: motor flag) of the last heartbeat before `now`."""
    beats = [frame.data for t in (now - 0.1, now) for frame in device.unasked(t) if frame.ident & 0x1F == 0x01]
    errors, state, result = struct.unpack("<IBB", beats[-1][:6])
    return errors, state, result


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize(
    ("request_", "passed", "seconds"), [(3, [4, 7], 13.25), (4, [4], 4.25), (7, [7], 9.0), (2, [], 0.0)]
)
def test_a_procedure_that_is_requested_in_closed_loop_ends_it_and_leaves_the_axis_idle(
    firmware: str, request_: int, passed: list[int], seconds: float
) -> None:
    device = driven(firmware)
    tell(device, TORQUE, struct.pack("<f", 0.2))
    tell(device, STATE, struct.pack("<I", request_))
    assert not device.motor.enabled
    seen: list[int] = []
    for tick in range(1, int(5 * seconds) + 3):
        _, state, result = heartbeat(device, 0.1 + 0.2 * tick)
        seen += [state] if state not in seen else []
        assert state != IDLE or 0.2 * tick > seconds - 0.1
        assert firmware == "0.5.6" or result == (SUCCESS if state == IDLE else BUSY)
    assert seen == [*passed, IDLE]
    assert device.errors == 0


@pytest.mark.parametrize(
    ("request_", "error", "result"), [(11, 0x20000, NO_ENDSTOP), (12, 1, INVALID), (99, 1, INVALID)]
)
def test_a_state_that_the_axis_cannot_enter_ends_closed_loop_too(request_: int, error: int, result: int) -> None:
    for firmware in FIRMWARES:
        device = driven(firmware)
        tell(device, STATE, struct.pack("<I", request_))
        errors, state, outcome = heartbeat(device, 0.2)
        assert (state, device.motor.enabled) == (IDLE, False)
        assert (errors, outcome) == ((error, 0) if firmware == "0.5.6" else (0, result))
    tell(device, STATE, struct.pack("<I", 0))
    assert device.state == IDLE


def test_a_calibration_can_be_cancelled_and_is_needed_before_closed_loop() -> None:
    device = OdriveDevice(3)
    device.calibrated = False
    for request_ in (CLOSED_LOOP, 7):
        tell(device, STATE, struct.pack("<I", request_))
        assert heartbeat(device, 0.3)[1:] == (IDLE, 14)
    tell(device, STATE, struct.pack("<I", 3), 0.3)
    tell(device, STATE, struct.pack("<I", IDLE), 5.0)
    assert heartbeat(device, 5.1)[1:] == (IDLE, CANCELLED)
    tell(device, STATE, struct.pack("<I", 3), 5.1)
    assert heartbeat(device, 18.5)[1:] == (IDLE, SUCCESS)
    tell(device, STATE, struct.pack("<I", CLOSED_LOOP), 18.5)
    assert device.state == CLOSED_LOOP


def test_parameters_report_and_request_the_state_and_take_what_messages_write() -> None:
    device = driven()
    numbers = {name: row["id"] for name, row in flat_endpoints("0.6.10")["endpoints"].items()}  # type: ignore[attr-defined]  # JSON is object

    def sdo(writes: int, name: str, value: bytes = bytes(4)) -> bytes:
        replies = tell(device, 0x04, struct.pack("<BHB4s", writes, numbers[name], 0, value), 0.2)
        return replies[0].data[4:] if replies else b""

    assert sdo(0, "axis0.current_state")[0] == CLOSED_LOOP
    sdo(1, "axis0.requested_state", b"\x01")
    assert (device.state, sdo(0, "axis0.current_state")[0]) == (IDLE, IDLE)
    tell(device, 0x12, struct.pack("<ff", 3.0, 4.0))
    assert struct.unpack("<f", sdo(0, "axis0.trap_traj.config.decel_limit")) == (4.0,)
    sdo(1, "axis0.config.can.torques_msg_rate_ms", struct.pack("<I", 20))
    assert [frame.ident & 0x1F for frame in device.unasked(0.23)].count(0x1C) == 1
