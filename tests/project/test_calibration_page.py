"""The commands of docs/calibration.md run, and store what the page says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hil.cli.app import run
from hil.stand.file import load

PAGE = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"<!-- (run|write (\S+)) -->\n```\w+\n(.+?)\n```", re.DOTALL)


def test_the_calibrations_are_made_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for _, written, text in BLOCK.findall(PAGE):
        if written:
            Path(written).write_text(text + "\n")
        for command in () if written else text.splitlines():
            assert run(shlex.split(command)[1:]) == 0, command
    cell = load(tmp_path / "cell.toml")
    assert cell.calibration.torque is not None
    assert cell.calibration.torque.scale == pytest.approx(1e-7, rel=2e-3)
    assert cell.stand.torque_uncertainty == cell.calibration.torque.uncertainty
    assert list(load(tmp_path / "stand.toml").calibration.made()) == ["fixture", "zero"]
