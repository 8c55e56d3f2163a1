"""The emulated RobStride motor, frame by frame, as the maker's manual has it."""

from __future__ import annotations

import math
import struct

import pytest

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.robstride.device import BOOT, CANOPEN, CSP, CURRENT, MIT, PP, SPEED, STALL, RobstrideDevice

KEY = bytes([1, 2, 3, 4, 5, 6])
HOST, IDENT = 0xFD, 0x7F


def motor(model: str = "rs00", **options: object) -> RobstrideDevice:
    return RobstrideDevice(model, IDENT, **options)  # type: ignore[arg-type]  # of the test


def ask(device: RobstrideDevice, kind: int, data: bytes = bytes(8), now: float = 0.0, high: int = 0) -> CanFrame:
    (reply,) = device.handle(CanFrame(kind << 24 | high << 16 | HOST << 8 | IDENT, data, extended=True), now)
    return reply


def write(device: RobstrideDevice, index: int, value: float, now: float = 0.0, layout: str = "<f") -> CanFrame:
    raw = struct.pack(layout, value if layout == "<f" else int(value)).ljust(4, b"\0")
    return ask(device, 18, struct.pack("<HH", index, 0) + raw, now)


def run_in(mode: int, now: float = 0.0) -> RobstrideDevice:
    device = motor()
    write(device, 0x7005, mode, now, "<B")
    ask(device, 3, now=now)
    return device


def test_a_read_is_answered_as_in_the_manual() -> None:
    device = motor()
    device.values["loc_kp"] = 30.0
    reply = ask(device, 17, bytes.fromhex("1e70000000000000"))
    assert (reply.ident, reply.data.hex()) == (0x11007FFD, "1e7000000000f041")
    assert reply.extended


def test_identity_version_and_modes() -> None:
    device = motor("rs03")
    assert ask(device, 0) == CanFrame(IDENT << 8 | 0xFE, device._serial, extended=True)
    assert ask(device, 3).ident == 0x0280_7FFD
    assert ask(device, 4, b"\x00\xc4" + bytes(6)).data == bytes([0, 0xC4, 0x56, 0, 3, 1, 41, 0])
    assert ask(device, 4).ident == 0x0200_7FFD  # asking the version has stopped it


def test_a_new_id_holds_at_once_and_one_that_cannot_be_does_not() -> None:
    device = motor()
    assert ask(device, 7, high=0).ident == IDENT << 8 | 0xFE
    assert ask(device, 7, high=5).ident == 5 << 8 | 0xFE
    assert device.ident == 5


def test_a_fault_is_told_once_and_kept_until_it_is_cleared() -> None:
    device = motor()
    ask(device, 3)
    device.fail(STALL)
    (sent,) = device.unasked(device.due())
    assert (sent.ident, sent.data) == (0x15007FFD, struct.pack("<II", STALL, 0))
    assert device.due() == math.inf
    assert ask(device, 3).ident == 0x0210_7FFD
    assert not device.motor.enabled
    assert ask(device, 4, b"\1" + bytes(7)).ident == 0x0200_7FFD
    assert ask(device, 3).ident == 0x0280_7FFD


def test_reports_come_in_their_time_and_end() -> None:
    device = motor()
    write(device, 0x7026, 3, layout="<H")  # 20 ms
    assert ask(device, 24, KEY + b"\1\x08").ident >> 24 == 24
    assert device.due() == pytest.approx(0.02)
    (report,) = device.unasked(device.due())
    assert report.ident == 0x1800_7FFD
    ask(device, 24, KEY + b"\0\x08", 0.03)
    assert device.due() == math.inf


def test_what_is_saved_and_chosen_holds_after_the_next_start_and_the_rest_is_lost() -> None:
    device = motor()
    write(device, 0x7029, 1, layout="<B")
    write(device, 0x700B, 5.0)
    ask(device, 22, KEY + b"\7\x08")
    write(device, 0x700B, 6.0)
    device._zero = 0.5
    device.reboot(1.0)
    assert device.handle(CanFrame(0x0000_FD7F, bytes(8), extended=True), 1.0) == []
    assert device.values["limit_torque"] == 5.0
    assert device.angle == pytest.approx(-0.5)
    device.values["zero_sta"] = device._saved["zero_sta"] = 0
    device.reboot(2.0)
    assert device.angle == pytest.approx(2.0 * math.pi - 0.5)
    ask(device, 23, KEY + b"\2\x08", 3.0)
    assert ask(device, 0, now=3.0)
    device.reboot(4.0)
    assert device.handle(CanFrame(0x0000_FD7F, bytes(8), extended=True), 5.0) == []  # it is at 500 kbit/s now


def test_what_is_read_only_out_of_range_or_unknown_is_not_written() -> None:
    device = motor()
    before = dict(device.values)
    for index, value in ((0x7019, 1.0), (0x700B, 15.0), (0x700B, -1.0), (0x700B, math.nan), (0x1003, 1.0)):
        assert write(device, index, value).ident >> 24 == 2
    assert device.values == before


def test_current_mode_makes_the_torque_of_its_current() -> None:
    device = run_in(CURRENT)
    write(device, 0x7006, 1.0)
    device.advance(0.3)
    assert device.motor.torque == pytest.approx(1.48 / math.sqrt(2.0), rel=1e-3)
    iqf = ask(device, 17, b"\x1a\x70" + bytes(6), 0.3).data
    assert struct.unpack_from("<f", iqf, 4)[0] == pytest.approx(1.0, rel=1e-3)


def test_speed_mode_is_held_back_by_its_current_limit() -> None:
    device = run_in(SPEED)
    write(device, 0x7018, 0.5)
    write(device, 0x700A, 30.0)
    assert device.motor.demand == pytest.approx(0.5 * 1.48 / math.sqrt(2.0))


@pytest.mark.parametrize(("mode", "fastest"), [(PP, 0x7024), (CSP, 0x7017)])
def test_position_modes_go_to_their_angle_within_their_speed(mode: int, fastest: int) -> None:
    device = run_in(mode)
    assert device.motor.demand == pytest.approx(0.0)
    write(device, fastest, 1.0)
    write(device, 0x7016, 0.3)
    most = 0.0
    for step in range(1, 1500):
        device.advance(step * 1e-3)
        most = max(most, abs(device.motor.velocity))
    assert 0.3 < most < 1.2
    assert device.angle > 0.04  # a loop without an integral, against the joint


def test_a_zero_is_taken_in_every_mode_but_pp() -> None:
    for mode, taken in ((CSP, True), (PP, False)):
        device = run_in(mode)
        device._zero = 1.0
        ask(device, 6, b"\1" + bytes(7))
        assert (device.angle == 0.0) is taken


def test_the_angle_turns_over_at_four_pi_and_stood_still_before() -> None:
    device = motor()
    device._zero = -13.0
    angle = int.from_bytes(ask(device, 4).data[:2], "big") / 65535 * 8.0 * math.pi - 4.0 * math.pi
    assert angle == pytest.approx(13.0 - 8.0 * math.pi, abs=1e-3)
    old = motor(firmware=(0, 0, 2, 5))
    old._zero = -13.0
    assert ask(old, 4).data[:2] == b"\xff\xff"


def test_any_frame_feeds_the_timeout_and_its_end_resets_the_mode_without_a_fault() -> None:
    device = motor()
    write(device, 0x7028, 2000, layout="<I")
    ask(device, 3)
    for step in range(1, 5):
        ask(device, 17, b"\x19\x70" + bytes(6), 0.09 * step)
    assert device.life.watchdog_state == "on"
    device.advance(0.09 * 4 + 0.101)
    assert (device.life.watchdog_state, device.motor.enabled) == ("tripped", False)
    assert ask(device, 18, now=0.5).ident == 0x0200_7FFD


def test_mit_frames_run_it_tell_its_fault_and_lead_back() -> None:
    device = motor(protocol=MIT)
    assert device.handle(CanFrame(0x0000_FD7F, bytes(8), extended=True), 0.0) == []

    def mit(data: bytes, now: float = 0.0) -> CanFrame:
        (reply,) = device.handle(CanFrame(IDENT, data), now)
        return reply

    assert mit(b"\xff" * 7 + b"\xfc").data[0] == IDENT
    mit(bytes.fromhex("7fff7ff000000fff"))
    assert device.motor.demand == pytest.approx(14.0)
    mit(b"\xff" * 7 + b"\xfd")
    assert not device.motor.enabled
    device.fail(STALL)
    assert mit(b"\xff" * 6 + b"\x00\xfb").data[1:5] == struct.pack("<I", STALL)
    mit(b"\xff" * 7 + b"\xfb")
    assert device.faults == 0
    assert mit(b"\xff" * 6 + b"\x00\xfd").data == device._serial
    device.reboot(1.0)
    assert ask(device, 0, now=1.0 + BOOT)


def test_mit_frames_have_modes_of_position_and_speed_and_change_ids() -> None:
    device = motor(protocol=MIT)

    def mit(mode: int, data: bytes) -> CanFrame:
        (reply,) = device.handle(CanFrame(mode << 8 | device.ident, data), 0.0)
        return reply

    assert mit(0, b"\xff" * 6 + b"\x02\xfc").ident == 0  # speed; the host's id is 0 as delivered
    assert not device.motor.enabled
    mit(0, b"\xff" * 7 + b"\xfc")
    mit(1, struct.pack("<ff", 0.3, 1.0))
    assert device.motor.demand == 0.0  # not its mode
    mit(2, struct.pack("<ff", 30.0, 0.5))
    assert device.motor.demand == pytest.approx(0.5 * 1.48 / math.sqrt(2.0))
    mit(0, b"\xff" * 6 + b"\x01\xfc")
    mit(1, struct.pack("<ff", math.nan, math.inf))
    mit(1, struct.pack("<ff", 0.3, 1.0))
    assert device.values["loc_ref"] == pytest.approx(0.3)
    assert device.values["limit_spd"] == 1.0
    assert mit(0, b"\xff" * 6 + b"\x05\xfa") == CanFrame(5, device._serial)
    assert mit(0, b"\xff" * 6 + b"\xfd\x11") == CanFrame(5, device._serial)
    assert (mit(0, b"\xff" * 7 + b"\xfd").ident, device.ident, device.motor.enabled) == (0x11, 5, False)


def test_canopen_tells_its_type_and_leads_back() -> None:
    device = motor()
    ask(device, 25, KEY + bytes([CANOPEN, 8]))
    device.reboot(1.0)
    (reply,) = device.handle(CanFrame(0x67F, b"\x40\x00\x10\x00" + bytes(4)), 2.0)
    assert (reply.ident, reply.data[:4]) == (0x5FF, b"\x43\x00\x10\x00")
    assert device.handle(CanFrame(0xFFF, KEY + b"\0\0", extended=True), 2.0)[0].ident == IDENT
    device.reboot(3.0)
    assert ask(device, 0, now=4.0)
