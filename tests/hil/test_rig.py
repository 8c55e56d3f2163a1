"""The compliance of the fixture taken off a result."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.cli import run
from hil.part import Header, write
from hil.store import Array

from .conftest import Maker

KC, BC = 0.02, 2e-4
FIXTURE = (0.2, 1e-3)
OMEGAS = (2.0 * math.pi * 1.3, 2.0 * math.pi * 7.1)


def in_series(folder: Path) -> Path:
    """Two sines on joint and fixture in series, each at its own frequency in closed form."""
    time = np.arange(4000) / 500.0
    dtheta, torque = np.zeros(4000), 1e-5 * np.random.default_rng(0).standard_normal(4000)
    for amplitude, omega in zip((0.2, 0.1), OMEGAS, strict=True):
        joint, held = KC + 1j * omega * BC, FIXTURE[0] + 1j * omega * FIXTURE[1]
        wave: Array = amplitude * np.exp(1j * omega * time)
        dtheta += wave.imag
        torque += (joint * held / (joint + held) * wave).imag
    path = folder / "joint.h5"
    write(path, Header(profile={"kind": "imported"}), {"time": time, "torque": torque, "dtheta": dtheta})
    return path


def test_the_fixture_is_taken_off_the_result(
    make_recording: Maker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def told(*words: str) -> dict[str, Any]:
        assert run(["identify", str(joint), "--json", *words]) == 0
        found: dict[str, Any] = json.loads(capfd.readouterr().out)["parameters"]
        return found

    joint = in_series(tmp_path)
    rig = make_recording("rig.h5", kc=FIXTURE[0], bc=FIXTURE[1], noise=1e-5)
    plain, alone = told(), told("--fixture", str(rig))
    assert plain["Kc"]["value"] == pytest.approx(1.0 / (1.0 / KC + 1.0 / FIXTURE[0]), rel=0.03)
    assert alone["Kc"]["value"] == pytest.approx(KC, rel=5e-3)
    assert alone["Bc"]["value"] == pytest.approx(BC, rel=1e-2)
    assert alone["Kc"]["ci95"][0] < alone["Kc"]["exact"] < alone["Kc"]["ci95"][1]


def test_a_fixture_softer_than_the_joint_is_refused(make_recording: Maker, capfd: pytest.CaptureFixture[str]) -> None:
    joint, rig = make_recording(noise=1e-5), make_recording("rig.h5", kc=0.01, noise=1e-5)
    assert run(["identify", str(joint), "--fixture", str(rig)]) == 1
    assert "softer than the joint" in capfd.readouterr().err
