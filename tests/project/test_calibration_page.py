"""The commands of docs/calibration.md run, and store what the page says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hil.cli.app import run
from hil.stand.file import load

PAGE = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text(encoding="utf-8")
STAND = """
[stand]
backend = "sim"
gear_ratio = 4.0
motor_inertia = 2.0e-7
torque_source = "joint"
[limits]
torque = 0.03
deflection = 1.5
velocity = 100.0
"""


def block(mark: str, language: str) -> str:
    found = re.search(rf"<!-- {mark} -->\s*```{language}\n(.+?)\n```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_calibrations_are_made_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "points.csv").write_text(block("points", "csv") + "\n")
    cell = '[joint_sensor]\nkind = "loadcell"\nport = "none"\nscale = 1.0\n'
    torque, zero, fixture = (shlex.split(line)[1:] for line in block("commands", "sh").splitlines())
    (tmp_path / "stand.toml").write_text(STAND + cell)
    assert run(torque) == 0
    calibrated = load(tmp_path / "stand.toml")
    assert calibrated.calibration.torque is not None
    assert calibrated.calibration.torque.scale == pytest.approx(1e-7, rel=2e-3)
    assert calibrated.stand.torque_uncertainty == calibrated.calibration.torque.uncertainty
    (tmp_path / "stand.toml").write_text(STAND)  # the simulated joint has a cell of its own
    assert run(zero) == 0
    assert run(fixture) == 0
    assert list(load(tmp_path / "stand.toml").calibration.made()) == ["fixture", "zero"]
