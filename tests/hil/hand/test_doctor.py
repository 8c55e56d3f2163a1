"""`hil doctor hand.toml`: all joints one after the other, with a line for each and the worst exit status."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil.doctor.checks import CheckList
from hil.stand.file import Stand
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.packets.bus import PacketBus
from sim_backend.wire.uart.pty_line import PtyLine

from ..conftest import Hil

HAND = """\
[hand]
backend = "dynamixel"
[dynamixel]
port = "ttyHAND"
model = "xl330-m288"
reply_timeout = 0.3
watchdog = 1.0
[limits]
torque = 0.03
deflection = 1.5
velocity = 60.0
[[joint]]
name = "thumb"
dynamixel.id = 1
[[joint]]
name = "index"
dynamixel.id = 2
[[joint]]
name = "middle"
dynamixel.id = 3
"""


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[PacketBus]:
    """A line of the servos 1, 2 and 3 at ./ttyHAND, of which 2 is another model."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("drivers.packets.bus._ROLL_CALL", 0.1)
    monkeypatch.setattr("drivers.dynamixel.identity.RATES", (1_000_000,))
    models = ("xl330-m288", "xc330-t288", "xl330-m288")
    Path("hand.toml").write_text(HAND)
    bus = PacketBus([DynamixelDevice(model, ident, now=time.monotonic()) for ident, model in enumerate(models, 1)])
    with PtyLine(Path("ttyHAND"), bus):
        yield bus


def test_each_joint_is_checked_although_one_of_them_is_wrong(hil: Hil, bus: PacketBus) -> None:
    ended = hil("doctor", "hand.toml", "--rate", 20)
    lines = [text.split() for text in ended.out.splitlines() if text.startswith(("ok", "warning", "error"))]
    assert [(verdict == "error", name) for verdict, name, *_ in lines] == [
        (False, "thumb:"), (True, "index:"), (False, "middle:"),
    ]  # fmt: skip
    assert "thumb: dynamixel xl330-m288, id 1, firmware" in ended.out
    assert "servo 2 on ttyHAND is a xc330-t288 (model number" in ended.out
    assert "2 of 3 joints passed; wrong: index" in ended.out
    assert "1 of 3 joints; about " in ended.err
    assert ended.status == 3
    assert not any(device.motor.enabled for device in bus.devices)


def test_commissioning_goes_from_joint_to_joint_says_what_is_left_and_ends_where_a_person_declines(
    hil: Hil, bus: PacketBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("hand.toml").write_text(HAND.rpartition("[[joint]]")[0].replace("id = 2", "id = 3"))
    tried: list[str] = []

    def commission(checks: CheckList, stand: Stand, *_: Any) -> Any:
        tried.append(stand.joint)
        checks.passed("watchdog", "10 ms later the drive showed no torque")
        return SimpleNamespace(good=len(tried) != 2, outcome=SimpleNamespace(until="2030-01-01"), verdict="KEEPS")

    monkeypatch.setattr("hil.doctor.examine.commission", commission)
    ended = hil("doctor", "hand.toml", "--commission", "--yes", "--rate", 20)
    assert (ended.status, tried) == (1, ["thumb", "index"])
    assert "firmware 46, commissioned until 2030-01-01" in ended.out
    assert "firmware 46, KEEPS" in ended.out
    order = ("'hand, thumb'", "1 of 2 joints; about ", "'hand, index'")
    assert sorted(order, key=ended.err.index) == list(order)
    monkeypatch.setattr(sys, "stdin", io.StringIO("no\n"))
    declined = hil("doctor", "hand.toml", "--commission")
    assert (declined.status, declined.out, "nothing was driven" in declined.err) == (2, "", True)
    assert tried == ["thumb", "index"]
    assert not any(device.motor.enabled for device in bus.devices)
