"""Bytes on a serial line come one after the other, in the pieces that an adapter makes of them."""

from __future__ import annotations

import pytest

from sim_backend.wire.commander.emulator import CommanderTiming, new_board
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.loadcell.emulator import EmulatedLoadCell, LoadCellBoard
from sim_backend.wire.packets.bus import PacketBus, PacketTiming
from sim_backend.wire.packets.frames import packet
from sim_backend.wire.uart.pacing import paced


def test_a_reply_shorter_than_the_adapters_patience_comes_in_one_piece() -> None:
    assert paced([(1.0, b"0123456789")], 10e-6, 1e-3) == [(1.001, b"0123456789")]


def test_a_longer_one_comes_in_pieces_and_the_last_no_later_than_all_at_once() -> None:
    pieces = paced([(1.0, b"0123456789")], 0.5e-3, 1e-3)
    assert b"".join(data for _, data in pieces) == b"0123456789"
    assert max(len(data) for _, data in pieces) == 3
    assert [at for at, _ in pieces] == pytest.approx([0.9975, 0.999, 1.0005, 1.001])


def test_every_byte_comes_alone_where_nothing_holds_it_back() -> None:
    assert paced([(1.0, b"ab")], 0.25, 0.0) == [(0.75, b"a"), (1.0, b"b")]


def test_a_line_without_time_hands_over_whole_packets_empty_ones_not_at_all() -> None:
    assert paced([(1.0, b"ab"), (2.0, b"")], 0.0, 0.0) == [(1.0, b"ab")]


def test_the_first_bytes_of_a_slow_servo_arrive_before_the_reply_has_ended() -> None:
    bus = PacketBus([DynamixelDevice("xl330-m288", baudrate=57600)], timing=PacketTiming())
    pieces = bus.receive(packet(1, b"\x01"), 0.0, 57600)
    byte = 10.0 / 57600
    assert pieces[-1].at == pytest.approx((10 + 14) * byte + 500e-6 + 1e-3)
    assert pieces[0].at == pytest.approx(pieces[-1].at - (14 - len(pieces[0].data)) * byte)
    assert [len(piece.data) for piece in pieces] == [6, 6, 2]


def test_the_lines_of_a_slow_board_and_a_slow_cell_come_in_pieces_too() -> None:
    board = new_board(baudrate=9600, timing=CommanderTiming())
    assert len(board.receive(b"?\n", 0.0)) > 1
    cell = EmulatedLoadCell(LoadCellBoard(baudrate=9600))
    pieces = cell.receive(b"", cell.due())
    assert len(pieces) > 1
    assert b"".join(data for _, data in pieces).endswith(b"\r\n")
