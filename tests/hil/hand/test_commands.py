"""The file of a hand in the commands that take a stand: they use one joint of it, and write into that joint."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.hand.file import load
from hil.recording.reader import Recording
from hil.stand.file import parse

from ..conftest import Hil
from .conftest import SIMULATED_HAND

COLUMNS = ("--time", "time", "--torque", "torque", "--dtheta", "dtheta")


@pytest.fixture
def hand(tmp_path: Path) -> Path:
    path = tmp_path / "hand.toml"
    path.write_text(SIMULATED_HAND)
    return path


def test_a_command_records_the_named_joint_and_its_recording_has_an_ordinary_stand(hil: Hil, hand: Path) -> None:
    refused = hil("record", "--stand", hand, "-o", "no.h5")
    assert (refused.status, refused.out) == (2, "")
    assert "choose a joint with --joint NAME: soft, stiff" in refused.err
    assert "unknown joint 'stif': did you mean 'stiff'?" in hil("record", "--stand", hand, "--joint", "stif").err
    assert hil("record", "--joint", "stiff", "--duration", 0.5, "-o", "run.h5").status == 0  # finds hand.toml here
    with Recording(Path("run.h5")) as recording:
        stand = parse(str(recording.attributes["stand_toml"]))
    assert (stand.stand.name, stand.stand.gear_ratio, stand.sim.coupling.stiffness) == ("bench hand, stiff", 5.0, 0.03)
    assert "Kc" in hil("design", "--stand", hand, "--joint", "soft", "--duration", 2).out
    assert "only the file of a hand has joints" in hil("record", "--backend", "sim", "--joint", "stiff").err
    Path("stand.toml").write_text(stand.text)
    assert "is the stand file of one joint" in hil("record", "--stand", "stand.toml", "--joint", "stiff").err


def test_a_table_is_imported_with_the_stand_of_the_named_joint(hil: Hil, hand: Path) -> None:
    Path("run.csv").write_text(
        "time [s],torque [N*m],dtheta [rad]\n" + "".join(f"{0.01 * n},0.00{n % 7},0.{n % 9}\n" for n in range(99))
    )
    assert "choose a joint" in hil("import", "run.csv", "--stand", hand, *COLUMNS, "-o", "run.h5").err
    assert hil("import", "run.csv", "--stand", hand, "--joint", "soft", *COLUMNS, "-o", "run.h5").status == 0
    with Recording(Path("run.h5")) as recording:
        assert 'name = "bench hand, soft"' in str(recording.attributes["stand_toml"])


def test_a_calibration_is_written_into_its_joint_and_changes_nothing_else(hil: Hil, hand: Path) -> None:
    assert "choose a joint" in hil("calibrate", "zero", hand, "--yes").err
    for name in ("soft", "stiff"):
        before = load(hand)
        ended = hil("calibrate", "zero", hand, "--joint", name, "--yes")
        assert ended.status == 0, ended.err
        after = load(hand)
        changed = [one.name for one, old in zip(after.joints, before.joints, strict=True) if one.stand != old.stand]
        assert changed == [name]
        assert after.joint(name).stand.calibration.zero is not None
        assert after.joints[0].also_moves == {"stiff": 0.5}
    kept = hand.read_text()
    assert all(line in kept for line in SIMULATED_HAND.splitlines())  # comments too


def test_the_doctor_names_no_firmware_of_a_drive_that_has_none(hil: Hil, hand: Path) -> None:
    soft, stiff, passed = hil("doctor", hand).out.splitlines()
    assert (soft.split(": ")[1], stiff.split(": ")[1]) == ("sim simulated joint, seed 0",) * 2
    assert passed == "2 of 2 joints passed"
