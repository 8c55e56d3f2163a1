"""The emulated CiA 402 drives against clients that are not ours: the library canopen, and a serial adapter."""

from __future__ import annotations

import io
import struct
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import canopen
import pytest
from canopen.objectdictionary import export_od, import_od
from canopen.profiles.p402 import BaseNode402
from canopen.sdo.client import SdoClient

from sim_backend.wire.can_families import cia402 as serve
from sim_backend.wire.canbus.bus import CanBus
from sim_backend.wire.canbus.serve import CanServer
from sim_backend.wire.cia402.device import FOLLOWING_ERROR, Cia402Device
from sim_backend.wire.cia402.machine import Cia402State

pytestmark = pytest.mark.study
MODELS = ["epos4", "epos2", "generic"]


def dictionary(device: Cia402Device, ident: int = 1) -> Any:
    file = io.StringIO(device.eds)
    file.name = "drive.eds"
    return import_od(file, node_id=ident)


def until(done: Callable[[], bool]) -> None:
    end = time.monotonic() + 10.0
    while not done():
        assert time.monotonic() < end


def says(sdo: Any, state: int) -> bool:
    return bool(sdo[0x6041].raw & 0x6F == state)


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine an answer may take longer than the 0.3 to 0.8 s that the library waits for it."""
    monkeypatch.setattr(SdoClient, "RESPONSE_TIMEOUT", 10.0)
    for name in ("SWITCH_STATE_SINGLE", "SWITCH_STATE_FINAL", "SWITCH_OP_MODE", "RESET_FAULT"):
        monkeypatch.setattr(BaseNode402, f"TIMEOUT_{name}", 10.0)


@pytest.fixture
def bus() -> CanBus:
    return CanBus([])


@pytest.fixture
def network(bus: CanBus) -> Iterator[Any]:
    with CanServer("virtual", "cia402 clients", bus) as server:
        bus.nodes += [Cia402Device("epos4", 1, now=server.now()), Cia402Device("epos2", 2, now=server.now())]
        net = canopen.Network()
        net.NOTIFIER_CYCLE = 0.02
        net.connect(interface="virtual", channel="cia402 clients", ignore_config=True)
        for ident, model in ((1, "epos4"), (2, "epos2")):
            net.add_node(ident, dictionary(Cia402Device(model, ident), ident))
        yield net
        net.disconnect()


@pytest.mark.parametrize("model", MODELS)
def test_the_electronic_data_sheet_is_read_by_canopen_and_survives_being_written_again(model: str) -> None:
    device = Cia402Device(model)
    found = dictionary(device)
    assert {(v.index, v.subindex) for v in _variables(found)} == set(device.objects.entries)
    for variable in _variables(found):
        entry = device.objects.entries[variable.index, variable.subindex]
        assert variable.data_type == entry.kind
        assert variable.pdo_mappable == entry.mappable
    again = io.StringIO()
    export_od(found, again, "eds")
    assert "[6041]" in again.getvalue()


def _variables(od: Any) -> Iterator[Any]:
    for item in od.values():
        yield from [item] if isinstance(item, canopen.objectdictionary.ODVariable) else item.values()


def test_every_object_is_read_and_says_what_it_is(network: Any, bus: Any) -> None:
    for device in bus.nodes:
        node = network[device.node.ident]
        for entry in device.objects.entries.values():
            data = node.sdo.upload(entry.index, entry.sub)
            assert data == device.objects.encoded(entry.index, entry.sub)
        assert node.sdo[0x1008].raw == device.model.name  # longer than four bytes: a segmented transfer
        assert node.sdo[0x1018]["Vendor ID"].raw == 0xFB


@pytest.mark.parametrize(
    ("index", "sub", "data", "code"),
    [
        (0x6072, 0, None, 0x06020000),  # an EPOS4 has no max torque
        (0x3001, 9, None, 0x06090011),
        (0x6041, 0, b"\0\0", 0x06010002),
        (0x3001, 2, struct.pack("<I", 5000), 0x06090030),
        (0x6071, 0, b"\0\0\0\0", 0x06070010),
        (0x1A00, 1, struct.pack("<I", 0x60410010), 0x06010000),  # while the mapping counts
        (0x1010, 1, struct.pack("<I", 1), 0x08000020),
        (0x1A00, 0, b"\x08", 0x06020000),  # seven of them are empty
    ],
)
def test_what_it_refuses_is_refused_with_the_code_of_the_standard(
    network: Any, index: int, sub: int, data: bytes | None, code: int
) -> None:
    sdo = network[1].sdo
    transfer = partial(sdo.upload, index, sub) if data is None else partial(sdo.download, index, sub, data)
    with pytest.raises(canopen.SdoAbortedError) as caught:
        transfer()
    assert caught.value.code == code


def test_a_value_goes_in_by_segments_too(network: Any, bus: Any) -> None:
    network[1].sdo.download(0x3001, 2, struct.pack("<I", 1234), force_segment=True)
    assert bus.nodes[0].objects.get(0x3001, 2) == 1234


def test_pdos_are_mapped_sent_on_sync_and_taken(network: Any, bus: Any) -> None:
    node, device = network[1], bus.nodes[0]
    node.tpdo.read()
    node.rpdo.read()
    node.nmt.state = "PRE-OPERATIONAL"
    node.tpdo[1].clear()
    for index in (0x6041, 0x6064, 0x6077):
        node.tpdo[1].add_variable(index)
    node.tpdo[1].trans_type = 1
    node.tpdo[1].enabled = True
    node.tpdo[1].save()
    node.rpdo[1].clear()
    for index in (0x6040, 0x6071):
        node.rpdo[1].add_variable(index)
    node.rpdo[1].save()
    node.nmt.state = "OPERATIONAL"
    node.rpdo[1][0x6040].raw = 6
    node.rpdo[1][0x6071].raw = -70
    node.rpdo[1].transmit()
    network.sync.transmit()
    assert node.tpdo[1].wait_for_reception(1.0) is not None
    assert node.tpdo[1][0x6041].raw & 0x6F == Cia402State.READY_TO_SWITCH_ON
    assert device.objects.get(0x6071) == -70


@pytest.mark.parametrize(("ident", "mode", "target"), [(1, 10, 0x6071), (2, -3, 0x2030)])
def test_the_states_are_gone_through_by_sdo_and_torque_turns_the_motor(
    network: Any, bus: Any, ident: int, mode: int, target: int
) -> None:
    sdo, device = network[ident].sdo, bus.nodes[ident - 1]
    sdo[0x6060].raw = mode
    for word, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        sdo[0x6040].raw = word
        until(partial(says, sdo, state))
    sdo[target].raw = 400
    until(lambda: sdo[0x6064].raw >= 20)
    assert device.motor.enabled
    sdo[0x6040].raw = 0
    assert sdo[0x6041].raw & 0x4F == 0x40
    assert not device.motor.enabled


def test_a_fault_is_an_emcy_with_its_code_and_is_reset(network: Any, bus: Any) -> None:
    node, device = network[1], bus.nodes[0]
    device.fail(FOLLOWING_ERROR)
    until(lambda: bool(node.emcy.active))
    assert node.emcy.active[0].code == node.sdo[0x603F].raw == node.sdo[0x1003][1].raw == FOLLOWING_ERROR
    assert node.sdo[0x6041].raw & 0x4F == 0x08
    node.sdo[0x6040].raw = 0x80
    assert node.sdo[0x6041].raw & 0x4F == 0x40
    assert node.sdo[0x603F].raw == 0


def test_a_reset_boots_and_brings_back_what_was_stored(network: Any, bus: Any) -> None:
    node = network[1]
    node.sdo[0x3001][2].raw = 1000
    node.sdo[0x1010][1].raw = 0x65766173
    node.sdo[0x3001][2].raw = 500
    node.nmt.state = "RESET"
    node.nmt.wait_for_bootup(3.0)
    assert node.sdo[0x3001][2].raw == 1000
    node.sdo[0x1011][1].raw = 0x64616F6C
    node.nmt.state = "RESET"
    node.nmt.wait_for_bootup(3.0)
    assert node.sdo[0x3001][2].raw == 4500
    assert node.sdo[0x1008].raw == bus.nodes[0].model.name


def test_several_drives_answer_on_a_serial_adapter(tmp_path: Path) -> None:
    with serve(tmp_path / "ttyCAN", "generic", (1, 5)):
        net: Any = canopen.Network()
        net.NOTIFIER_CYCLE = 0.02
        net.connect(
            interface="slcan",
            channel=str(tmp_path / "ttyCAN"),
            bitrate=1_000_000,
            sleep_after_open=0.05,
            ignore_config=True,
        )
        net.scanner.search(8)
        until(lambda: sorted(net.scanner.nodes) == [1, 5])
        for ident in (1, 5):
            net.add_node(ident, dictionary(Cia402Device("generic", ident), ident))
            assert net[ident].sdo[0x1018][4].raw == 0x62004410 + ident
        net.disconnect()
