"""A moteus over its emulator: frames against the vendor's examples, limits that arrive, values that come back."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.moteus.frames import FLOAT, INT8, INT16, INT32, answers, filled, read, registers, write
from drivers.servo import BadReply, Command, DriverError, Limits, Quantity, Status, UnsafeCommand
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.moteus.command import POSITION
from sim_backend.wire.moteus.device import MoteusDevice
from sim_backend.wire.moteus.frames import Read, Reader, Write
from sim_backend.wire.moteus.registers import UNITS

from ..conftest import torque

Make = Callable[..., Any]
LIMITS = Limits(torque=0.4, velocity=60.0, temperature=70.0, position=(-3.0, 3.0))


def to(device: MoteusDevice, hexadecimal: str, ident: int = 0x8001) -> str:
    replies = device.handle(CanFrame(ident, bytes.fromhex(hexadecimal), extended=True, fd=True, fast=True), 0.1)
    return "".join(reply.data.hex() for reply in replies)


def test_the_manuals_example_is_understood_and_its_answer_decoded() -> None:
    """docs/protocol/can.md: `can send 8001 01000a07206000200150ff140400130d`, answered as there."""
    subframes = Reader(bytes.fromhex("01000a07206000200150ff140400130d")).subframes()
    assert subframes == [Write(0, 0, (10,)), Write(1, 0x20, (96, 288, -176)), Read(1, 0, 4), Read(0, 0x0D, 3)]
    found = answers(bytes.fromhex("2404000a005000000170ff230d181400"))
    expected = {"mode": 10, "position": 0.008, "velocity": 0.064, "torque": -1.44}
    assert found == pytest.approx(expected | {"voltage": 12.0, "temperature": 20.0, "fault": 0})


def test_the_manuals_example_makes_the_emulator_answer_in_its_form() -> None:
    device = MoteusDevice()
    for _ in range(3):
        answer = to(device, "01000a07206000200150ff140400130d")
    assert answer.startswith("2404000a00")
    assert answer[22:26] == "230d"
    assert to(device, "01000a07206000200150ff140400130d", 0x0001) == ""  # no reply was asked for
    assert device.motor.demand < 0.0


def test_what_is_sent_is_what_the_manual_says() -> None:
    assert write("mode", INT8, 10).hex() == "01000a"
    assert write("command_position", FLOAT, math.nan, 0.0, 0.5).hex() == "0f200000c07f000000000000003f"
    assert (read("position", FLOAT, 3).hex(), read("model", INT32, 3).hex()) == ("1f01", "1b8002")
    assert filled([bytes(9)]).hex() == "00" * 9 + "505050"


def test_both_sides_know_what_a_count_is_worth() -> None:
    """Two tables written apart: a slip in one of them shows here."""
    for name, register in registers().items():
        unit = UNITS.get(register.number, (1.0, 1.0, 1.0))
        assert register.scales == pytest.approx(unit, rel=1e-6), name


@pytest.mark.parametrize("kind", [INT8, INT16, INT32, FLOAT])
def test_every_resolution_survives_both_codecs(kind: int) -> None:
    device = MoteusDevice()
    device._offset = -0.123 * 2.0 * math.pi
    scale = registers()["position"].scales[kind] if kind != FLOAT else 1e-7
    answer = to(device, filled([read("position", kind)]).hex())
    assert answers(bytes.fromhex(answer))["position"] == pytest.approx(device.turns, abs=scale)
    temperature = answers(bytes.fromhex(to(device, filled([read("motor_temperature", kind)]).hex())))
    assert math.isnan(temperature["motor_temperature"])  # no thermistor


def test_no_received_bytes_crash_the_decoder() -> None:
    rng = np.random.default_rng(7)
    good = bytes.fromhex("2f0100000000000000000000000021000a2907000000005050")
    for _ in range(1000):
        data = bytearray(good[: int(rng.integers(len(good) + 1))])
        for place in rng.integers(max(len(data), 1), size=3):
            if data:
                data[place] = int(rng.integers(256))
        try:
            answers(bytes(data))
        except (BadReply, DriverError):
            continue
    with pytest.raises(BadReply):
        answers(bytes.fromhex("10a39c3e04"))
    with pytest.raises(BadReply):
        answers(bytes.fromhex("20ffffffff0f00"))


@pytest.mark.study
def test_position_mode_follows_its_set_point_and_rests_there(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.device.console.values["servo.pid_position.kp"] = 1000.0
    rig.device.console.values["servo.pid_position.kd"] = 3.0
    servo = rig.armed(LIMITS, mode="position", sign=-1)
    for _ in range(400):
        rig.wait(2e-3)
        servo.exchange(Command(Quantity.POSITION, 0.15))
    for _ in range(20):
        rig.wait(2e-3)
        sample = servo.exchange(Command.rest())
    assert sample.motor_position == pytest.approx(0.15, rel=0.05)
    assert rig.device.motor.position == pytest.approx(-0.15, rel=0.05)
    with pytest.raises(UnsafeCommand, match=r"moteus\.mode"):
        servo.exchange(torque(0.1))


def test_limits_are_written_read_back_and_put_back(make_moteus: Make) -> None:
    rig = make_moteus()
    values = rig.device.console.values
    servo = rig.armed(LIMITS)
    assert values["servo.max_velocity"] == pytest.approx(60.0 / (2 * math.pi))
    assert values["servo.fault_temperature"] == 70.0
    assert values["servo.motor_fault_temperature"] == 70.0
    assert values["servo.timeout_mode"] == 0
    assert rig.device.command.values[0x025] == pytest.approx(0.4)
    assert rig.device.command.values[0x027] == pytest.approx(0.1)
    servo.close()
    assert (values["servo.max_velocity"], values["servo.fault_temperature"]) == (500.0, 75.0)
    assert math.isnan(values["servo.motor_fault_temperature"])
    assert values["servo.timeout_mode"] == 12


def test_limits_are_never_raised(make_moteus: Make) -> None:
    rig = make_moteus()
    rig.open().arm(Limits(torque=0.4, velocity=1e5, temperature=120.0, position=(-3.0, 3.0)))
    values = rig.device.console.values
    assert (values["servo.max_velocity"], values["servo.fault_temperature"]) == (500.0, 75.0)


def test_a_limit_that_acts_is_marked(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = rig.armed(LIMITS)
    assert servo.exchange(torque(0.5)).status & Status.SATURATED
    rig.device.console.values["servo.max_current_A"] = 4.0
    rig.wait(2e-3)
    assert servo.exchange(torque(0.3)).status & Status.SATURATED
    rig.wait(2e-3)
    assert not servo.exchange(torque(0.1)).status


def test_one_tick_is_one_frame_each_way(make_moteus: Make) -> None:
    rig = make_moteus()
    servo = rig.armed(LIMITS)
    before, begin = len(rig.port.sent), rig.clock.now()
    sample = servo.exchange(torque(0.1))
    assert len(rig.port.sent) - before == 1
    assert len(rig.port.sent[-1].data) == 48
    assert (sample.temperature, sample.voltage) == (pytest.approx(23.0, abs=0.2), pytest.approx(24.0))
    # the arbitration at 1 Mbit/s, 48 bytes at 5 Mbit/s, twice; turnaround and the adapter's latency beside
    assert rig.clock.now() - begin == pytest.approx(2 * 160e-6 + 5e-5 + 1e-4, abs=4e-5)


def test_it_reports_firmware_and_serial_number(make_moteus: Make) -> None:
    info = make_moteus(firmware=(1, 3, 4)).open().info
    assert (info.firmware, info.serial) == ("1.3.4", "3456789a2345678912345678")


def test_a_controller_with_a_high_id_receives_extended_frames(make_moteus: Make) -> None:
    rig = make_moteus(ident=100)
    rig.armed(LIMITS, id=100, source=7)
    assert rig.device.mode == POSITION
