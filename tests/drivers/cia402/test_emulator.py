"""The emulated drives, frame by frame: the statuswords of an EPOS2, and the modes that a drive has."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from sim_backend.wire.can_families import cia402 as serve
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.cia402.device import FOLLOWING_ERROR, Cia402Device
from sim_backend.wire.cia402.machine import Cia402State

OPERATIONAL = 0x01
EPOS2 = {"disabled": 0x0140, "ready": 0x0121, "on": 0x0123, "enabled": 0x0137, "quick stop": 0x0117, "fault": 0x0108}
"""Firmware Specification, April 2010, 8.1.1: the bits that tell the states apart, 0, 1, 2, 3, 4, 5, 6, 8 and 14."""
TELLING = 0x417F


def written(device: Cia402Device, index: int, data: bytes, now: float) -> bytes:
    """Write an object by expedited SDO; return the reply."""
    size = 0x23 | (4 - len(data)) << 2
    frame = CanFrame(0x601, bytes([size]) + struct.pack("<HB", index, 0) + data.ljust(4, b"\0"))
    (reply,) = device.handle(frame, now)
    return reply.data


def read(device: Cia402Device, index: int, now: float) -> int:
    (reply,) = device.handle(CanFrame(0x601, b"\x40" + struct.pack("<HB4x", index, 0)), now)
    return int.from_bytes(reply.data[4:], "little")


def booted(model: str) -> Cia402Device:
    device = Cia402Device(model, 1)
    device.unasked(0.5)
    return device


def test_an_epos2_tells_its_states_by_the_statuswords_of_its_specification() -> None:
    device = booted("epos2")
    word = {"disabled": read(device, 0x6041, 1.0)}
    for step, (name, control) in enumerate({"ready": 0x06, "on": 0x07, "enabled": 0x0F, "quick stop": 0x0B}.items()):
        written(device, 0x6040, struct.pack("<H", control), 2.0 + step)
        word[name] = read(device, 0x6041, 2.9 + step)
    device.fail(FOLLOWING_ERROR)
    word["fault"] = read(device, 0x6041, 7.0)
    assert {name: value & TELLING for name, value in word.items()} == EPOS2


def test_an_epos2_is_remote_while_its_node_is_operational() -> None:
    device = booted("epos2")
    assert not read(device, 0x6041, 1.0) & 0x200
    device.handle(CanFrame(0x000, bytes([OPERATIONAL, 1])), 1.1)
    assert read(device, 0x6041, 1.2) & 0x200


@pytest.mark.parametrize(("model", "mode", "bit"), [("epos4", 10, 9), ("epos2", -3, 18), ("generic", 10, 9)])
def test_a_drive_claims_the_mode_whose_objects_it_has_and_refuses_the_others(model: str, mode: int, bit: int) -> None:
    device = booted(model)
    assert device.model.mode == mode
    assert read(device, 0x6502, 1.0) == 1 << bit
    assert written(device, 0x6060, struct.pack("<b", mode), 1.1)[0] == 0x60
    for other in (-1, -2, 3, 4, 6, 8, 9):
        assert written(device, 0x6060, struct.pack("<b", other), 1.2)[0] == 0x80
    assert read(device, 0x6061, 1.3) & 0xFF == mode & 0xFF


def test_a_heartbeat_that_stays_away_is_a_latched_fault_on_time() -> None:
    device = Cia402Device()
    device.objects.write(0x1016, 1, struct.pack("<I", 0x7F << 16 | 100))
    device.advance(5.0)  # nothing is watched before the first beat
    device.handle(CanFrame(0x77F, b"\x05"), 5.0)
    device.advance(5.0999)
    assert device.objects.get(0x1003) == 0
    assert device.due() == pytest.approx(5.1)
    (emcy,) = device.unasked(device.due())
    assert struct.unpack_from("<HB", emcy.data) == (0x8130, 0x11)
    assert device.machine.state is Cia402State.FAULT


@pytest.mark.parametrize(
    ("option", "state"),
    [(6, Cia402State.QUICK_STOP_ACTIVE), (2, Cia402State.SWITCH_ON_DISABLED), (0, Cia402State.SWITCH_ON_DISABLED)],
)
def test_a_quick_stop_ends_as_its_option_code_says(option: int, state: Cia402State) -> None:
    device = Cia402Device()
    device.objects.put(0x6060, 0, 10)
    device.objects.put(0x605A, 0, option)
    for number, word in enumerate((0x06, 0x0F), 1):
        device.objects.write(0x6040, 0, struct.pack("<H", word))
        device.advance(0.1 * number)
    assert device.motor.enabled
    device.objects.write(0x6040, 0, struct.pack("<H", 0x02))
    assert device.machine.state is state
    assert device.motor.enabled == (state is Cia402State.QUICK_STOP_ACTIVE)


def test_what_cannot_be_emulated_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="choose one of epos4"):
        serve(tmp_path / "tty", "epos5")
    with pytest.raises(ValueError, match="not 1 to 127"):
        serve(tmp_path / "tty", "epos4", (0,))
