"""Control Table Backup (0x20) and Reboot (0x08), byte by byte, as the e-manual and the MX firmware have them."""

from __future__ import annotations

import pytest

from sim_backend.wire.dynamixel.device import BOOT, DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.packets.frames import Error, packet, status

STORE = bytes.fromhex("FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5")
RESTORE = bytes.fromhex("FF FF FD 00 01 08 00 20 02 43 54 52 4C 9E F5")
DONE = bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C")
"""The packets of the e-manual's two examples; the checksum that it prints for the second, 92 F5, is wrong."""


def bus_of(model: str = "xc330-t288", firmware: int | None = None) -> tuple[PacketBus, DynamixelDevice]:
    device = DynamixelDevice(model, firmware=firmware)
    return PacketBus([device]), device


def answered(bus: PacketBus, request: bytes, now: float) -> bytes:
    return b"".join(reply.data for reply in bus.receive(request, now))


@pytest.mark.parametrize(("model", "firmware"), [("xc330-t288", None), ("xm430-w350", 45), ("xl430-w250", 47)])
def test_a_backup_is_stored_and_restored_as_in_the_manuals_examples(model: str, firmware: int | None) -> None:
    bus, device = bus_of(model, firmware)
    device.write(9, b"\x07")
    assert answered(bus, STORE, 0.1) == DONE
    assert device.registers.get("backup_ready") == 1
    device.write(9, b"\x63")
    assert answered(bus, RESTORE, 0.2) == DONE
    assert answered(bus, packet(1, b"\x01"), 0.2 + 0.5 * BOOT) == b""  # it reboots
    assert answered(bus, packet(1, b"\x01"), 0.3 + BOOT) != b""
    assert device.registers.get("return_delay_time") == 7
    assert device.registers.get("backup_ready") == 1


def test_without_a_backup_a_restore_fails_and_nothing_reboots() -> None:
    bus, device = bus_of()
    assert device.registers.get("backup_ready") == 0
    assert answered(bus, RESTORE, 0.1) == status(1, Error.RESULT_FAIL)
    assert answered(bus, packet(1, b"\x01"), 0.11) != b""


@pytest.mark.parametrize("request_", [STORE, RESTORE])
def test_with_the_torque_on_both_fail(request_: bytes) -> None:
    bus, device = bus_of()
    answered(bus, STORE, 0.05)
    device.write(64, b"\x01")
    assert answered(bus, request_, 0.1) == status(1, Error.RESULT_FAIL)
    assert device.motor.enabled


@pytest.mark.parametrize("parameters", [b"", b"\x01", b"\x03CTRL", b"\x01ctrl", b"\x01CTRL\x00"])
def test_a_backup_without_its_fixed_values_is_refused(parameters: bytes) -> None:
    bus, device = bus_of()
    assert answered(bus, packet(1, b"\x20" + parameters), 0.1) == status(1, Error.DATA_RANGE)
    assert device.registers.get("backup_ready") == 0


@pytest.mark.parametrize(("model", "firmware"), [("xc330-t288", 45), ("xm430-w350", 44)])
def test_an_older_firmware_does_not_know_the_instruction(model: str, firmware: int) -> None:
    bus, _ = bus_of(model, firmware)
    assert answered(bus, STORE, 0.1) == status(1, Error.INSTRUCTION)


@pytest.mark.parametrize(("startup", "gain"), [(0, 400), (2, 555)])
def test_gains_come_back_at_power_up_where_startup_configuration_says_so(startup: int, gain: int) -> None:
    bus, device = bus_of()
    device.write(60, bytes([startup]))
    device.write(84, (555).to_bytes(2, "little"))
    answered(bus, STORE, 0.1)
    device.reboot(1.0)
    assert device.registers.get("position_p_gain") == gain
    assert device.registers.get("goal_current") == 0


def mx_packet(*body: int) -> bytes:
    return b"\xff\xff" + bytes([*body, 0xFF - sum(body) % 256])


@pytest.mark.parametrize("model", ["mx-64", "mx-106"])
def test_an_mx_with_firmware_40_or_later_reboots(model: str) -> None:
    device = MxDevice(model, firmware=40)
    bus = PacketBus([device], protocol=1)
    device.write(24, b"\x01")
    assert answered(bus, mx_packet(1, 2, 0x08), 0.1) == mx_packet(1, 2, 0)
    assert not device.motor.enabled
    assert answered(bus, mx_packet(1, 2, 0x01), 0.15) == b""
    assert answered(bus, mx_packet(1, 2, 0x01), 0.2 + BOOT) == mx_packet(1, 2, 0)


def test_an_older_mx_refuses_to_reboot() -> None:
    device = MxDevice("mx-64", firmware=39)
    device.write(24, b"\x01")
    assert answered(PacketBus([device], protocol=1), mx_packet(1, 2, 0x08), 0.1) == mx_packet(1, 2, 0x40)
    assert device.motor.enabled
