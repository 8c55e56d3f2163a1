"""An ODrive axis over its emulator: what goes over the wire, what is written before it is driven, what is read back."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.servo import DriverError, Limits, NoReply
from sim_backend.wire.odrive.device import OdriveDevice
from sim_backend.wire.odrive.endpoints import flat_endpoints
from sim_backend.wire.odrive.states import CLOSED_LOOP, IDLE

from ..conftest import torque

Make = Callable[..., Any]
LIMITS = Limits(torque=0.4, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
FIRMWARES = ["0.5.6", "0.6.10"]


@pytest.fixture
def endpoints(tmp_path: Path) -> str:
    path = tmp_path / "flat_endpoints.json"
    path.write_text(json.dumps(flat_endpoints("0.6.10")), encoding="utf-8")
    return str(path)


def test_frames_are_those_of_the_vendors_examples() -> None:
    """can_simple.py: node 0; id 0x07, <I 8> for closed loop; id 0x0E torque; heartbeat <IBBB>, estimates <ff>."""
    device = OdriveDevice(0, now=0.0)
    (encoder,) = device.handle(_frame(0x09, remote=True), 0.1)
    assert struct.unpack("<ff", encoder.data) == (0.0, 0.0)
    assert device.handle(_frame(0x07, struct.pack("<I", 8)), 0.1) == []
    (beat,) = [frame for frame in device.unasked(device.due()) if frame.ident == 0x01]
    assert struct.unpack("<IBBB", beat.data[:7])[:2] == (0, 8)
    device.handle(_frame(0x0B, struct.pack("<II", 1, 1)), 0.2)
    device.handle(_frame(0x0E, struct.pack("<f", 0.1)), 0.2)
    device.advance(1.2)
    (torques,) = device.handle(_frame(0x1C, remote=True), 1.2)
    assert struct.unpack("<ff", torques.data) == pytest.approx((0.1, 0.1), rel=1e-3)


def _frame(ident: int, data: bytes = b"", *, remote: bool = False) -> Any:
    from sim_backend.wire.canbus.frames import CanFrame

    return CanFrame(ident, data, remote=remote)


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_speed_and_current_limits_reach_the_axis(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    rig.open().arm(LIMITS)
    get = rig.device.endpoints.get
    assert get("axis0.controller.config.vel_limit") == pytest.approx(60.0 / (2 * math.pi))
    assert get("axis0.config.motor.current_soft_max") == pytest.approx(0.4 / 0.04)
    assert rig.device.state == CLOSED_LOOP
    assert rig.device.motor.torque == 0.0


def test_with_the_vendors_endpoint_file_limits_and_watchdog_are_written_read_back_and_put_back(
    make_odrive: Make, endpoints: str
) -> None:
    rig = make_odrive()
    get = rig.device.endpoints.get
    servo = rig.armed(LIMITS, endpoints=endpoints)
    assert get("axis0.config.torque_soft_max") == pytest.approx(0.4)
    assert get("axis0.config.torque_soft_min") == pytest.approx(-0.4)
    assert get("axis0.motor.motor_thermistor.config.temp_limit_upper") == 80.0
    assert (get("axis0.config.enable_watchdog"), get("axis0.config.watchdog_timeout")) == (1.0, pytest.approx(0.1))
    servo.close()
    assert math.isinf(get("axis0.config.torque_soft_max"))
    assert get("axis0.config.enable_watchdog") == 0.0
    assert get("axis0.motor.motor_thermistor.config.temp_limit_upper") == 120.0


def test_a_firmware_that_confirms_writes_is_understood_too(make_odrive: Make, tmp_path: Path) -> None:
    path = tmp_path / "flat_endpoints.json"
    path.write_text(json.dumps(flat_endpoints("0.6.11")), encoding="utf-8")
    rig = make_odrive("0.6.11")
    rig.open(endpoints=str(path)).arm(LIMITS)
    assert rig.device.endpoints.get("axis0.config.torque_soft_max") == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "not the vendor's flat_endpoints"),
        ("not json", "not the vendor's flat_endpoints"),
        (json.dumps(flat_endpoints("0.6.9")), "for firmware 0.6.9, and the drive has 0.6.10"),
        (json.dumps({"fw_version": "0.6.10", "endpoints": {}}), "lacks axis0"),
    ],
)
def test_an_endpoint_file_that_does_not_fit_is_refused(
    make_odrive: Make, tmp_path: Path, content: str, words: str
) -> None:
    path = tmp_path / "file.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(DriverError, match=words):
        make_odrive().open(endpoints=str(path))


def test_a_speed_limit_that_would_clip_the_torque_is_refused(make_odrive: Make, endpoints: str) -> None:
    rig = make_odrive()
    servo = rig.open(endpoints=endpoints)
    slow = Limits(torque=0.4, velocity=10.0, temperature=80.0, position=(-3.0, 3.0))
    with pytest.raises(DriverError, match="enable_torque_mode_vel_limit"):
        servo.arm(slow)
    assert rig.device.state == IDLE
    rig.device.endpoints.put("axis0.controller.config.enable_torque_mode_vel_limit", 0.0)
    servo.arm(slow)


def test_a_torque_constant_that_is_not_the_drives_is_refused(make_odrive: Make, endpoints: str) -> None:
    with pytest.raises(DriverError, match=r"0\.05 N m/A in the stand file and 0\.04 in the drive"):
        make_odrive().open(endpoints=endpoints, torque_constant=0.05)


def test_a_parameter_that_is_refused_stops_the_arming_with_the_axis_idle(make_odrive: Make, endpoints: str) -> None:
    rig = make_odrive()
    servo = rig.open(endpoints=endpoints)
    rig.device.endpoints.refused.add("axis0.config.torque_soft_min")
    with pytest.raises(DriverError, match="torque_soft_min"):
        servo.arm(LIMITS)
    assert rig.device.state == IDLE


def test_one_tick_is_five_frames_and_their_time_on_the_wire(make_odrive: Make) -> None:
    rig = make_odrive()
    servo = rig.armed(LIMITS)
    rig.wait(3e-3)
    before, begin = len(rig.port.sent), rig.clock.now()
    servo.exchange(torque(0.1))
    assert len(rig.port.sent) - before <= 4
    # with all stuff bits 135 for 8 bytes, 55 for a remote frame; turnaround and the adapter's latency beside
    wire = (3 * 135 + 2 * 55) * 1e-6 + 2 * 5e-5 + 1e-4
    assert rig.clock.now() - begin == pytest.approx(wire, abs=2e-4)


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_an_axis_with_a_heartbeat_of_half_a_second_is_proven_off_and_one_of_1_s_is_refused(
    make_odrive: Make, firmware: str
) -> None:
    rig = make_odrive(firmware)
    rig.device.endpoints.put("axis0.config.can.heartbeat_msg_rate_ms", 1000.0)
    with pytest.raises(DriverError, match=r"a heartbeat every 1 s.+heartbeat_msg_rate_ms = 100"):
        rig.open()
    rig.device.endpoints.put("axis0.config.can.heartbeat_msg_rate_ms", 500.0)
    servo = rig.armed(LIMITS)
    for _ in range(20):
        rig.wait(2e-3)
        servo.exchange(torque(0.1))
    assert rig.motor.enabled
    servo.disarm()
    assert not rig.motor.enabled
    servo.close()


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_an_axis_without_a_heartbeat_is_told_from_one_that_does_not_answer(make_odrive: Make, firmware: str) -> None:
    rig = make_odrive(firmware)
    rig.device.endpoints.put("axis0.config.can.heartbeat_msg_rate_ms", 0.0)
    rig.device._next["heartbeat"] = math.inf
    with pytest.raises(NoReply, match=r"axis 0 answers, but sends no heartbeat within 2\.5 s.+heartbeat_msg_rate_ms"):
        rig.open()
