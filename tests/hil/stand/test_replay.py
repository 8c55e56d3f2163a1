"""A recording played back as a servo: what was once read comes again, in its order."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from drivers.servo import Command, LinkLost, NoReply, Quantity, Servo, UnsafeCommand
from hil.cli.app import run
from hil.recording.reader import Recording
from hil.stand.file import parse
from hil.stand.opening import open_servo
from hil.stand.transmission import Transmission

STAND = """
[stand]
backend = "replay"
gear_ratio = 4.0
torque_source = "joint"
[limits]
torque = 0.03
deflection = {deflection}
velocity = 100.0
temperature = 80.0
[replay]
recording = "{recording}"
"""


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    path = tmp_path / "first.h5"
    assert run(["record", "--backend", "sim", "--duration", "2", "--fade", "0.2", "-o", str(path)]) == 0
    return path


def replay(path: Path, recording: Path, deflection: float = 1.0) -> Path:
    path.write_text(STAND.format(recording=recording, deflection=deflection))
    return path


def test_a_recording_that_was_changed_is_not_played_back(
    tmp_path: Path, recorded: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Its limits are in its header."""
    with h5py.File(recorded, "r+") as file:
        file.attrs["stand_toml"] = str(file.attrs["stand_toml"]).replace("torque = 0.03", "torque = 30.0")
    stand = replay(tmp_path / "stand.toml", recorded)
    words = ["--duration", "1", "--fade", "0.2", "-o", str(tmp_path / "again.h5")]
    for chosen in (["--backend", "replay", str(recorded)], ["--stand", str(stand)]):
        assert run(["record", *chosen, *words]) == 1
        assert "is not as it was written" in capfd.readouterr().err
    assert not (tmp_path / "again.h5").exists()


@pytest.mark.study
def test_a_recording_of_a_recording_holds_the_same_readings(tmp_path: Path, recorded: Path) -> None:
    stand = replay(tmp_path / "stand.toml", recorded)
    again = tmp_path / "again.h5"
    words = ["--duration", "1.9", "--fade", "0.2", "--amplitude", "0.001", "-o", str(again)]
    assert run(["record", "--stand", str(stand), *words]) == 0
    with Recording(recorded) as first, Recording(again) as second:
        assert second.truth() == {}
        for name in ("motor_position", "joint_torque", "temperature", "torque"):
            np.testing.assert_array_equal(second.channel(name), first.channel(name, 0, len(second)))
        np.testing.assert_allclose(
            second.channel("read_time") - second.channel("time"),
            (first.channel("read_time") - first.channel("time"))[: len(second)],
            atol=1e-9,
        )


def test_limits_can_be_tried_out_on_what_a_stand_once_did(tmp_path: Path, recorded: Path) -> None:
    stand = replay(tmp_path / "stand.toml", recorded, deflection=0.05)
    assert run(["record", "--stand", str(stand), "--duration", "1.5", "-o", str(tmp_path / "again.h5")]) == 4


def test_a_recording_that_ends_is_a_lost_link_and_disarmed_it_stands_still(recorded: Path) -> None:
    stand = parse(STAND.format(recording=recorded, deflection=1.0))
    servo, _ = open_servo(stand)
    first = servo.exchange(Command.rest())
    assert servo.exchange(Command.rest()).motor_position == first.motor_position
    with pytest.raises(UnsafeCommand):
        servo.exchange(Command(Quantity.TORQUE, 1e-3))
    servo.arm(Transmission.of(stand.stand).motor_limits(stand.checked_limits(), 0.0))
    with pytest.raises(LinkLost, match="ends here"):
        play(servo, 2000)
    servo.close()
    servo.close()
    with pytest.raises(LinkLost):
        servo.exchange(Command.rest())


def play(servo: Servo, exchanges: int) -> None:
    for _ in range(exchanges):
        with suppress(NoReply):  # what was lost is lost again
            servo.exchange(Command.rest())


@pytest.mark.parametrize("name", ["first.h5", "first.h5.part"])
def test_a_replay_never_replaces_its_own_source(tmp_path: Path, recorded: Path, name: str) -> None:
    source = recorded.rename(tmp_path / name)
    before = source.read_bytes()
    stand = replay(tmp_path / "stand.toml", source)
    words = ["record", "--stand", str(stand), "--duration", "1", "-o", str(tmp_path / "first.h5"), "--force"]
    assert run(words) == 2
    assert source.read_bytes() == before


def test_a_recording_is_played_back_without_a_stand_file(tmp_path: Path, recorded: Path) -> None:
    again = tmp_path / "again.h5"
    words = ["--fade", "0.2", "--amplitude", "0.001", "-o", str(again)]
    assert run(["record", "--backend", "replay", str(recorded), *words]) == 0
    with Recording(recorded) as first, Recording(again) as second:
        assert len(second) == len(first)
        np.testing.assert_array_equal(second.channel("torque"), first.channel("torque", 0, len(second)))
    assert run(["record", "--backend", "replay", str(recorded), "-o", str(recorded), "--force"]) == 2


@pytest.mark.parametrize(
    "words", [["--backend", "replay"], ["--backend", "sim", "a.h5"], ["a.h5"], ["--backend", "replay", "none.h5"]]
)
def test_a_replay_without_its_recording_is_wrong_use(words: list[str]) -> None:
    assert run(["record", *words]) == 2
