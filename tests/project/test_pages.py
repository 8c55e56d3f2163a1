"""The commands and the code of docs/data.md and docs/paper.md run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from hil.cli.app import run
from hil.recording.reader import Recording
from hil.recording.writer import Header, write

DOCS = Path(__file__).parent.parent.parent / "docs"
PAGE = (DOCS / "data.md").read_text(encoding="utf-8")


def block(mark: str, language: str) -> str:
    found = re.search(rf"<!-- {mark} -->\s*```{language}\n(.+?)\n```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_log_comes_in_through_the_stand_and_goes_out_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text(block("log", "csv") + "\n")
    (tmp_path / "stand.toml").write_text(block("stand", "toml") + "\n")
    for command in block("commands", "sh").splitlines():
        assert run(shlex.split(command)[1:]) == 0, command
    for name in ("log.h5", "again.h5"):
        with Recording(tmp_path / name) as recording:
            np.testing.assert_allclose(recording.channel("time"), [0.0, 0.002, 0.004])
            np.testing.assert_allclose(recording.channel("torque"), [0.0, 0.005, 0.01])
            np.testing.assert_allclose(recording.channel("dtheta"), np.radians([0.0, 0.05, 0.125]), atol=1e-15)
            assert "index finger" in recording.stand_toml


def test_recordings_are_compared_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    time = np.arange(0.0, 1.0, 0.002)
    for seed, name in enumerate("abc"):
        noise = 1e-4 * np.random.default_rng(seed).standard_normal(len(time))
        angle = 0.2 * np.sin(60.0 * time) + 0.2 * np.sin(9.0 * time)
        torque = 0.02 * angle + 2e-4 * np.gradient(angle, time) + noise
        write(tmp_path / f"{name}.h5", Header({"kind": "chirp"}), {"time": time, "torque": torque, "dtheta": angle})
    assert run(shlex.split(block("compare", "sh"))[1:]) == 0
    assert (tmp_path / "abc.html").exists()


def test_the_code_of_the_papers_page_makes_a_row_for_every_reading(capsys: pytest.CaptureFixture[str]) -> None:
    """With a thousandth of its generations."""
    (code,) = re.findall(r"```python\n(.+?)\n```", (DOCS / "paper.md").read_text(encoding="utf-8"), re.DOTALL)
    assert code.count("200_000") == 1
    exec(compile(code.replace("200_000", "200"), "paper.md", "exec"), {})  # noqa: S102 - our own page
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 2 * 2 * 4 + 1
    assert all(float(row.split("|")[-2]) >= 0.0 for row in rows)  # the gap to the exact optimum
