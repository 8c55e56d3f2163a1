"""The torque cell against its emulator: tare, scale, sign, times, and everything that can go wrong on its line."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import pytest
import serial
from pydantic import TypeAdapter, ValidationError

from drivers.clock import MonotonicClock, VirtualClock
from drivers.loadcell.config import LoadCellConfig
from drivers.loadcell.lines import parsed
from drivers.loadcell.sensor import LoadCell
from drivers.servo import BadReply, DriverError, LinkLost, NoReply
from drivers.uart.lines import TextLines
from sim_backend.wire.faults import (
    CorruptReplies,
    DelayReplies,
    DropReplies,
    DuplicateReplies,
    NoiseBefore,
    Reboots,
    TruncateReplies,
    Unplug,
)
from sim_backend.wire.loadcell.emulator import BOARDS, SCALE, SETTLING, EmulatedLoadCell, LoadCellBoard
from sim_backend.wire.uart.pty_line import PtyLine

from ...loopback import SerialLoopback

SIGNS: tuple[Literal[1, -1], ...] = (1, -1)
CONFIG = LoadCellConfig(port="loopback", scale=SCALE)


class Joint:
    """A torque that is a function of time, N m; what a cell feels of it is the middle of the stretch."""

    def __init__(self, torque: Callable[[float], float] = lambda _: 0.0) -> None:
        self.torque = torque

    def mean(self, begin: float, end: float) -> float:
        return self.torque(0.5 * (begin + end))


class Rig:
    def __init__(self, board: LoadCellBoard | None = None, config: LoadCellConfig = CONFIG, **cell: Any) -> None:
        self.clock = VirtualClock()
        self.joint = Joint()
        self.emulated = EmulatedLoadCell(board, self.joint, **cell)
        self.port = SerialLoopback(self.emulated, self.clock, config.baudrate)
        self.config = config

    def open(self) -> LoadCell:
        return LoadCell(self.config, clock=self.clock, port=self.port)

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until(self.clock.now() + seconds)


def watch(rig: Rig, cell: LoadCell, seconds: float, period: float = 2e-3) -> list[tuple[float, float, float]]:
    """Looks at a cell as a loop does: when it looked, when the reading was taken, N m; bad ones are left out."""
    rows = []
    end = rig.clock.now() + seconds
    while rig.clock.now() < end:
        rig.wait(period)
        try:
            rows.append((rig.clock.now(), *cell.read()))
        except BadReply:
            continue
    return rows


# -- what it reads --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", SIGNS)
@pytest.mark.parametrize("board", [LoadCellBoard(), LoadCellBoard(checksum=True), LoadCellBoard(form="value")])
def test_a_torque_comes_out_in_newton_metres_with_the_joints_sign_and_without_the_tare(
    board: LoadCellBoard, sign: Literal[1, -1]
) -> None:
    config = replace(CONFIG, sign=sign, format="value" if board.form == "value" else "micros,raw")
    rig = Rig(board, config)
    cell = rig.open()
    assert cell.tare == (84_000 if board.form == "micros,raw" else 0.0)
    rig.joint.torque = lambda _: sign * 5e-3
    assert watch(rig, cell, 0.2)[-1][2] == pytest.approx(5e-3, abs=SCALE)


def test_read_more_often_than_it_prints_it_repeats_the_last_reading_with_its_time() -> None:
    rig = Rig()
    rows = watch(rig, rig.open(), 1.0)
    assert len({t for _, t, _ in rows}) == pytest.approx(80, abs=2)
    assert all(now - t < 1.5 / 80 + 5e-3 for now, t, _ in rows)


@pytest.mark.parametrize("clock", [1.0, 1.003, 0.997])
def test_a_reading_has_the_time_the_board_took_it_though_its_clock_is_off_and_lines_come_late(clock: float) -> None:
    rig = Rig(LoadCellBoard(clock=clock), micros=(1 << 32) - 7_000_000)  # which wraps after 7 s
    cell = rig.open()
    rig.joint.torque = lambda t: 1e-3 * t
    rig.emulated.faults.inject(DelayReplies(after=300, count=20, seconds=0.03))
    rows = watch(rig, cell, 10.0)[800:]
    # what it shows is the mean over the conversions it settles in, so it is older by half of that than its line
    taken = [torque / 1e-3 + 0.5 * SETTLING / 80 for _, _, torque in rows]
    errors = [t - true for (_, t, _), true in zip(rows, taken, strict=True)]
    assert max(errors) < 4e-3  # a look every 2 ms, 1 ms in the adapter, 0.25 ms of 0.5 % between two soonest lines
    assert min(errors) > -2e-3


def test_a_delay_that_is_known_is_taken_off() -> None:
    late, prompt = (Rig(config=replace(CONFIG, delay=delay)) for delay in (0.025, 0.0))
    (*_, a), (*_, b) = (watch(rig, rig.open(), 0.5) for rig in (late, prompt))
    assert b[1] - a[1] == pytest.approx(0.025)


# -- the zero -------------------------------------------------------------------------------------------------------


def test_a_zero_that_has_drifted_from_the_tables_is_refused_with_the_new_one() -> None:
    near = Rig(LoadCellBoard(offset=0.9e-3), replace(CONFIG, tare=84_000.0))
    assert near.open().tare == 84_000.0
    far = Rig(LoadCellBoard(offset=1.1e-3), replace(CONFIG, tare=84_000.0))
    with pytest.raises(DriverError, match=r"joint_sensor.tare = 95000"):
        far.open()
    assert far.port.closed


def test_a_zero_that_moves_while_it_is_taken_is_refused() -> None:
    with pytest.raises(DriverError, match="is not steady"):
        Rig(LoadCellBoard(drift=0.05)).open()


# -- the line -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fault",
    [
        CorruptReplies(count=3),
        DropReplies(count=3),
        DuplicateReplies(count=3),
        NoiseBefore(count=3, noise=b"\xff\x00hello\n\x80"),
        TruncateReplies(count=3, keep=9),
        DelayReplies(count=3, seconds=0.05),
    ],
)
def test_what_is_damaged_on_the_way_is_a_gap_and_never_a_torque(fault: Any) -> None:
    rig = Rig(LoadCellBoard(checksum=True))
    cell = rig.open()
    rig.emulated.faults.inject(fault)
    rows = watch(rig, cell, 0.5)
    assert {round(torque, 9) for *_, torque in rows} == {0.0}
    assert rows[-1][0] - rows[-1][1] < 0.02


def test_damage_alone_is_a_bad_reply_and_silence_repeats_the_last_reading() -> None:
    rig = Rig(LoadCellBoard(checksum=True))
    cell = rig.open()
    rig.emulated.faults.inject(CorruptReplies(count=8))
    rig.wait(0.09)
    with pytest.raises(BadReply, match="the reading is dropped"):
        cell.read()
    rig.wait(0.1)
    cell.read()
    rig.emulated.faults.inject(DropReplies(count=1000))
    rig.wait(0.05)
    first = cell.read()
    rig.wait(1.0)
    assert cell.read() == first


@pytest.mark.parametrize("micros", [0, (1 << 32) - 100])
def test_a_board_that_restarts_is_a_gap_and_its_readings_go_on_with_true_times(micros: int) -> None:
    rig = Rig(micros=micros)
    cell = rig.open()
    rig.emulated.faults.inject(Reboots(after=5))
    seen = []
    for _ in range(1000):
        rig.wait(2e-3)
        try:
            t, torque = cell.read()
        except BadReply as error:
            seen.append(str(error))
            continue
        assert torque == 0.0
        assert t <= rig.clock.now()
    assert rig.clock.now() - t < 0.02
    assert len(seen) == 1
    assert "restarted" in seen[0]


def test_a_cell_beyond_its_range_is_a_gap_with_its_reason() -> None:
    rig = Rig()
    cell = rig.open()
    rig.joint.torque = lambda _: 10.0
    rig.wait(0.2)
    with pytest.raises(BadReply, match="end of its range"):
        cell.read()


def test_a_pulled_cable_is_a_lost_link_and_closing_is_harmless() -> None:
    rig = Rig()
    cell = rig.open()
    rig.emulated.faults.inject(Unplug())
    rig.wait(0.1)
    with suppress(LinkLost):  # it may still find bytes that had arrived
        cell.read()
    with pytest.raises(LinkLost, match="gone"):
        cell.read()
    cell.close()
    cell.close()
    with pytest.raises(LinkLost, match="closed"):
        cell.read()


# -- opening --------------------------------------------------------------------------------------------------------


def test_a_wrong_baud_rate_is_distinguished_from_a_silent_cell() -> None:
    rig = Rig(config=replace(CONFIG, baudrate=57600))
    with pytest.raises(BadReply, match="57600 baud"):
        rig.open()
    silent = Rig()
    silent.emulated.faults.inject(DropReplies(count=10_000))
    with pytest.raises(NoReply, match="0 readings"):
        silent.open()
    assert silent.port.closed


def test_another_format_and_another_device_are_not_taken_for_a_cell() -> None:
    with pytest.raises(BadReply, match="micros,raw"):
        Rig(LoadCellBoard(form="value")).open()
    with pytest.raises(BadReply, match="is no number"):
        Rig(config=replace(CONFIG, format="value")).open()


def test_a_line_whose_beginning_was_missed_is_not_part_of_the_zero() -> None:
    rig = Rig(LoadCellBoard(form="value", offset=0.1), replace(CONFIG, format="value"))
    rig.wait(SETTLING / 80 + 1e-3 + 5e-4)  # in the middle of the first line
    assert rig.open().tare == pytest.approx(1e6)


def test_a_port_that_cannot_be_opened_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = VirtualClock()
    with pytest.raises(DriverError, match="there is no such port"):
        LoadCell(replace(CONFIG, port=str(tmp_path / "nothing")), clock=clock)

    def refuse(*_: Any, **__: Any) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port: Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DriverError, match="dialout"):
        LoadCell(CONFIG, clock=clock)


def test_a_cell_on_a_pty_is_read_and_a_second_program_is_kept_off(tmp_path: Path) -> None:
    with PtyLine(tmp_path / "ttyCELL", EmulatedLoadCell(LoadCellBoard(rate=500.0), now=time.monotonic())) as line:
        config = replace(CONFIG, port=str(line.link))
        cell = LoadCell(config, clock=MonotonicClock())
        with pytest.raises(DriverError, match="open in this program already"):
            LoadCell(config, clock=MonotonicClock())
        t, torque = cell.read()
        assert t <= MonotonicClock().now()
        assert torque == pytest.approx(0.0, abs=SCALE)
        cell.close()


# -- lines and table ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "lines"),
    [
        ("micros,raw", "|1|1,|1,2,3|1.5,2|-1,2|4294967296,1|1,8388607|1,-8388608|1,2*00|1,2x|1,99999999"),
        ("value", "nan|inf|1e999|1,2|0x10|--1|1.2.3|1*00"),
    ],
)
def test_what_is_no_reading_is_refused(form: Literal["micros,raw", "value"], lines: str) -> None:
    for line in lines.split("|"):
        with pytest.raises(BadReply):
            parsed(line, form)


def test_lines_are_put_together_whatever_the_pieces() -> None:
    text = b"12,34\r\n\r\n56,78\n\xff9\r" + b"x" * 500 + b"\nlast"
    whole = TextLines().feed(text)
    lines = TextLines()
    assert (
        [line for byte in text for line in lines.feed(bytes([byte]))][:3] == whole[:3] == ["12,34", "56,78", "\ufffd9"]
    )
    lines.clear()
    assert lines.feed(b"1\n") == ["1"]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"scale": 0.0}, "scale"),
        ({"scale": float("nan")}, "scale"),
        ({"sign": 0}, "sign"),
        ({"format": "raw"}, "format"),
        ({"drift": -1.0}, "drift"),
        ({"delay": 3.0}, "delay"),
        ({"prot": "x"}, "prot"),
    ],
)
def test_a_table_that_cannot_be_is_refused_at_its_key(change: dict[str, Any], key: str) -> None:
    good: dict[str, Any] = {"port": "/dev/ttyUSB1", "scale": 1e-6}
    assert TypeAdapter(LoadCellConfig).validate_python(good).baudrate == 115200
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(LoadCellConfig).validate_python(good | change)
    assert [error["loc"][0] for error in caught.value.errors()] == [key]


def test_a_converter_with_1000_readings_a_second_gives_every_one_of_them() -> None:
    rig = Rig(BOARDS["adc-1khz"], replace(CONFIG, baudrate=921_600))
    rig.joint.torque = lambda t: 1e-3 if t > 2.0 else 0.0
    cell = rig.open()
    read: list[tuple[float, float]] = []
    while rig.clock.now() < 3.0:
        rig.wait(5e-3)
        read += cell.readings()
    times = [t for t, _ in read]
    assert all(0.9e-3 < later - earlier < 1.1e-3 for earlier, later in pairwise(times))
    stepped = next(t for t, torque in read if torque > 0.5e-3)
    assert 0.0 <= stepped - 0.5 * SETTLING / 1000 - 2.0 < 3.5e-3  # a period, and the adapter's millisecond
    assert cell.read()[1] == pytest.approx(1e-3, abs=SCALE)
