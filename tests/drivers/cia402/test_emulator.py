"""The emulated drives, frame by frame: the statuswords of an EPOS2, and the modes that a drive has."""

from __future__ import annotations

import struct

import pytest

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.cia402.device import FOLLOWING_ERROR, Cia402Device

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
