"""The emulated motor against clients that nobody here wrote: robstride (sirwart) and robstride-dynamics (the maker)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import can
import pytest

from sim_backend.wire.can_families import robstride as serve
from sim_backend.wire.robstride.tables import MODELS

pytestmark = pytest.mark.study


@pytest.fixture
def bus() -> Iterator[can.BusABC]:
    with (
        serve("test_robstride_client", "rs01", [5], interface="virtual"),
        can.Bus(interface="virtual", channel="test_robstride_client", ignore_config=True) as made,
    ):
        yield made


def test_robstride_reads_writes_and_turns_the_motor(bus: can.BusABC) -> None:
    robstride: Any = pytest.importorskip("robstride")
    client = robstride.Client(bus)
    assert client.read_param(5, "run_mode") == robstride.RunMode.Operation
    assert client.read_param(5, "vbus") == 48.0
    client.write_param(5, "limit_torque", 3.5)
    assert client.read_param(5, "limit_torque") == 3.5
    client.write_param(5, "run_mode", robstride.RunMode.Current)
    assert client.enable(5).errors == []
    client.write_param(5, "iq_ref", 0.5)
    time.sleep(0.3)
    state = client.write_param(5, "iq_ref", 0.5)
    assert state.torque == pytest.approx(0.5 * MODELS["rs01"].torque_constant, abs=2e-3)
    assert state.angle == pytest.approx(client.read_param(5, "mechpos"), abs=0.05)
    client.disable(5)
    client.update_id(5, 6)
    assert client.read_param(6, "iqf") == pytest.approx(0.0, abs=0.01)


def test_the_makers_client_identifies_the_motor_and_drives_it(bus: can.BusABC, monkeypatch: pytest.MonkeyPatch) -> None:
    sdk: Any = pytest.importorskip("robstride_dynamics")
    interface = SimpleNamespace(Bus=lambda **_: bus)  # it takes SocketCAN only
    monkeypatch.setattr(sdk.bus, "can", SimpleNamespace(interface=interface, Message=can.Message))
    client = sdk.RobstrideBus("none", {"joint": sdk.Motor(id=5, model="rs-01")})
    client.connect()
    try:
        ident, serial = client.read_id("joint", timeout=1.0)
        assert (ident, len(serial)) == (5, 8)
        assert client.read("joint", sdk.ParameterType.MODE) == 0
        client.write("joint", sdk.ParameterType.VELOCITY_LIMIT, 5.0)
        assert client.read("joint", sdk.ParameterType.VELOCITY_LIMIT) == 5.0
        client.enable("joint")
        for _ in range(30):
            client.write_operation_frame("joint", position=0.0, kp=0.0, kd=0.0, torque=0.6)
            position, _, torque, temperature = client.read_operation_frame("joint")
            time.sleep(0.01)
        assert torque == pytest.approx(0.6, abs=2e-3)
        assert position == pytest.approx(0.6 / (0.4 * MODELS["rs01"].span[1]), rel=0.1)  # the default joint
        assert 15.0 < temperature < 40.0
    finally:
        client.disconnect()
