"""What people type wrongly at first: one sentence that says what was meant, before anything is done."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ..conftest import Hil, Maker


@pytest.mark.parametrize(
    "words",
    [
        ("record", "--backend", "sim", "--amplitude", "0,005"),
        ("record", "--backend", "sim", "--duration", "0,005 min"),
        ("record", "--backend", "sim", "--band", "0,005:20"),
        ("doctor", "--rate", "0,005"),
        ("identify", "a.h5", "--mutation", "0,005"),
        ("identify", "a.h5", "--bounds", "Kc=0,005:1"),
        ("identify", "a.h5", "--expect", "Kc=0,005:2%"),
        ("stand", "new", "--yes", "--set", "limits.torque=0,005"),
        ("stand", "new", "--yes", "--set", "stand.gear_ratio=0,005"),
        ("doctor", "comma.toml"),
        ("campaign", "comma.toml"),
        ("import", "a.csv", "-o", "b.h5", "--where", "nr==0,005"),
    ],
)
def test_a_decimal_comma_is_named_with_the_number_that_was_meant(hil: Hil, words: tuple[str, ...]) -> None:
    Path("comma.toml").write_text("[limits]\ntorque = 0,005  # N m\n", encoding="ascii")
    ended = hil(*words)
    assert (ended.status, "has a decimal comma: write 0.005" in ended.err) == (2, True), ended.err


@pytest.mark.parametrize("words", [("identify",), ("inspect",), ("export", "-o", "a.csv"), ("compare", "good.h5")])
def test_a_missing_recording_is_looked_for_in_its_unfinished_file(
    hil: Hil, make_recording: Maker, words: tuple[str, ...]
) -> None:
    make_recording("good.h5", samples=400)
    Path("kill.h5.part").touch()
    ended = hil(*words, "kill.h5")
    assert (ended.status, "hil recover kill.h5.part" in ended.err) == (2, True)


@pytest.mark.parametrize(
    "words",
    [
        ("identify", "good.h5", "--report", "/proc/new.html"),
        ("identify", "good.h5", "--plot", "/proc/new"),
        ("identify", "good.h5", "--checkpoint", "/proc/new.npz"),
        ("compare", "good.h5", "good.h5", "--report", "/proc/new.html"),
        ("inspect", "good.h5", "--plot", "/proc/new"),
        ("export", "good.h5", "-o", "/proc/new.xml"),
        ("replicate", "-o", "/proc/new"),
    ],
)
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder that not even root can write is needed")
def test_a_folder_that_cannot_be_written_is_found_before_the_work(
    hil: Hil, make_recording: Maker, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    make_recording("good.h5", samples=400)
    for work in ("api.analysis.identify", "api.analysis.compare", "identification.replicate.replicate"):
        monkeypatch.setattr(f"hil.{work}", lambda *_, **__: pytest.fail("the work has begun"))
    ended = hil(*words)
    assert (ended.status, "cannot be written" in ended.err) == (2, True), ended.err


def test_a_stand_file_in_the_place_of_a_recording_is_named_with_stand(hil: Hil) -> None:
    Path("stand.toml").write_text("[stand]\n", encoding="ascii")
    assert "hil record --stand stand.toml" in hil("record", "stand.toml").err
    assert "--stand stand.toml" in hil("inspect", "stand.toml").err


@pytest.mark.parametrize(("given", "made"), [("b", "b.h5"), ("run_0.5Hz", "run_0.5Hz.h5"), ("c.hdf5", "c.hdf5")])
def test_a_recording_without_a_suffix_gets_one(hil: Hil, given: str, made: str) -> None:
    assert hil("record", "--backend", "sim", "--duration", 2, "--band", 5, "--rate", 50, "-o", given).status == 0
    assert [path.name for path in Path().glob("*[!.toml]")] == [made]


def test_ctrl_c_while_the_program_loads_is_one_line() -> None:
    code = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'typer': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from hil.cli import main\n"
        "main()\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "interrupted\n")


def test_the_help_shows_the_options_of_the_genetic_algorithm_apart(hil: Hil) -> None:
    usual, _, genetic = hil("identify", "-h").out.partition("The paper's genetic algorithm:")
    assert "--report" in usual
    assert "--mutation" not in usual
    assert "--mutation" in genetic


@pytest.mark.parametrize(
    ("key", "number", "meant"),
    [
        ("limits.deflection", "60", "60 deg"),
        ("limits.deflection", "500", "500 mrad"),
        ("limits.torque", "300", "300 mN*m"),
        ("limits.temperature", "343", "343 K"),
        ("stand.motor_inertia", "10", "10 g*cm^2"),
        ("limits.torque", "30", "30 mN*m"),  # 1500 times what the drive can do
        ("odrive.torque_constant", "14.5", "14.5 mN*m/A"),
    ],
)
def test_a_number_that_cannot_be_meant_is_refused_with_the_unit_that_was(
    hil: Hil, key: str, number: str, meant: str
) -> None:
    new = ["stand", "new", "--yes"]
    if key.startswith("odrive"):
        new += ["--backend", "odrive", "--set", "odrive.interface=slcan", "--set", "odrive.channel=x"]
    ended = hil(*new, "--set", f"{key}={number}")
    assert (ended.status, f'write "{meant}"' in ended.err) == (2, True), ended.err
    if not key.startswith("odrive"):  # no motor has that torque constant
        unit = ended.err.split('or "')[1].split('"')[0]
        assert hil(*new, "--set", f"{key}={unit}").status == 0
