"""The emulator on a pty against the vendor's own client."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dynamixel_sdk import (
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    PortHandler,
    Protocol2PacketHandler,
)

from sim_backend.wire.dynamixel.device import OVERLOAD, DynamixelDevice
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.uart.pty_line import PtyLine

pytestmark = pytest.mark.study
PACKETS = Protocol2PacketHandler()


@pytest.fixture
def line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, PacketBus]]:
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 100)  # ms; patience on a busy machine
    bus = PacketBus([])
    with PtyLine(tmp_path / "ttyDXL", bus) as served:
        now = served.now()
        bus.devices += [
            DynamixelDevice("xl330-m288", 1, now=now),
            DynamixelDevice("xm430-w210", 2, firmware=38, now=now),
            DynamixelDevice("xl430-w250", 7, now=now),
        ]
        port = PortHandler(str(served.link))
        port.openPort()
        try:
            yield port, bus
        finally:
            port.closePort()


def test_ping_and_broadcast_ping_find_every_servo(line: tuple[Any, PacketBus]) -> None:
    port, _ = line
    assert PACKETS.ping(port, 2) == (1030, COMM_SUCCESS, 0)
    assert PACKETS.ping(port, 3)[1] == COMM_RX_TIMEOUT
    assert PACKETS.broadcastPing(port) == ({1: [1200, 46], 2: [1030, 38], 7: [1060, 45]}, COMM_SUCCESS)


def test_reads_and_writes_keep_to_the_control_table(line: tuple[Any, PacketBus]) -> None:
    port, _ = line
    assert PACKETS.write2ByteTxRx(port, 1, 38, 500) == (COMM_SUCCESS, 0)
    assert PACKETS.read2ByteTxRx(port, 1, 38) == (500, COMM_SUCCESS, 0)
    assert PACKETS.write2ByteTxRx(port, 1, 38, 1751) == (COMM_SUCCESS, 4)  # above the model's range
    assert PACKETS.write2ByteTxRx(port, 1, 102, 501) == (COMM_SUCCESS, 6)  # above Current Limit(38)
    assert PACKETS.write1ByteTxRx(port, 1, 0, 1) == (COMM_SUCCESS, 7)  # read only
    assert PACKETS.write1ByteTxRx(port, 1, 116, 1) == (COMM_SUCCESS, 5)  # one byte of four
    assert PACKETS.write1ByteTxRx(port, 7, 11, 0) == (COMM_SUCCESS, 4)  # no current mode on an XL430
    assert PACKETS.write1ByteTxRx(port, 1, 64, 1) == (COMM_SUCCESS, 0)
    assert PACKETS.write1ByteTxRx(port, 1, 11, 0) == (COMM_SUCCESS, 7)  # EEPROM with the torque on


def test_sync_and_fast_sync_and_bulk_and_fast_bulk_read(line: tuple[Any, PacketBus]) -> None:
    port, bus = line
    bus.devices[1].registers.put("homing_offset", -3)
    bus.devices[2].registers.put("homing_offset", -4)
    for idents in ((1, 2, 7), (1, 7)):
        group = GroupSyncRead(port, PACKETS, 132, 4)
        for ident in idents:
            group.addParam(ident)
        is_new = 2 not in idents  # its firmware 38 has no fast reads
        for read in (group.txRxPacket, group.fastSyncRead) if is_new else (group.txRxPacket,):
            assert read() == COMM_SUCCESS
            assert [group.getData(i, 132, 4) for i in idents] == [{1: 0, 2: 2**32 - 3, 7: 2**32 - 4}[i] for i in idents]
    bulk = GroupBulkRead(port, PACKETS)
    bulk.addParam(1, 144, 2)
    bulk.addParam(7, 146, 1)
    for read in (bulk.txRxPacket, bulk.fastBulkRead):
        assert read() == COMM_SUCCESS
        assert (bulk.getData(1, 144, 2), bulk.getData(7, 146, 1)) == (50, 23)


def test_sync_and_bulk_write_and_reg_write_with_action(line: tuple[Any, PacketBus]) -> None:
    port, _ = line
    sync = GroupSyncWrite(port, PACKETS, 65, 1)
    for ident in (1, 2):
        sync.addParam(ident, [1])
    assert sync.txPacket() == COMM_SUCCESS
    bulk = GroupBulkWrite(port, PACKETS)
    bulk.addParam(1, 84, 2, [0x20, 0x03])
    bulk.addParam(7, 31, 1, [60])
    assert bulk.txPacket() == COMM_SUCCESS
    assert PACKETS.regWriteTxRx(port, 2, 84, 2, [0x0A, 0x00]) == (COMM_SUCCESS, 0)
    assert PACKETS.read1ByteTxRx(port, 2, 69)[0] == 1
    assert PACKETS.read2ByteTxRx(port, 2, 84)[0] == 800
    assert PACKETS.action(port, 2) == COMM_SUCCESS
    port.ser.timeout = 1.0
    assert len(port.ser.read(11)) == 11  # the SDK does not wait for this answer and would take it for the next one
    port.ser.timeout = 0
    assert PACKETS.read1ByteTxRx(port, 2, 69)[0] == 0
    assert [PACKETS.read1ByteTxRx(port, ident, 65)[0] for ident in (1, 2, 7)] == [1, 1, 0]
    assert PACKETS.read2ByteTxRx(port, 1, 84)[0] == 800
    assert PACKETS.read2ByteTxRx(port, 2, 84)[0] == 10
    assert PACKETS.read1ByteTxRx(port, 7, 31)[0] == 60


def test_a_reboot_silences_the_servo_and_clears_what_is_in_ram(line: tuple[Any, PacketBus]) -> None:
    port, bus = line
    PACKETS.write2ByteTxRx(port, 1, 38, 500)
    PACKETS.write1ByteTxRx(port, 1, 65, 1)
    bus.devices[0].fail(OVERLOAD)
    assert PACKETS.read1ByteTxRx(port, 1, 70) == (OVERLOAD, COMM_SUCCESS, 0x80)
    assert PACKETS.write1ByteTxRx(port, 1, 64, 1) == (COMM_SUCCESS, 0x80)
    assert PACKETS.read1ByteTxRx(port, 1, 64)[0] == 0  # it shut down
    assert PACKETS.reboot(port, 1)[0] == COMM_SUCCESS
    assert PACKETS.ping(port, 1)[1] == COMM_RX_TIMEOUT
    for _ in range(40):
        if PACKETS.ping(port, 1)[1] == COMM_SUCCESS:
            break
    assert PACKETS.read1ByteTxRx(port, 1, 70) == (0, COMM_SUCCESS, 0)
    assert PACKETS.read1ByteTxRx(port, 1, 65)[0] == 0
    assert PACKETS.read2ByteTxRx(port, 1, 38)[0] == 500


def test_indirect_data_shows_and_changes_what_the_addresses_name(line: tuple[Any, PacketBus]) -> None:
    port, _ = line
    for slot, address in enumerate((132, 133, 134, 135, 65)):
        PACKETS.write2ByteTxRx(port, 1, 168 + 2 * slot, address)
    PACKETS.write1ByteTxRx(port, 1, 212, 1)
    assert PACKETS.read1ByteTxRx(port, 1, 65)[0] == 1
    assert PACKETS.read4ByteTxRx(port, 1, 208) == (0, COMM_SUCCESS, 0)
    assert PACKETS.read2ByteTxRx(port, 2, 634)[1:] == (COMM_SUCCESS, 0)


def test_the_status_return_level_decides_who_is_answered(line: tuple[Any, PacketBus]) -> None:
    port, _ = line
    PACKETS.write1ByteTxRx(port, 1, 68, 1)
    assert PACKETS.write1ByteTxRx(port, 1, 65, 1)[0] == COMM_RX_TIMEOUT
    assert PACKETS.read1ByteTxRx(port, 1, 65) == (1, COMM_SUCCESS, 0)
    PACKETS.write1ByteTxOnly(port, 1, 68, 0)
    assert PACKETS.read1ByteTxRx(port, 1, 65)[1] == COMM_RX_TIMEOUT
    assert PACKETS.ping(port, 1)[1] == COMM_SUCCESS


def test_a_client_at_the_wrong_baud_rate_receives_nothing(line: tuple[Any, PacketBus]) -> None:
    port, _ = line
    port.setBaudRate(57600)
    assert PACKETS.ping(port, 1)[1] == COMM_RX_TIMEOUT
    port.setBaudRate(1_000_000)
    assert PACKETS.ping(port, 1)[1] == COMM_SUCCESS


def test_a_factory_reset_restores_the_defaults_except_what_it_is_asked_to_keep(line: tuple[Any, PacketBus]) -> None:
    port, bus = line
    PACKETS.write2ByteTxRx(port, 2, 38, 100)
    PACKETS.factoryReset(port, 2, 0x02)
    registers = bus.devices[1].registers
    assert [registers.get(n) for n in ("id", "baud_rate", "current_limit", "firmware_version")] == [2, 3, 1193, 38]
    PACKETS.factoryReset(port, 1, 0xFF)
    assert bus.devices[0].line.baudrate == 57600


def test_clear_takes_whole_turns_off_the_position(line: tuple[Any, PacketBus]) -> None:
    port, bus = line
    bus.devices[0].registers.put("operating_mode", 4)
    bus.devices[0].registers.put("homing_offset", 2 * 4096 + 5)
    assert PACKETS.read4ByteTxRx(port, 1, 132)[0] == 8197
    assert PACKETS.clearMultiTurn(port, 1) == (COMM_SUCCESS, 0)
    assert PACKETS.read4ByteTxRx(port, 1, 132)[0] == 5
