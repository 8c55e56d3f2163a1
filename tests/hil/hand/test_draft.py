"""`hil stand new --scan`: the servos of a port, and the file of a hand with a joint for each of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivers.dynamixel.identity import scan as scan_dynamixel
from drivers.feetech.identity import scan as scan_feetech
from drivers.packets.bus import Bus
from drivers.packets.scan import FoundServo
from drivers.servo import NoReply
from hil.errors import WrongUse
from hil.hand.draft import found_on, hand_of, hand_text
from hil.hand.file import load, parse
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.emulator import serve as serve_dynamixel
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.feetech.emulator import serve as serve_feetech
from sim_backend.wire.packets.servos import OnLine

from ...drivers.conftest import Rig, feetech_rig, new_rig
from ..conftest import Hil

LINES: dict[str, tuple[Callable[[], Rig], Callable[..., Any], list[tuple[str, int]]]] = {
    "x": (new_rig, DynamixelDevice, [("xl330-m288", 1), ("xc330-t288", 9)]),
    "mx": (partial(new_rig, "mx-64"), MxDevice, [("mx-64", 1), ("mx-106", 9)]),
    "feetech": (partial(feetech_rig, "sts3215"), FeetechDevice, [("sts3215", 1), ("hls3930m", 9)]),
}


def found_in(rig: Rig) -> dict[str, list[FoundServo]]:
    scans = {"dynamixel": scan_dynamixel, "feetech": scan_feetech}
    return {family: scan("loopback", rig.clock, rig.port) for family, scan in scans.items()}


@pytest.mark.parametrize("line", LINES)
def test_a_scan_finds_ids_models_and_firmware_of_each_family_and_changes_no_servo(
    line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("write", "send", "write_and_read"):
        monkeypatch.setattr(Bus, name, lambda *_, **__: pytest.fail("a scan writes"))
    make, device, servos = LINES[line]
    rig = make()
    rig.bus.devices.append(device(*servos[1]))
    hand = hand_of("loopback", found_in(rig))
    assert hand.backend == ("feetech" if line == "feetech" else "dynamixel")
    assert [(one.kind.model, one.ident) for one in hand.servos] == servos
    assert all(one.kind.firmware for one in hand.servos)
    assert hand.others == ()
    assert not any(one.motor.enabled for one in rig.bus.devices)


def test_a_line_of_which_no_hand_follows_is_refused_in_a_sentence() -> None:
    x, feetech = new_rig(), feetech_rig("sts3215")
    both = {"dynamixel": found_in(x)["dynamixel"], "feetech": found_in(feetech)["feetech"]}
    with pytest.raises(WrongUse, match=r"DYNAMIXEL servos \(id 1\) and Feetech servos \(id 1\) answer on /dev/a"):
        hand_of("/dev/a", both)
    x.bus.devices.append(DynamixelDevice("xl330-m288", 4, baudrate=57600))
    with pytest.raises(WrongUse, match=r"several baud rates \(id 4 at 57600 baud; id 1 at 1000000 baud\)"):
        hand_of("/dev/a", found_in(x))
    x.bus.devices.clear()
    with pytest.raises(NoReply, match="no DYNAMIXEL or Feetech servo that hil drives answers on /dev/a at any baud"):
        hand_of("/dev/a", found_in(x))


def test_a_servo_that_replies_to_a_ping_only_is_named_and_left_out() -> None:
    rig = new_rig("mx-64")
    rig.bus.devices.append(MxDevice("mx-64", 7))
    rig.bus.devices[1].put("status_return_level", 0)
    hand = hand_of("/dev/a", found_in(rig))
    assert [one.ident for one in hand.servos] == [1]
    assert hand.others == ("a servo that replies to a ping and to no read answers with id 7 at 1000000 baud",)


def test_what_a_new_hand_lacks_is_an_error_with_its_line() -> None:
    rig = feetech_rig("hls3606m")
    text = hand_text(hand_of("/dev/a", found_in(rig)), {})
    with pytest.raises(WrongUse, match=r"line \d+: .*torque_constant: must be given for the hls3606m"):
        parse(text)
    assert parse(text.replace("# torque_constant = ...", "torque_constant = 0.5"))


@pytest.mark.parametrize(
    ("family", "serve", "models"),
    [
        ("dynamixel", serve_dynamixel, ("xc330-t288", "xl330-m288")),
        ("feetech", serve_feetech, ("hls3930m", "hls3930m")),
    ],
)
def test_the_command_writes_a_hand_that_doctor_takes_without_an_edit(
    family: str, serve: Callable[..., Any], models: tuple[str, str], hil: Hil, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("dynamixel", "feetech"):
        monkeypatch.setattr(f"drivers.{name}.identity.RATES", (1_000_000,))
    link = Path("ttyHAND").absolute()
    with serve(link, hand=[OnLine(model, ident) for model, ident in zip(models, (3, 8), strict=True)]):
        ended = hil("stand", "new", "--scan", link, "--set", "limits.torque=0.1")
        assert ended.status == 0, ended.err
        hand = load(Path("hand.toml"))
        assert [(one.name, one.stand.devices[family].model) for one in hand.joints] == [
            ("joint_3", models[0]), ("joint_8", models[1]),
        ]  # fmt: skip
        assert hand.joints[0].stand.checked_limits().torque == 0.1
        assert "exists" in hil("stand", "new", "--scan", link).err
        checked = hil("doctor", "hand.toml", "--joint", "joint_8")
        assert (checked.status, f"{family} {models[1]}, id 8, firmware" in checked.out) == (0, True), checked.out


def test_a_port_that_is_not_there_is_said_once() -> None:
    with pytest.raises(Exception, match=r"^/nowhere: there is no such port"):
        found_on("/nowhere")
