"""`hil calibrate`: the emulated torque cell under weights, and what it leaves in the stand file."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

import hil.calibration.session
from drivers.clock import Clock, VirtualClock
from drivers.loadcell.sensor import LoadCell
from hil.calibration.torque import GRAVITY
from hil.cli.app import run
from hil.stand.file import load
from sim_backend.wire.faults import Unplug
from sim_backend.wire.loadcell.emulator import EmulatedLoadCell, LoadCellBoard

from ...loopback import SerialLoopback
from ..conftest import Maker

STAND = """\
# the finger of the left hand
[stand]
backend = "sim"
torque_source = "joint"
zero = 0.25                   # after the encoder was replaced

[joint_sensor]                # on the lever
kind = "loadcell"
port = "loopback"
scale = 1e-7                  # guessed

[limits]
torque = 0.03
deflection = 1.5
velocity = 100.0
"""
TRUE_SCALE, ARM = 1.234e-7, 0.05


@dataclass
class Lever:
    """An emulated cell with whatever mass hangs on its lever, kg; a person hangs what the program asks for."""

    mass: float = 0.0
    turned: bool = False
    clock: VirtualClock = field(default_factory=VirtualClock)
    typed: list[str] = field(default_factory=list)
    emulated: EmulatedLoadCell | None = None
    unplug_at: int | None = None
    cut_at: float | None = None
    board: LoadCellBoard = field(default_factory=lambda: LoadCellBoard(scale=TRUE_SCALE, noise=2e-6))

    def mean(self, begin: float, end: float) -> float:
        torque = self.mass * GRAVITY * ARM * (-1.0 if self.turned else 1.0)
        if self.cut_at is None:
            return torque
        return torque * (max(0.0, min(end, self.cut_at) - begin)) / (end - begin)

    def opened(self, kind: str, table: Any, clock: Clock) -> LoadCell:
        assert kind == "loadcell"
        self.emulated = EmulatedLoadCell(self.board, self, now=clock.now())
        return LoadCell(table, clock=clock, port=SerialLoopback(self.emulated, clock, table.baudrate))

    def asked(self, _text: str, **_: object) -> str:
        """A person who types the next mass and hangs it, whatever was asked."""
        if not self.typed:
            return ""
        word = self.typed.pop(0)
        number = float(word.removesuffix("g") or 0.0)
        self.mass = 1e-3 * number if word.endswith("g") or number >= 1.0 else number  # who types 20 has 20 g in hand
        if self.unplug_at is not None and len(self.typed) <= self.unplug_at:
            assert self.emulated is not None
            self.emulated.faults.inject(Unplug())
        return word


@pytest.fixture
def lever(monkeypatch: pytest.MonkeyPatch) -> Lever:
    lever = Lever()
    monkeypatch.setattr("drivers.clock.MonotonicClock", lambda: lever.clock)
    monkeypatch.setattr(hil.calibration.session, "open_sensor", lever.opened)
    monkeypatch.setattr("typer.prompt", lever.asked)
    return lever


@pytest.fixture
def stand(tmp_path: Path) -> Path:
    path = tmp_path / "stand.toml"
    path.write_text(STAND)
    return path


def tables(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text())


WEIGHTS = ["", "0.02", "50g", "0.1", "50g", "0.02", "0", "-0.05", "-100g", "-0.05"]


def test_weights_typed_one_by_one_give_the_scale_and_the_comments_stay(
    lever: Lever, stand: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lever.typed = list(WEIGHTS)
    assert run(["calibrate", "torque", str(stand), "--arm", "50mm"]) == 0
    said = capfd.readouterr().out.splitlines()
    assert said[0].startswith("scale = (1.23")
    found = tables(stand)
    assert found["joint_sensor"]["scale"] == pytest.approx(TRUE_SCALE, rel=2e-3)
    assert found["stand"]["torque_uncertainty"] == pytest.approx(0.0101, abs=5e-4)  # 0.5 mm of 50 mm
    calibrated = load(stand).calibration.torque
    assert calibrated is not None
    assert calibrated.points == 9
    assert calibrated.hysteresis is not None
    assert calibrated.offset == pytest.approx(84_000, abs=50)
    for comment in ("# the finger of the left hand", "# after the encoder was replaced", "# on the lever", "# guessed"):
        assert comment in stand.read_text()


def test_a_file_of_masses_is_hung_and_read_in_its_order(lever: Lever, stand: Path, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("mass [g]\n20\n50\n100\n50\n-50\n")
    lever.typed = ["", "20g", "50g", "100g", "50g", "-50g"]
    assert run(["calibrate", "torque", str(stand), "--arm", "0.05", "--points", str(tmp_path / "points.csv")]) == 0
    assert tables(stand)["joint_sensor"]["scale"] == pytest.approx(TRUE_SCALE, rel=2e-3)


def test_a_file_with_readings_needs_no_cell_and_no_lever_for_torques(
    stand: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "points.csv").write_text("torque [mN m],value\n0,10\n10,100010\n20,200010\n-10,-99990\n")
    assert run(["calibrate", "torque", str(stand), "--points", str(tmp_path / "points.csv"), "--yes"]) == 0
    assert tables(stand)["joint_sensor"]["scale"] == pytest.approx(1e-7, rel=1e-6)
    assert "hysteresis" not in tables(stand)["calibration"]["torque"]
    assert "no-hysteresis" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("typed", "reason"), [(["", "20", "50", "100"], "grams"), (["", "0.02", "50g", "0.1", "20", "-0.05", "0"], "")]
)
def test_a_weight_typed_in_grams_is_left_out_and_said(
    lever: Lever, stand: Path, typed: list[str], reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    lever.typed = typed
    status = run(["calibrate", "torque", str(stand), "--arm", "50mm"])
    said = capfd.readouterr().err
    assert "typed in grams" in said
    assert "left out" in said
    if reason:  # all of them: nothing remains to calibrate with
        assert status == 2
        assert stand.read_text() == STAND
    else:
        assert status == 0
        assert tables(stand)["calibration"]["torque"]["points"] == 5


def test_a_cell_wired_the_wrong_way_round_leaves_the_file_untouched(
    lever: Lever, stand: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lever.turned = True
    lever.typed = list(WEIGHTS)
    assert run(["calibrate", "torque", str(stand), "--arm", "50mm"]) == 1
    assert "wired the wrong way round" in capfd.readouterr().err
    assert stand.read_text() == STAND


def test_an_adapter_unplugged_on_the_way_ends_in_a_sentence_and_leaves_the_file_untouched(
    lever: Lever, stand: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lever.typed = list(WEIGHTS)
    lever.unplug_at = 3
    assert run(["calibrate", "torque", str(stand), "--arm", "50mm"]) == 3
    said = capfd.readouterr().err
    assert "is gone" in said
    assert "Errno" not in said
    assert "Traceback" not in said
    assert stand.read_text() == STAND
    assert [path.name for path in stand.parent.iterdir()] == ["stand.toml"]


def test_the_step_of_a_load_that_is_taken_off_gives_the_delay_of_an_hx711(lever: Lever, stand: Path) -> None:
    lever.mass, lever.cut_at = 0.1, lever.clock.now() + 5.0
    assert run(["calibrate", "torque", str(stand), "--step", "--yes"]) == 0
    found = load(stand)
    assert found.calibration.step is not None
    assert found.calibration.step.delay == pytest.approx(0.025, abs=1e-3)  # the mean over 4 conversions, 80 a second
    assert found.calibration.step.bandwidth == pytest.approx(0.443 / 0.05, rel=0.02)
    assert found.sensor is not None
    assert found.sensor[1].delay == found.calibration.step.delay


def test_a_stand_without_a_cell_and_a_script_without_weights_are_refused(
    stand: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["calibrate", "torque", str(stand), "--yes", "--arm", "50mm"]) == 2
    assert "--points" in capfd.readouterr().err
    stand.write_text('[stand]\nbackend = "sim"\n')
    assert run(["calibrate", "torque", str(stand), "--step", "--yes"]) == 2
    assert "[joint_sensor]" in capfd.readouterr().err


@pytest.mark.parametrize("words", ["torque --arm 50mm", "torque --points points.csv", "fixture", "fixture --band abc"])
def test_nobody_is_asked_to_mount_anything_before_the_stand_file_is_right(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("points.csv").write_text("mass,value\n0,0\n0.05,0.1\n0.1,0.2\n")
    if "--band" in words or "torque" in words:
        Path("stand.toml").write_text('[stand]\nbackend = "sim"\n')
    kind, *options = words.split()
    assert run(["calibrate", kind, "stand.toml", *options]) == 2
    [said] = capfd.readouterr().err.splitlines()
    assert any(remedy in said for remedy in ("[joint_sensor]", "check the name", "write LOW:HIGH"))


def test_the_zero_is_where_the_motor_rests(stand: Path) -> None:
    stand.write_text(STAND[: STAND.index("[joint_sensor]")] + STAND[STAND.index("[limits]") :])
    assert run(["calibrate", "zero", str(stand), "--yes"]) == 0
    found = load(stand)
    assert found.calibration.zero is not None
    assert found.stand.zero == found.calibration.zero.zero
    assert abs(found.stand.zero) < 0.01  # of the simulated encoder, not on top of the old zero
    assert found.calibration.zero.uncertainty > 0.0


def test_an_empty_rig_is_identified_stored_and_used_by_the_name_of_the_stand_file(
    make_recording: Maker, stand: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rig = make_recording("rig.h5", samples=600, kc=0.2, bc=1e-3, noise=1e-5)
    joint = make_recording("joint.h5", samples=600, noise=1e-5)
    assert run(["calibrate", "fixture", str(stand), "--recording", str(rig)]) == 0
    assert capfd.readouterr().out.startswith("the fixture has 0.2")
    stored = load(stand).calibration.fixture
    assert stored is not None
    assert stored.recording == "rig.h5"
    assert abs(stored.stiffness - 0.2) < 3.0 * max(stored.stiffness_uncertainty, 1e-4)
    by_stand, by_recording = [
        (
            run(["identify", str(joint), "--json", "--trials", "2", "--fixture", str(place)]),
            capfd.readouterr().out.split('"seconds"')[0],
        )
        for place in (stand, rig)
    ]
    assert by_stand == by_recording
    rig.unlink()
    make_recording("rig.h5", kc=0.3, noise=1e-5)
    assert run(["identify", str(joint), "--fixture", str(stand)]) == 2
    assert "is not the recording" in capfd.readouterr().err


@pytest.mark.study
def test_a_recording_carries_its_calibrations_and_warns_of_an_old_one(
    make_recording: Maker, capfd: pytest.CaptureFixture[str]
) -> None:
    calibrated = (
        f"{STAND}[calibration]\nvalid_days = 30\n"
        "[calibration.zero]\ndate = 2020-01-01T00:00:00Z\nzero = 0.25\nuncertainty = 1e-3\n"
    )
    path = make_recording(noise=1e-5, stand=calibrated)
    assert run(["inspect", str(path)]) == 0
    assert "zero 2020-01-01" in capfd.readouterr().out
    run(["identify", str(path), "--model", "linear", "--trials", "2"])
    assert "calibration.valid_days = 30" in capfd.readouterr().err
