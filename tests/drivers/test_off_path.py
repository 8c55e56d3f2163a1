"""The off path of every adapter: bytes that another process sends, without a reply, and their effect on the drive."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.canbus.off_path import datagram, from_slcan_text, slcan_text
from drivers.odrive.messages import endpoint_names
from drivers.off_path import HasJournal, HasOffPath, OffPath
from drivers.servo import Command, Quantity
from sim_backend.wire.odrive.endpoints import flat_endpoints

from .conftest import IN_VIRTUAL_TIME, ODRIVE_LIMITS, Wired, odrive_rig, sampled, wired_rig

SERIAL = ("dynamixel", "dynamixel mx", "feetech hls", "commander")
CAN = (
    "odrive 0.5.6",
    "odrive 0.6.10",
    "mit ak80-9",
    "mit dm-j4310",
    "robstride",
    "moteus",
    "cia402 epos4",
    "cia402 epos2",
)


def driven(name: str) -> Wired:
    """A drive that turns its motor."""
    wired = IN_VIRTUAL_TIME[name]()
    wired.servo.arm(wired.limits)
    for _ in range(5):
        wired.servo.exchange(Command(Quantity.TORQUE, 0.5 * wired.limits.torque))
        wired.wait(2e-3)
    assert wired.live()
    assert abs(wired.device.motor.commanded) > 0.1 * wired.limits.torque
    return wired


def path_of(wired: Wired) -> OffPath:
    assert isinstance(wired.servo, HasOffPath)
    return wired.servo.off_path()


@pytest.mark.parametrize("name", [*SERIAL, *CAN])
def test_the_frames_switch_the_torque_off_without_a_reply(name: str) -> None:
    wired = driven(name)
    for packet in path_of(wired).off:
        wired.put(packet)
    wired.wait(5e-3)
    assert not wired.live()
    assert wired.device.motor.commanded == 0.0
    wired.servo.close()


@sampled(6)
@pytest.mark.parametrize("name", SERIAL)
def test_a_request_that_was_cut_off_anywhere_does_not_hide_the_second_sending(name: str, nth: int) -> None:
    for cut in range(1, 24, nth):
        wired = driven(name)
        path = path_of(wired)
        servo: Any = wired.servo
        request = bytes(servo._port.sent[-60:]) if hasattr(servo, "_port") else b"M0.123456\nMMG7\nME\n"
        header = request.find(b"\xff\xff")
        wired.put(request[max(0, header) :][:cut])
        for _ in range(2):
            for packet in (path.resync, *path.off):
                wired.put(packet)
        wired.wait(5e-3)
        assert not wired.live(), cut
        wired.servo.close()


def settings(device: Any) -> Any:
    """What a drive keeps in memory that a run may change, as far as a later program relies on it."""
    if hasattr(device, "registers"):
        return {name: device.registers.get(name) for name in ("operating_mode", "current_limit", "velocity_limit")} | {
            "watchdog": device.registers.get("bus_watchdog")
        }
    if hasattr(device, "eeprom"):
        return device.eeprom()
    if hasattr(device, "endpoints"):
        return {name: device.endpoints.get(name) for name in endpoint_names().values()}
    if hasattr(device, "console"):
        return {name: str(float(value)) for name, value in device.console.values.items()}  # NaN equals no NaN
    if hasattr(device, "objects"):
        return [device.objects.get(*place) for place in ((0x6060, 0), (0x1016, 1)) if place in device.objects.values]
    return {number: round(value, 3) for number, value in device.values.items()}  # temperatures among them


@pytest.mark.parametrize("name", ["dynamixel", "dynamixel mx", "feetech hls", *CAN])
def test_the_drive_has_the_settings_again_that_closing_it_leaves(name: str) -> None:
    wired, closed = driven(name), driven(name)
    assert_restored(wired, closed)


def test_an_odrive_with_its_endpoint_file_has_the_parameters_again_that_closing_it_leaves(tmp_path: Path) -> None:
    path = tmp_path / "flat_endpoints.json"
    path.write_text(json.dumps(flat_endpoints("0.6.10")))
    wired, closed = (
        wired_rig(odrive_rig(), ODRIVE_LIMITS, lambda rig: rig.open(endpoints=str(path))) for _ in range(2)
    )
    before = settings(wired.device)
    for one in (wired, closed):
        one.servo.arm(one.limits)
    assert settings(wired.device) != before
    assert_restored(wired, closed)
    assert wired.device.life.watchdog_state == closed.device.life.watchdog_state == "off"


class Killed(BaseException):
    pass


def killed_while_arming(wired: Wired, writes: int) -> list[OffPath]:
    """Arm until that many settings were written; return the paths that a guardian knew of, one before each write."""
    assert isinstance(wired.servo, HasJournal)
    paths: list[OffPath] = []

    def journal() -> None:
        if len(paths) == writes:
            raise Killed
        paths.append(path_of(wired))

    wired.servo.keep_journal(journal)
    with contextlib.suppress(Killed):
        wired.servo.arm(wired.limits)
    return paths


@pytest.mark.parametrize(
    "name", ["dynamixel", "dynamixel mx", "feetech hls", "mit dm-j4310", "robstride", "moteus", "cia402 epos4"]
)
def test_a_drive_has_its_settings_again_whichever_of_them_was_the_last_written_before_a_kill(name: str) -> None:
    closed = IN_VIRTUAL_TIME[name]()
    closed.servo.close()
    closed.wait(0.5)
    before = settings(closed.device)
    for writes in range(1, 30):
        wired = IN_VIRTUAL_TIME[name]()
        paths = killed_while_arming(wired, writes)
        if len(paths) < writes:
            break
        for packet in (*paths[-1].off, *paths[-1].restore):
            wired.put(packet)
            wired.wait(0.03)
        wired.wait(0.5)
        assert settings(wired.device) == before, writes
        assert not wired.live()
        wired.servo.close()
    assert writes > 1
    wired.servo.close()


def test_an_odrive_that_was_killed_while_it_was_armed_has_its_parameters_again(tmp_path: Path) -> None:
    path = tmp_path / "flat_endpoints.json"
    path.write_text(json.dumps(flat_endpoints("0.6.10")))
    wired = wired_rig(odrive_rig(), ODRIVE_LIMITS, lambda rig: rig.open(endpoints=str(path)))
    before = settings(wired.device)
    known = killed_while_arming(wired, 3)[-1]
    assert settings(wired.device) != before
    for packet in (*known.off, *known.restore):
        wired.put(packet)
        wired.wait(0.03)
    assert settings(wired.device) == before
    wired.servo.close()


def assert_restored(wired: Wired, closed: Wired) -> None:
    path = path_of(wired)
    closed.servo.close()
    for packet in (*path.off, *path.restore):
        wired.put(packet)
        wired.wait(0.03)
    closed.wait(0.5)
    wired.wait(0.5)
    assert settings(wired.device) == settings(closed.device)
    assert not wired.live()
    wired.servo.close()


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False),
        can.Message(arbitration_id=0x12345678, data=bytes(8), is_extended_id=True),
        can.Message(arbitration_id=0x7, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x8001, data=bytes(12), is_extended_id=True, is_fd=True, bitrate_switch=True),
        can.Message(arbitration_id=0x80, data=bytes(64), is_extended_id=False, is_fd=True),
    ],
    ids=str,
)
def test_a_frame_written_as_text_for_a_serial_adapter_reads_back_as_itself(message: can.Message) -> None:
    assert from_slcan_text(slcan_text(message)).equals(message, timestamp_delta=None)
    assert datagram(message)


def test_a_drive_in_this_process_cannot_be_reached_from_another() -> None:
    wired = IN_VIRTUAL_TIME["moteus"]()
    assert not path_of(wired).reachable
    wired.servo.close()
