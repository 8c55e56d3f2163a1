"""The compliance of the fixture removed from a result."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.cli.app import run
from hil.recording.reader import Array
from hil.recording.writer import Header, write

from ..conftest import Maker, edited

KC, BC = 0.02, 2e-4
FIXTURE = (0.2, 1e-3)
OMEGAS = (2.0 * math.pi * 1.3, 2.0 * math.pi * 7.1)


def in_series(folder: Path) -> Path:
    """Two sines on joint and fixture in series, each at its own frequency in closed form."""
    time = np.arange(2000) / 500.0
    dtheta, torque = np.zeros(2000), 1e-5 * np.random.default_rng(0).standard_normal(2000)
    for amplitude, omega in zip((0.2, 0.1), OMEGAS, strict=True):
        joint, held = KC + 1j * omega * BC, FIXTURE[0] + 1j * omega * FIXTURE[1]
        wave: Array = amplitude * np.exp(1j * omega * time)
        dtheta += wave.imag
        torque += (joint * held / (joint + held) * wave).imag
    path = folder / "joint.h5"
    write(path, Header(profile={"kind": "imported"}), {"time": time, "torque": torque, "dtheta": dtheta})
    return path


def test_a_fixture_softer_than_the_joint_is_refused(make_recording: Maker, capfd: pytest.CaptureFixture[str]) -> None:
    joint, rig = (make_recording(f"{kc}.h5", kc=kc, samples=600, noise=1e-5) for kc in (0.02, 0.01))
    assert run(["identify", str(joint), "--fixture", str(rig), "--model", "linear", "--trials", "1"]) == 1
    assert "softer than the joint" in capfd.readouterr().err


def identified(capfd: pytest.CaptureFixture[str], joint: Path, rig: Path, *words: str) -> tuple[int, dict[str, Any]]:
    status = run(["identify", str(joint), "--fixture", str(rig), "--trials", "1", "--json", *words])
    found: dict[str, Any] = json.loads(capfd.readouterr().out)
    return status, found


def test_the_fixture_is_taken_off_the_result_and_named_with_what_it_gave(
    make_recording: Maker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Two parts in series are not linear, whether that moves Kc or Bc out of its interval or not."""
    joint = in_series(tmp_path)
    rig = make_recording("rig.h5", kc=FIXTURE[0], bc=FIXTURE[1], noise=1e-5)
    status, found = identified(capfd, joint, rig)
    assert (status, found["warnings"] + found["errors"], found["fixture"]["recording"]) == (0, [], str(rig))
    assert found["fixture"]["parameters"]["Kc"]["value"] == pytest.approx(FIXTURE[0], rel=1e-3)
    kc, bc = (found["parameters"][name] for name in ("Kc", "Bc"))
    assert kc["value"] == pytest.approx(KC, rel=5e-3)
    assert bc["value"] == pytest.approx(BC, rel=1e-2)
    assert kc["ci95"][0] < kc["value"] < kc["ci95"][1]
    run(["identify", str(joint), "--fixture", str(rig), "--trials", "1", "--model", "linear"])
    assert "the fixture, Kc 200 mN m/rad and Bc 1 mN m s/rad, is removed" in capfd.readouterr().out


@pytest.mark.study
def test_a_recording_that_cannot_tell_the_fixture_cannot_correct_for_it(
    make_recording: Maker, capfd: pytest.CaptureFixture[str]
) -> None:
    joint = make_recording(samples=600, noise=1e-5)
    rig = make_recording("rig.h5", samples=600, kc=0.15, bc=1e-3, noise=0.5)  # nothing of it is seen but noise
    status, found = identified(capfd, joint, rig)
    assert status == 1
    assert {said["code"] for said in found["errors"]} == {"unusable"}
    assert f"{rig} does not identify the stiffness of the fixture: " in found["errors"][0]["message"]


@pytest.mark.study
def test_a_damping_lost_in_that_of_the_fixture_is_not_identifiable(
    make_recording: Maker, capfd: pytest.CaptureFixture[str]
) -> None:
    joint, rig = make_recording(noise=2.5e-3), make_recording("rig.h5", kc=0.05, bc=2e-3, noise=1e-5)
    status, found = identified(capfd, joint, rig)
    assert status == 1
    assert found["parameters"]["Kc"]["identifiable"]
    assert not found["parameters"]["Bc"]["identifiable"]
    (said,) = [one for one in found["errors"] if one["code"] == "not-identifiable"]
    assert said["parameter"] == "Bc"
    assert "Stiffen the fixture" in said["message"]


@pytest.mark.study
def test_an_uncertain_torque_is_carried_in_once(make_recording: Maker, capfd: pytest.CaptureFixture[str]) -> None:
    """Both recordings are wrong by the same part, and so is what is left: 2 % stays 2 %."""
    joint, rig = make_recording(noise=1e-5), make_recording("rig.h5", kc=0.05, bc=2e-4, noise=1e-5)
    for path in (joint, rig):
        with edited(path) as file:
            file.attrs["stand_toml"] = "[stand]\ntorque_uncertainty = 0.02\n"
    for parameter in identified(capfd, joint, rig)[1]["parameters"].values():
        half = 0.5 * (parameter["ci95"][1] - parameter["ci95"][0])
        assert half == pytest.approx(1.96 * 0.02 * parameter["value"], rel=0.02)


@pytest.mark.study
def test_the_fixture_of_another_stand_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name in ("joint", "rig"):
        stand = f'[stand]\nname = "{name}"\n'
        write(tmp_path / f"{name}.h5", Header(profile={}, stand_toml=stand), {"time": np.arange(4000) / 500.0})
    joint, rig = tmp_path / "joint.h5", tmp_path / "rig.h5"
    assert run(["identify", str(joint), "--fixture", str(rig)]) == 2
    assert "take recordings of one stand" in capfd.readouterr().err
    assert run(["identify", str(joint), "--fixture", str(joint)]) == 2
    assert "the same run" in capfd.readouterr().err


def test_a_model_without_the_couplings_parameters_is_refused(
    make_recording: Maker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model.py"
    model.write_text(
        "from typing import Annotated\n"
        "def bent(time, dtheta, dtheta_dot, *, k: Annotated[float, 'N*m/rad', 0.0, 1.0]):\n    return k * dtheta\n"
    )
    joint, rig = make_recording(noise=1e-5), make_recording("rig.h5", kc=0.2, noise=1e-5)
    assert run(["identify", str(joint), "--fixture", str(rig), "--model", f"{model}:bent"]) == 2
    assert "has k: give its parameters" in capfd.readouterr().err
