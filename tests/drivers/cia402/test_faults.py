"""Faults that only a CiA 402 drive on CANopen has; those of every drive are in test_fault_contract.py."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import can
import pytest

from drivers.cia402.network import LinkedNetwork
from drivers.cia402.profiles import NOT_ENABLED, ObjectIndex
from drivers.cia402.scan import search
from drivers.servo import BadReply, Command, DeviceFault, DriverError, Limits, NoReply, Quantity
from sim_backend.wire.canopen.node import HEARTBEAT_LOST, PRE_OPERATIONAL
from sim_backend.wire.canopen.sdo import SdoServer
from sim_backend.wire.cia402.device import FOLLOWING_ERROR, OVERCURRENT, Cia402Device
from sim_backend.wire.cia402.machine import Cia402State
from sim_backend.wire.faults import DropReplies

Make = Callable[..., Any]
LIMITS = Limits(torque=0.04, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
PUSH = Command(Quantity.TORQUE, 0.01)
MODELS = ["epos4", "epos2", "generic"]


def armed(rig: Any, **changes: Any) -> Any:
    servo = rig.armed(LIMITS, **changes)
    rig.wait(2e-3)
    servo.exchange(PUSH)
    return servo


def ask_through_gaps(rig: Any, servo: Any, tries: int = 100) -> None:
    """Go on as a recorder does, until something ends it."""
    for _ in range(tries):
        rig.wait(2e-3)
        with contextlib.suppress(NoReply, BadReply):
            servo.exchange(PUSH)


# -- opening --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "profile", "words"),
    [
        ("epos2", "epos4", r"\(EPOS2\) has no object 0x6071:00, which the epos4 has"),
        ("epos4", "epos2", r"has no object 0x2030:00, which the epos2 has"),
        ("generic", "epos4", "vendor id 0x2E3, not maxon's"),
    ],
)
def test_another_kind_of_drive_than_the_stand_file_says_is_refused(
    make_cia402: Make, model: str, profile: str, words: str
) -> None:
    with pytest.raises(DriverError, match=words):
        make_cia402(model).open(profile=profile, torque_constant=0.02)


def test_a_node_that_is_no_drive_is_refused(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.device.objects.put(0x1000, 0, 0x000F0191)
    with pytest.raises(DriverError, match="has device profile 401"):
        rig.open()


@pytest.mark.parametrize("size", [0, 1, 9])
def test_an_sdo_reply_with_too_few_or_too_many_bytes_is_a_bad_reply_and_leaves_no_torque(
    make_cia402: Make, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_cia402()
    servo = rig.open()
    whole = LinkedNetwork.read
    for place in (ObjectIndex(0x6076, 0), ObjectIndex(0x6080, 0), ObjectIndex(0x6041, 0)):

        def cut(network: LinkedNetwork, asked: ObjectIndex, place: ObjectIndex = place) -> bytes:
            data = whole(network, asked)
            return (data + bytes(9))[:size] if asked == place else data

        monkeypatch.setattr(LinkedNetwork, "read", cut)
        with contextlib.suppress(DriverError):
            servo.arm(LIMITS)
            servo.disarm()
        monkeypatch.setattr(LinkedNetwork, "read", whole)
        servo.disarm()
        assert not rig.motor.enabled
    monkeypatch.setattr(LinkedNetwork, "read", lambda *_: bytes(size))
    with pytest.raises(BadReply, match=f"{size} bytes"):
        servo._node.objects.put(ObjectIndex(0x6080, 0), 1 << 8 * size, size)


def test_an_sdo_reply_without_an_end_is_given_up_and_leaves_no_torque(
    make_cia402: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_cia402()
    servo = armed(rig)
    answer = SdoServer.answer

    def endless(server: SdoServer, request: bytes) -> bytes | None:
        if request[0] >> 5 == 2:  # an upload begins
            return b"\x40" + request[1:4] + bytes(4)
        return bytes([request[0] & 0x10]) + bytes(7) if request[0] >> 5 == 3 else answer(server, request)

    monkeypatch.setattr(SdoServer, "answer", endless)
    begun = rig.clock.now()
    with pytest.raises(BadReply, match=r"0x6041:00 without an end, 280 bytes so far"):
        servo._node.network.read(ObjectIndex(0x6041, 0))
    with pytest.raises(DriverError, match="without an end"):  # the alarm: the drive's state cannot be read
        servo.disarm()
    assert not rig.motor.enabled
    assert rig.clock.now() - begun < 1.0


def test_a_search_names_every_node_and_touches_nothing(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.bus.nodes.append(Cia402Device("epos2", 9))
    before = [dict(node.objects.values) for node in rig.bus.nodes]
    assert search(rig.config, rig.clock, rig.port) == [
        "EPOS4 Module 24/1.5 (profile CiA 402) answers with node id 1",
        "EPOS2 (profile CiA 402) answers with node id 9",
    ]
    assert [node.objects.values for node in rig.bus.nodes] == before
    assert {message.data[0] for message in rig.port.sent} <= {0x40, 0x60, 0x70}


# -- arming ---------------------------------------------------------------------------------------------------------


def test_a_fault_from_before_we_listened_is_read_from_the_drive(make_cia402: Make) -> None:
    for model in MODELS:
        rig = make_cia402(model)
        rig.device.fail(OVERCURRENT)
        rig.device.node._pending.clear()
        servo = rig.open()
        with pytest.raises(DeviceFault) as caught:
            servo.arm(LIMITS)
        assert caught.value.code == OVERCURRENT


def test_a_heartbeat_lost_before_opening_is_no_fault(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.device.fail(HEARTBEAT_LOST)
    servo = armed(rig)
    assert servo.exchange(PUSH).motor_torque > 0.0


@pytest.mark.study
def test_any_fault_is_reset_where_the_stand_file_allows_and_the_drive_does(make_cia402: Make) -> None:
    rig = make_cia402()
    rig.device.fail(FOLLOWING_ERROR)
    assert armed(rig, reset_faults=True).exchange(PUSH).motor_torque > 0.0
    rig = make_cia402()
    rig.device.fail(OVERCURRENT)
    rig.device.machine.can_reset = False
    servo = rig.open(reset_faults=True)
    with pytest.raises(DeviceFault) as caught:
        servo.arm(LIMITS)
    assert caught.value.code == OVERCURRENT


def test_a_power_stage_that_does_not_come_on_says_what_to_look_at(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.open()
    rig.device.machine.ignores_controlword = True
    with pytest.raises(DriverError, match=r"switch on disabled.*safe-torque-off"):
        servo.arm(LIMITS)


# -- running --------------------------------------------------------------------------------------------------------


def test_a_drive_that_another_program_switches_off_is_a_fault(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.device.machine.quick_stop()
    rig.device.machine.ignores_controlword = True
    with pytest.raises(DeviceFault, match="another program commands it") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == NOT_ENABLED


def test_a_node_that_another_program_stops_is_a_fault_and_is_started_again(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.port.send(can.Message(arbitration_id=0, data=[2, 1], is_extended_id=False))
    with pytest.raises(DeviceFault, match="another program commands it") as caught:
        ask_through_gaps(rig, servo)
    assert caught.value.code == NOT_ENABLED
    assert not rig.device.motor.enabled
    servo.disarm()
    servo.arm(LIMITS)
    servo.exchange(PUSH)


def test_a_drive_that_reboots_while_it_is_disarmed_is_read_again_though_the_first_tries_fail(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = rig.open()
    rig.device.reboot(rig.clock.now())
    rig.wait(0.6)
    rig.bus.faults.inject(DropReplies(after=6, count=4))
    samples = 0
    for _ in range(20):
        rig.wait(2e-3)
        with contextlib.suppress(NoReply):
            servo.exchange(Command.rest())
            samples += 1
    assert samples > 10


# -- stopping -------------------------------------------------------------------------------------------------------


def test_torque_off_gets_through_though_the_node_takes_no_pdo(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    rig.device.node.state = PRE_OPERATIONAL
    servo.disarm()
    assert rig.device.machine.state is Cia402State.SWITCH_ON_DISABLED


def test_a_client_that_stays_away_after_torque_off_leaves_no_fault_behind(make_cia402: Make) -> None:
    rig = make_cia402()
    servo = armed(rig)
    servo.disarm()
    rig.wait(5.0)
    assert rig.device.machine.state is Cia402State.SWITCH_ON_DISABLED
    servo.exchange(Command.rest())
