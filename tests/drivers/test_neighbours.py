"""Before a drive is armed it asks the others on its bus whether they hold torque, and changes nothing in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest

from drivers.neighbours import HasNeighbours
from drivers.servo import Limits
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.faults import DropReplies
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.moteus.device import MoteusDevice
from sim_backend.wire.odrive.device import OdriveDevice
from sim_backend.wire.packets.bus import PacketTiming

from .conftest import (
    CIA402_LIMITS,
    FEETECH_LIMITS,
    MIT_LIMITS,
    MX_LIMITS,
    ODRIVE_LIMITS,
    SERVO_LIMITS,
    Rig,
    cia402_rig,
    feetech_rig,
    mit_rig,
    moteus_rig,
    new_rig,
    odrive_rig,
    robstride_rig,
)


class Pair(NamedTuple):
    """A drive, a second one on its bus and its id, and how the answer names that one and its release."""

    rig: Callable[[], Rig]
    second: Callable[[int], Any]
    limits: Limits
    ident: int
    kind: str
    release: str
    silent: Mapping[str, float] = MappingProxyType({"watchdog": 0.0})  # so that the second one stays on


def of(kind: Callable[..., Any], model: str) -> Callable[[int], Any]:
    return partial(kind, model)


PAIRS = {
    "dynamixel": Pair(new_rig, of(DynamixelDevice, "xl330-m288"), SERVO_LIMITS, 252, "xl330-m288", "Enable(64)"),
    "dynamixel mx": Pair(partial(new_rig, "mx-64"), of(MxDevice, "mx-64"), MX_LIMITS, 252, "mx-64", "Enable(24)"),
    "feetech": Pair(feetech_rig, of(FeetechDevice, "hls3930m"), FEETECH_LIMITS, 253, "hls3930m", "Enable(40)", {}),
    "odrive 0.6.10": Pair(odrive_rig, OdriveDevice, ODRIVE_LIMITS, 2, "ODrive", "047#01000000"),
    "mit dm-j4310": Pair(mit_rig, of(MitDevice, "dm-j4310"), MIT_LIMITS, 18, "a Damiao", "012#FFFFFFFFFFFFFFFD"),
    "moteus": Pair(moteus_rig, MoteusDevice, ODRIVE_LIMITS, 126, "a moteus", "07E#010000", {"watchdog": 5.0}),
    "cia402": Pair(cia402_rig, of(Cia402Device, "epos4"), CIA402_LIMITS, 127, "EPOS4", "67F#2B40600000000000"),
}


@pytest.fixture(params=PAIRS)
def pair(request: pytest.FixtureRequest) -> Pair:
    return PAIRS[request.param]


def with_second(pair: Pair) -> tuple[Rig, Any]:
    rig, second = pair.rig(), pair.second(pair.ident)
    (getattr(rig.bus, "devices", None) or rig.bus.nodes).append(second)
    return rig, second


def left_on(rig: Rig, pair: Pair) -> None:
    """Arm the second drive over the wire, and leave it alone with its torque on."""
    holder = rig.open(id=pair.ident, **pair.silent, **({"own_id": 126} if pair.kind == "EPOS4" else {}))
    holder.arm(pair.limits)
    holder.fall_silent()


def test_a_second_drive_that_holds_torque_is_named_and_stays_as_it_is(pair: Pair) -> None:
    rig, second = with_second(pair)
    left_on(rig, pair)
    servo = rig.open()
    begin = rig.clock.now()
    (found,) = servo.neighbours()
    assert rig.clock.now() - begin < 1.3
    assert found.ident == pair.ident
    assert pair.kind in found.kind
    assert pair.release in found.release
    assert second.motor.enabled
    assert not rig.motor.enabled
    servo.arm(pair.limits)  # what was asked leaves no reply behind that the drive's next one is taken for
    servo.close()
    assert second.motor.enabled


def test_neither_the_drive_itself_nor_one_without_torque_is_named(pair: Pair) -> None:
    rig, second = with_second(pair)
    servo = rig.armed(pair.limits, **pair.silent)
    servo.fall_silent()
    assert rig.motor.enabled
    assert servo.neighbours() == []
    assert not second.motor.enabled
    servo.close()


def test_a_servo_that_does_not_report_its_torque_is_named_too() -> None:
    rig, second = with_second(PAIRS["dynamixel"])
    second.registers.put("status_return_level", 0)
    (found,) = rig.open().neighbours()
    assert "cannot be read" in found.state
    second.registers.put("model_number", 2020)
    (found,) = rig.open().neighbours()
    assert "not known" in found.state


@pytest.mark.parametrize("name", ["dynamixel", "feetech"])
def test_where_the_line_loses_the_reply_of_the_drive_itself_every_id_is_asked_again(name: str) -> None:
    pair = PAIRS[name]
    rig, _ = with_second(pair)
    left_on(rig, pair)
    servo = rig.open()
    rig.faults.inject(DropReplies(count=2))
    assert [one.ident for one in servo.neighbours()] == [pair.ident]


@pytest.mark.parametrize("name", ["dynamixel mx", "feetech"])
def test_on_an_adapter_that_returns_what_it_sends_only_real_servos_are_named(name: str) -> None:
    pair = PAIRS[name]
    rig, _ = with_second(pair)
    rig.bus._timing = PacketTiming(usb_latency=16e-3, echo=True)
    rig.config = replace(rig.config, reply_timeout=0.03)
    left_on(rig, pair)
    assert [one.ident for one in rig.open().neighbours()] == [pair.ident]


@pytest.mark.parametrize("make", [lambda: mit_rig("ak80-9"), robstride_rig])
def test_a_drive_that_reports_its_state_only_when_it_is_commanded_is_not_asked(make: Callable[[], Rig]) -> None:
    rig = make()
    servo = rig.open()
    sent = len(rig.port.sent)
    assert not isinstance(servo, HasNeighbours) or servo.neighbours() is None
    assert len(rig.port.sent) == sent


def test_neighbours_are_asked_over_an_adapter_that_holds_replies_back_for_long() -> None:
    """The line must then be silent for longer than it usually takes to fall silent."""
    rig, _ = with_second(PAIRS["dynamixel"])
    rig.bus._timing = PacketTiming(usb_latency=0.15)
    servo = rig.open(reply_timeout=0.3, watchdog=1.0)
    assert servo.neighbours() == []
    servo.close()
