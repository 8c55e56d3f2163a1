"""A node never receives its own frames, also where the medium hands them back, as a multicast socket does."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from typing import Any

import can
import pytest

from drivers.canbus.link import BusConfig, open_interface
from drivers.canbus.multicast import MulticastBus, OwnFrames
from drivers.clock import VirtualClock
from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.serve import CanServer
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.odrive.device import OdriveDevice

GROUP = f"239.74.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF}"
"""Of this process alone: another suite may run on the same machine."""
ENABLE = can.Message(arbitration_id=1, data=bytes([0xFF] * 7 + [0xFC]), is_extended_id=False)


@pytest.fixture
def client() -> Iterator[can.BusABC]:
    """A client that is not ours."""
    try:
        bus = can.Bus(interface="udp_multicast", channel=GROUP, hop_limit=0, ignore_config=True)
        with socket.socket(fileno=os.dup(bus.fileno())) as same:
            same.setsockopt(socket.IPPROTO_IP, 49, 0)  # IP_MULTICAST_ALL: not what others on this computer send
        bus.send(ENABLE)
        assert bus.recv(5.0) is not None
    except (can.CanError, OSError, AssertionError) as error:
        pytest.skip(f"no multicast here: {error}")
    yield bus
    bus.shutdown()


def receives(bus: can.BusABC, count: int) -> bool:
    """Whether so many frames arrive, however late, and no more."""
    return all(bus.recv(10.0) is not None for _ in range(count)) and bus.recv(0.1) is None


def test_a_motor_whose_replies_have_the_identifier_of_its_commands_does_not_obey_itself(client: can.BusABC) -> None:
    motor = MitDevice("ak80-9", 1, now=time.monotonic())
    with CanServer("udp_multicast", GROUP, CanBus([motor])) as server:
        client.send(ENABLE)
        # python-can hands the client its own frame too: the command and one reply
        assert receives(client, 2)
        with server.lock:
            assert motor.motor.enabled
            assert motor.motor.demand == 0.0


def test_a_bus_does_not_hear_other_groups(client: can.BusABC) -> None:
    octets = GROUP.split(".")
    other = ".".join([octets[0], "75", *octets[2:]])
    ours = [open_interface(BusConfig("udp_multicast", group, 1_000_000)) for group in (GROUP, other)]
    try:
        client.send(ENABLE)
        assert receives(ours[0], 1)
        assert receives(ours[1], 0)
    finally:
        for bus in ours:
            bus.shutdown()


def test_an_adapter_of_ours_does_not_take_its_command_for_the_reply(client: can.BusABC) -> None:
    ours = open_interface(BusConfig("udp_multicast", GROUP, 1_000_000))
    try:
        ours.send(ENABLE)
        assert receives(client, 1)
        assert receives(ours, 0)
        client.send(ENABLE)
        assert receives(ours, 1)
    finally:
        ours.shutdown()
    assert isinstance(ours, MulticastBus)


def test_an_equal_frame_of_another_node_is_received_as_often_as_it_was_sent() -> None:
    own = OwnFrames()
    own.note(ENABLE, 1.0)
    assert [own.has(ENABLE, 1.1) for _ in range(3)] == [True, False, False]


def test_a_frame_that_never_came_back_is_forgotten() -> None:
    own = OwnFrames()
    own.note(ENABLE, 1.0)
    assert not own.has(ENABLE, 3.0)
    own.note(ENABLE, 5.0)
    own.note(ENABLE, 9.0)
    assert [own.has(ENABLE, 9.1) for _ in range(2)] == [True, False]


def test_frames_that_differ_in_anything_are_not_taken_for_each_other() -> None:
    own = OwnFrames()
    own.note(ENABLE, 0.0)
    for change in ({"arbitration_id": 2}, {"data": bytes(8)}, {"is_extended_id": True}, {"is_fd": True}):
        fields: dict[str, Any] = {"arbitration_id": 1, "data": bytes(ENABLE.data), "is_extended_id": False} | change
        assert not own.has(can.Message(**fields), 0.0)


def test_a_drive_that_nobody_hears_sends_nothing_and_its_emulator_sleeps(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, heard = VirtualClock(), False
    waits: list[float] = []
    sent: list[can.Message] = []

    class Wire:
        def recv(self, timeout: float) -> None:
            waits.append(timeout)
            clock.sleep_until(clock.now() + max(timeout, 1e-5))
            nonlocal heard
            heard = clock.now() > 5.0
            if clock.now() > 10.0:
                server.stop()

        def send(self, message: can.Message) -> None:
            sent.append(message)

        def shutdown(self) -> None: ...

    monkeypatch.setattr("sim_backend.wire.canbus.serve._opened", lambda *_: (Wire(), lambda: heard))
    server = CanServer("udp_multicast", GROUP, CanBus([OdriveDevice(0)]))
    monkeypatch.setattr(server, "now", clock.now)
    server.serve()
    assert 500 < len(sent) < 560  # a position every 10 ms and a heartbeat every 100 ms, in the last 5 s
    assert sum(waits[:30]) > 4.0


@pytest.mark.usefixtures("client")
def test_a_bus_knows_whether_anybody_else_has_it_open() -> None:
    ours = MulticastBus(GROUP)
    assert ours.is_heard()
    ours.shutdown()
