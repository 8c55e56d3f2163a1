"""Both sides of CANSimple against the vendor's own description of it, as another project ships it."""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import Any

import pytest

from drivers.odrive.messages import Codec, Layout, messages
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.odrive.device import OdriveDevice

pytestmark = pytest.mark.study

NODE = 3
SETS = {
    "set_mode": ("Set_Controller_Mode", (1, 1)),
    "set_torque": ("Set_Input_Torque", (0.25,)),
    "set_state": ("Set_Axis_State", (8,)),
    "set_limits": ("Set_Limits", (3.5, 12.0)),
}


def database(layout: str) -> dict[str, Any]:
    cantools = pytest.importorskip("cantools")
    pytest.importorskip("odrive_can", reason="the package that ships the DBC files")
    firmware = {"0.5": "0.5.6", "0.6": "0.6.10"}[layout]
    with as_file(files("odrive_can") / "dbc" / f"odrive-cansimple-{firmware}.dbc") as path:
        found = cantools.database.load_file(path, strict=False)
    head = f"Axis{NODE}_"
    return {message.name.removeprefix(head): message for message in found.messages if message.name.startswith(head)}


@pytest.mark.parametrize("layout", ["0.5", "0.6"])
def test_what_the_adapter_sends_is_what_the_vendor_describes(layout: Layout) -> None:
    known = database(layout)
    codec = Codec(NODE, layout)
    for ours, (theirs, values) in SETS.items():
        message = known[theirs]
        by_place = sorted(message.signals, key=lambda signal: signal.start)
        data = message.encode({signal.name: value for signal, value in zip(by_place, values, strict=True)})
        sent = codec.put(ours, *values)
        assert (sent.arbitration_id, bytes(sent.data)) == (message.frame_id, data)
    asked = {"encoder": "Get_Encoder_Estimates", "iq": "Get_Iq", "bus": "Get_Bus_Voltage_Current"}
    asked |= {"version": "Get_Version", "torques": "Get_Torques", "temperature": "Get_Temperature"}
    for ours, theirs in asked.items():
        if ours in messages(layout):
            assert codec.request(ours).arbitration_id == known[theirs].frame_id


@pytest.mark.parametrize(("layout", "firmware"), [("0.5", "0.5.6"), ("0.6", "0.6.10")])
def test_what_the_emulator_answers_can_be_read_with_the_vendors_description(layout: str, firmware: str) -> None:
    device = OdriveDevice(NODE, firmware=firmware)
    known = database(layout)
    for ours, (theirs, values) in SETS.items():
        message = known[theirs]
        by_place = sorted(message.signals, key=lambda signal: signal.start)
        data = message.encode({signal.name: value for signal, value in zip(by_place, values, strict=True)})
        assert device.handle(CanFrame(message.frame_id, data), 0.1) == [], ours
    device.advance(1.0)
    unanswered = {"Get_ADC_Voltage"}  # needs a pin
    for name, message in known.items():
        if name.startswith("Get_") and name not in unanswered:
            (reply,) = device.handle(CanFrame(message.frame_id, remote=True), 1.0)
            assert message.decode(reply.data).keys() == {signal.name for signal in message.signals}
    (reply,) = device.handle(CanFrame(known["Get_Iq"].frame_id, remote=True), 1.0)
    assert known["Get_Iq"].decode(reply.data)["Iq_Measured"] == pytest.approx(0.25 / 0.04, abs=0.02)
    beat = next(frame for frame in device.unasked(1.1) if frame.ident == known["Heartbeat"].frame_id)
    assert str(known["Heartbeat"].decode(beat.data)["Axis_State"]) == "CLOSED_LOOP_CONTROL"
