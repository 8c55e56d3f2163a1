"""AK and Damiao motors over their emulators: frames against the manuals, limits that arrive, values that come back."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mit.frames import Codec, models
from drivers.servo import Command, Limits
from sim_backend.wire.can_families import mit as serve
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.mit.tables import MODELS

from ..conftest import torque

Make = Callable[..., Any]
LIMITS = Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0))
ENTER, LEAVE = bytes([0xFF] * 7 + [0xFC]), bytes([0xFF] * 7 + [0xFD])


def test_both_sides_know_the_same_motors() -> None:
    """Two tables written apart: a slip in one of them shows here."""
    assert set(models()) == set(serve.known)
    for name, model in models().items():
        assert (model.position, model.velocity, model.torque) == MODELS[name].span
        assert (model.family == "damiao") == MODELS[name].damiao


def test_a_command_is_packed_as_the_manual_says() -> None:
    """p 16 bits, v 12, kp 12, kd 12, t 12, high bits first; the middle of a range is 32767.5 or 2047.5 counts."""
    codec = Codec("damiao", 12.5, 30.0, 10.0)
    assert codec.command(codec.torque.of(10.0)).hex() == "8000800000000fff"
    assert codec.command(codec.torque.of(-10.0)).hex() == "8000800000000000"
    assert codec.torque.of(5.0) == round(15.0 / 20.0 * 4095)
    assert codec.torque.lsb == pytest.approx(4.884e-3, rel=1e-3)
    assert codec.position.lsb == pytest.approx(0.3815e-3, rel=1e-3)


def test_a_reply_is_unpacked_as_the_manual_says() -> None:
    state = Codec("damiao", 12.5, 30.0, 10.0).state(bytes.fromhex("11bfff9ff9ff2a2b"))
    assert (state.status, state.temperature) == (1, 43.0)
    assert state.position == pytest.approx(0xBFFF / 65535 * 25 - 12.5)
    assert state.velocity == pytest.approx(0x9FF / 4095 * 60 - 30)
    assert state.torque == pytest.approx(0x9FF / 4095 * 20 - 10)
    state = Codec("cubemars", 12.5, 50.0, 18.0).state(bytes.fromhex("017fff7ff7ff1903"))
    assert (state.status, state.temperature) == (3, 25.0)
    assert abs(state.torque) < 36 / 4095


def test_zero_torque_is_half_a_count_since_zero_lies_between_two() -> None:
    codec = Codec("damiao", 12.5, 30.0, 10.0)
    device = MitDevice("dm-j4310")
    device.handle(CanFrame(1, ENTER), 0.0)
    device.handle(CanFrame(1, codec.command(codec.torque.of(0.0))), 0.0)
    assert device.motor.demand == pytest.approx(0.5 * codec.torque.lsb)


def test_a_scale_of_the_torque_acts_both_ways(make_mit: Make) -> None:
    rig = make_mit("ak80-9")
    servo = rig.armed(LIMITS, torque_scale=0.75)
    for _ in range(100):
        rig.wait(2e-3)
        sample = servo.exchange(torque(0.75))
    assert rig.device.motor.torque == pytest.approx(1.0, abs=0.01)
    assert sample.motor_torque == pytest.approx(0.75, abs=0.01)
    assert math.isnan(servo.info.torque_uncertainty)


def test_what_a_damiao_has_registers_for_is_written_read_back_and_put_back(make_mit: Make) -> None:
    rig = make_mit()
    rig.device.values[10] = 2.0  # an earlier program left it in another mode
    servo = rig.armed(LIMITS)
    values = rig.device.values
    assert (values[10], values[2], values[6], values[9]) == (1.0, pytest.approx(85.0), pytest.approx(20.0), 2000.0)
    servo.close()
    assert (values[10], values[2], values[6], values[9]) == (2.0, 120.0, 30.0, 0.0)


def test_limits_of_a_damiao_are_never_raised(make_mit: Make) -> None:
    rig = make_mit()
    rig.armed(Limits(torque=2.0, velocity=99.0, temperature=150.0, position=(-3.0, 3.0)))
    assert (rig.device.values[2], rig.device.values[6]) == (120.0, 30.0)


def test_no_torque_is_sent_to_a_motor_that_is_not_armed(make_mit: Make) -> None:
    for model in ("ak80-9", "dm-j4310"):
        rig = make_mit(model)
        servo = rig.open()
        for _ in range(5):
            servo.exchange(Command.rest())
        servo.close()
        assert all(bytes(m.data) == LEAVE for m in rig.port.sent if m.arbitration_id == 1)


def test_temperature_and_its_offset(make_mit: Make) -> None:
    rig = make_mit("ak80-9")
    rig.device.motor.warm_to(65.5)
    assert rig.open(temperature_offset=40.0).exchange(Command.rest()).temperature == 25.0


def test_one_tick_is_one_frame_each_way(make_mit: Make) -> None:
    rig = make_mit()
    servo = rig.armed(LIMITS)
    before, begin = len(rig.port.sent), rig.clock.now()
    servo.exchange(torque(0.5))
    assert len(rig.port.sent) - before == 1
    assert rig.clock.now() - begin == pytest.approx(2 * 135e-6 + 5e-5 + 1e-4, abs=1e-5)


def test_two_damiaos_on_one_bus_are_distinguished_by_their_id(make_mit: Make) -> None:
    rig = make_mit()
    rig.bus.nodes.append(MitDevice("dm-j4310", 2))
    rig.bus.nodes[1]._zero = 1.0
    first, second = rig.open(), rig.open(id=2)
    assert first.exchange(Command.rest()).motor_position == pytest.approx(0.0, abs=1e-3)
    assert second.exchange(Command.rest()).motor_position == pytest.approx(-1.0, abs=1e-3)


def test_an_emulated_damiao_has_every_register_and_its_other_modes() -> None:
    device = MitDevice("dm-j4310", 5, reply_id=0x15)
    for number in [*range(37), *range(50, 57), *range(59, 66), 80, 81]:
        (reply,) = device.handle(CanFrame(0x7FF, bytes([5, 0, 0x33, number, 0, 0, 0, 0])), 0.0)
        assert (reply.ident, reply.data[:4]) == (0x15, bytes([5, 0, 0x33, number]))
    assert device.handle(CanFrame(0x7FF, bytes([5, 0, 0x33, 40, 0, 0, 0, 0])), 0.0) == []
    device.handle(CanFrame(0x7FF, bytes([5, 0, 0x55, 10, 2, 0, 0, 0])), 0.0)
    device.handle(CanFrame(5, ENTER), 0.0)
    device.handle(CanFrame(0x105, np.array([0.2, 5.0], dtype="<f4").tobytes()), 0.0)
    device.advance(3.0)
    assert device.motor.position > 0.1


def test_the_page_on_it_shows_the_counts_that_are_used() -> None:
    page = (Path(__file__).parents[3] / "docs" / "can.md").read_text(encoding="utf-8")
    for name, model in models().items():
        codec = Codec(model.family, model.position, model.velocity, model.torque)
        row = f" | {model.velocity:g} | {model.torque:g} | {codec.torque.lsb * 1e3:.3g} mN m "
        row += f"| {model.torque_uncertainty:.0%} |"
        assert re.search(rf"^\| ([^|]*, )?{name}(, [^|]*)?{re.escape(row)}$", page, re.M), name
