"""A CiA 402 drive over its emulator: what goes over the wire, what is written before it is driven, what comes back."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers import tables
from drivers.cia402.states import DriveState, state_of
from drivers.servo import Command, DriverError, Limits, Status
from hil.stand.file import load
from hil.stand.opening import open_servo
from sim_backend.wire.catalogue import make
from sim_backend.wire.cia402.machine import Cia402State

from ..conftest import torque

Make = Callable[..., Any]
LIMITS = Limits(torque=0.04, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
MODELS = ["epos4", "epos2", "generic"]


STAND = """
[stand]
backend = "cia402"
[limits]
torque = 0.04
deflection = 1.5
velocity = 60.0
temperature = 80.0
[cia402]
interface = "slcan"
channel = "{channel}"
profile = "epos2"
id = 4
torque_constant = 0.02
reply_timeout = 0.3
watchdog = 1.0
"""


def test_every_profile_of_the_driver_is_tested_here() -> None:
    assert sorted(tables.table("cia402")["profiles"]) == sorted(MODELS)


def test_statuswords_are_read_as_the_standard_writes_them() -> None:
    """CiA 402-2, table of the states: xxxx xxxx x0xx 0000 and so on; the other bits say other things."""
    for word, state in (
        (0x0000, DriveState.NOT_READY),
        (0x0240, DriveState.DISABLED),
        (0x0231, DriveState.READY),
        (0x1733, DriveState.ON),
        (0x1F37, DriveState.ENABLED),
        (0x0217, DriveState.QUICK_STOP),
        (0x021F, DriveState.REACTING),
        (0x0208, DriveState.FAULT),
        (0x0228, DriveState.FAULT),
        (0x0201, DriveState.UNKNOWN),
    ):
        assert state_of(word) is state


@pytest.mark.parametrize("model", MODELS)
def test_the_velocity_is_of_the_motor_in_the_unit_that_the_drive_says(make_cia402: Make, model: str) -> None:
    rig = make_cia402(model)
    if model == "epos4":
        rig.device.objects.put(0x60A9, 0, 0xFDB44700)
        rig.device._hook()
    servo = rig.open()
    assert servo.info.velocity_lsb == pytest.approx(2 * math.pi / 60 * (1.0 if model == "epos2" else 1e-3))
    servo.arm(LIMITS)
    for _ in range(8):
        rig.wait(2e-3)
        sample = servo.exchange(torque(0.02))
    assert rig.device.motor.velocity > 1.0
    assert sample.motor_velocity == pytest.approx(rig.device.motor.velocity, abs=0.6)  # 0.2 ms later


def test_limits_are_written_into_an_epos4_and_put_back(make_cia402: Make) -> None:
    rig = make_cia402()
    get = rig.device.objects.get
    rig.device.objects.put(0x60A9, 0, 0xFDB44700)
    rig.device.objects.put(0x6080, 0, 50_000_000)
    servo = rig.armed(LIMITS)
    assert get(0x3001, 2) == 2000  # 0.04 N m at 0.02 N m/A, in mA
    assert get(0x6080) == math.floor(60.0 / (2 * math.pi) * 60e3)  # in units of velocity
    assert get(0x3201, 4) == 800
    assert (get(0x6060), get(0x6007)) == (10, 2)
    assert get(0x1016, 1) == 127 << 16 | 100
    assert rig.device.machine.state is Cia402State.OPERATION_ENABLED
    assert rig.device.motor.torque == 0.0
    servo.close()
    assert (get(0x3001, 2), get(0x6080), get(0x3201, 4)) == (4500, 50_000_000, 1000)
    assert (get(0x6060), get(0x6007), get(0x1016, 1)) == (1, 3, 0)
    assert (get(0x1A00, 0), get(0x1801, 1) >> 31) == (1, 1)  # the PDOs as they were


def test_limits_are_written_into_an_epos2(make_cia402: Make) -> None:
    rig = make_cia402("epos2")
    rig.open().arm(LIMITS)
    get = rig.device.objects.get
    assert get(0x6410, 2) == 2000
    assert get(0x6410, 4) == 572  # rev/min
    assert get(0x6060) == -3


def test_limits_are_written_into_a_plain_drive(make_cia402: Make) -> None:
    rig = make_cia402("generic")
    rig.open().arm(LIMITS)
    get = rig.device.objects.get
    assert get(0x6072) == 1333  # thousandths of 30 mN m
    assert get(0x6080) == 572


def test_an_older_epos_without_an_abort_option_is_driven_all_the_same(make_cia402: Make) -> None:
    rig = make_cia402("epos2")
    del rig.device.objects.entries[0x6007, 0]
    rig.device.objects._indices.discard(0x6007)
    rig.open().arm(LIMITS)
    assert rig.device.motor.enabled


def test_no_limit_is_raised_above_the_drives_own(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.open().arm(Limits(torque=1.0, velocity=1e6, temperature=200.0, position=(-3.0, 3.0)))
    get = rig.device.objects.get
    assert (get(0x3001, 2), get(0x6080), get(0x3201, 4)) == (4500, 50000, 1000)


def test_a_limit_that_the_drive_does_not_keep_is_refused_and_nothing_is_armed(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.open()
    rig.device.objects.read_hooks[0x3001, 2] = lambda: 4500
    with pytest.raises(DriverError, match="in its current limit"):
        servo.arm(LIMITS)
    assert not rig.device.motor.enabled


def test_the_unit_of_the_rated_torque_is_that_of_the_stand_file_where_it_says_one(make_cia402: Make) -> None:
    """30 at Synapticon's mN m is the 30000 of maxon's micronewton metres."""
    rig = make_cia402("generic")
    assert rig.open().info.torque_lsb == pytest.approx(30e-6)
    assert make_cia402("generic").open(rated_torque_unit=1e-6).info.torque_lsb == pytest.approx(30e-9)
    assert make_cia402("generic").open(rated_torque=0.05).info.torque_lsb == pytest.approx(50e-6)
    assert make_cia402("epos4").open().info.torque_lsb == pytest.approx(30e-6)
    assert make_cia402("epos2").open(torque_constant=0.03).info.torque_lsb == pytest.approx(30e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"torque_constant": 0.03}, r"torque_constant is 0\.03 N m/A in the stand file and 0\.02 in the drive"),
        ({"resolution": 2000}, r"resolution is 2000 counts a turn in the stand file and 4096 in the drive"),
    ],
)
def test_a_stand_file_that_disagrees_with_the_drive_is_refused(
    make_cia402: Make, change: dict[str, Any], words: str
) -> None:
    with pytest.raises(DriverError, match=words):
        make_cia402().open(**change)


def test_a_drive_whose_motor_was_never_set_up_is_refused(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.device.objects.put(0x3001, 5, 0)
    with pytest.raises(DriverError, match="has no torque_constant"):
        rig.open()


def test_a_unit_of_velocity_that_is_not_known_is_refused(make_cia402: Make) -> None:
    rig = make_cia402("generic")
    rig.device.objects.put(0x60A9, 0, 0x00B54700)
    with pytest.raises(DriverError, match="0x00B54700"):
        rig.open()


def test_a_clipped_set_point_is_marked_and_so_is_a_limit_that_acts_in_the_drive(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.armed(LIMITS)
    assert servo.exchange(torque(0.05)).status & Status.SATURATED
    rig.wait(2e-3)
    assert not servo.exchange(torque(0.03)).status
    rig.device.objects.put(0x3001, 2, 500)
    rig.wait(2e-3)
    assert servo.exchange(torque(0.03)).status & Status.SATURATED


def test_one_tick_is_four_frames_and_their_time_on_the_wire(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.armed(LIMITS)
    rig.wait(3e-3)
    before, begin = len(rig.port.sent), rig.clock.now()
    servo.exchange(torque(0.01))
    sent = rig.port.sent[before:]
    assert [message.arbitration_id for message in sent][:2] == [0x201, 0x080]
    assert bytes(sent[0].data) == struct.pack("<Hh", 0x0F, 333)
    # with all stuff bits: 95 bits with 4 bytes, 55 with none, 135 with 8, 95 with 4; turnaround, the adapter's latency
    wire = (95 + 55 + 135 + 95) * 1e-6 + 5e-5 + 1e-4
    assert rig.clock.now() - begin == pytest.approx(wire, abs=1e-5)


def test_our_heartbeat_goes_four_times_in_the_watchdogs_time_and_no_more(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.armed(LIMITS)
    before, begin = len(rig.port.sent), rig.clock.now()
    for _ in range(250):
        rig.wait(1e-3)
        servo.exchange(Command.rest())
    beats = [message for message in rig.port.sent[before:] if message.arbitration_id == 0x77F]
    assert 0.9 < len(beats) * 0.025 / (rig.clock.now() - begin) <= 1.0


def test_without_a_watchdog_no_heartbeat_is_sent_and_none_watched(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.armed(LIMITS, watchdog=0.0)
    servo.exchange(torque(0.01))
    rig.wait(5.0)
    assert rig.device.motor.enabled
    assert not [message for message in rig.port.sent if message.arbitration_id == 0x77F]


def test_a_stand_file_and_the_emulate_command_are_all_it_takes(tmp_path: Path) -> None:
    stand = tmp_path / "stand.toml"
    stand.write_text(STAND.format(channel=tmp_path / "ttyCAN"))
    options = {"bus": "slcan", "link": tmp_path / "ttyCAN", "model": "epos2", "idents": [3, 4], "instant": True}
    served: Any = make("cia402", options)
    with served:
        servo, _ = open_servo(load(stand))
        servo.arm(LIMITS)
        assert servo.exchange(torque(0.0)).motor_position == 0.0
        assert servo.info.model == "EPOS2"
        servo.close()


def test_a_second_drive_on_the_bus_is_left_alone(make_cia402: Make) -> None:
    from sim_backend.wire.cia402.device import Cia402Device

    rig = make_cia402()
    other = Cia402Device("epos2", 2)
    rig.bus.nodes.append(other)
    servo = rig.armed(LIMITS)
    for _ in range(50):
        rig.wait(2e-3)
        servo.exchange(torque(0.01))
    servo.close()
    assert other.machine.state is Cia402State.SWITCH_ON_DISABLED
    assert other.objects.values == Cia402Device("epos2", 2).objects.values
