"""What `hil hand` does with a bus of servos that is not as its file says, and with one that is cut while it records."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.packets.bus import PacketBus, Reply
from sim_backend.wire.uart.pty_line import PtyLine

from ..conftest import Hil
from .test_doctor import HAND

_SHORT = 'trials = 1\nrepeats = 1\nduration = 1\nrate = 50\nband = [0.5, 8.0]\nmodel = "linear+offset"\n'
SHORT_HAND = HAND.replace("[dynamixel]", f"{_SHORT}[dynamixel]", 1)


class Cut(PacketBus):
    """A line that is cut 0.5 s after the torque of its servo `cut_by` was switched on."""

    cut_by = -1
    began = 0.0

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> list[Reply]:
        is_on = self.cut_by >= 0 and self.devices[self.cut_by].motor.enabled
        self.began = self.began or now * is_on
        self.unplugged = is_on and now > self.began + 0.5
        return [] if self.unplugged else super().receive(data, now, baudrate)


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, busy_machine: None) -> Cut:
    """The line of HAND, with the servos 1, 2 and 3 and a link at ./ttyHAND."""
    del busy_machine
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("drivers.packets.bus._ROLL_CALL", 0.1)
    return Cut([DynamixelDevice("xl330-m288", ident, now=time.monotonic()) for ident in (1, 2, 3)])


def recorded() -> set[str]:
    return {path.name for path in Path("hand").glob("*.h5")}


def runs(*joints: str) -> set[str]:
    return {f"{joint}_chirp_1.h5" for joint in joints}


def test_a_cut_bus_ends_the_hand_with_its_joint_and_the_same_command_goes_on_where_it_was(hil: Hil, bus: Cut) -> None:
    Path("hand.toml").write_text(SHORT_HAND)
    bus.cut_by = 1
    with PtyLine(Path("ttyHAND"), bus):
        ended = hil("hand", "hand.toml", "--yes", "--workers", 1)
    assert ended.status == 3
    assert "index_chirp_1 (servo 2) failed: ttyHAND is gone" in ended.err
    assert "CUT THE POWER" in ended.err
    assert "the same command resumes" in ended.err
    assert recorded() == runs("thumb", "index")  # the rows before the cut are kept
    kept = Path("hand/thumb_chirp_1.h5").stat().st_mtime_ns
    bus.cut_by, bus.unplugged = -1, False
    Path("hand.toml").write_text(SHORT_HAND.replace("id = 3", 'id = 3\ndynamixel.model = "xc330-t288"'))
    with PtyLine(Path("ttyHAND"), bus):
        ended = hil("hand", "hand.toml", "--yes", "--workers", 1)
    assert ended.status == 1, ended.err
    assert "middle_chirp_1 (servo 3) failed: servo 3 on ttyHAND is a xl330-m288 (model number 1200), not" in ended.err
    assert ended.err.count(" samples, ") == 1, ended.err
    assert Path("hand/thumb_chirp_1.h5").stat().st_mtime_ns == kept
    assert not any(servo.motor.enabled for servo in bus.devices)


WRONG = {
    SHORT_HAND.replace("id = 2", "id = 7"): (
        "thumb_chirp_1 (servo 1) failed: servo 7 (index) of this hand does not answer",
        "index_chirp_1 (servo 7) failed: no servo 7 answers on ttyHAND at 1000000 baud",
    ),
    SHORT_HAND.rpartition("[[joint]]")[0]: (
        "thumb_chirp_1 (servo 1) failed: drive 3 on the same bus (xl330-m288) may hold torque",
        "index_chirp_1 (servo 2) failed: drive 3 on the same bus (xl330-m288) may hold torque",
    ),
    SHORT_HAND.replace("deflection = 1.5", 'deflection = "1 mrad"'): (
        "index_chirp_1 (servo 2) failed: xl330-m288 id 2 cannot keep to a limit below one of its counts at the joint: "
        "limits.deflection 0.001 rad (one count: 0.00153)",
    ),
}
CASES = ("a servo does not answer", "a servo that is on is not in the file", "a limit that no drive can keep to")


@pytest.mark.parametrize("text", WRONG, ids=CASES)
def test_a_hand_is_not_driven_on_a_bus_that_is_not_as_its_file_says(
    text: str, hil: Hil, bus: Cut, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[str] = []

    def search(name: str, table: object) -> list[str]:
        del table
        searched.append(name)
        return []

    monkeypatch.setattr("hil.stand.devices.found_by_search", search)
    Path("hand.toml").write_text(text)
    bus.devices[2].write(64, bytes(["middle" not in text]))
    with PtyLine(Path("ttyHAND"), bus):
        ended = hil("hand", "hand.toml", "--yes", "--workers", 1)
        checked = hil("doctor", "hand.toml", "--rate", 20)
    assert (ended.status, checked.status) == (1, 3)
    for said in WRONG[text]:
        assert said in ended.err
        assert checked.out.count(said.partition(" failed: ")[2]) == 1  # and for each further joint: as with thumb
    assert searched == ["dynamixel"] * ("id = 7" in text)
    assert recorded() == set()
    assert not any(servo.motor.enabled for servo in bus.devices[:2])
