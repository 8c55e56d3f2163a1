"""The live line: it shows the state in the rows."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.acquisition.live_view import beside, line
from hil.child import command
from hil.recording.channels import END_MARK, ROW, Row
from hil.recording.writer import Header, RecordingWriter


def rows(written: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    table = np.full(1000, np.array(Row(END_MARK), dtype=ROW))
    table["seq"][:written] = np.arange(written)
    table["time"][:written] = np.arange(written) / 250.0
    table["torque"][:written] = 0.0042
    table["dtheta"][:written] = -0.12
    table["status"][[3, 9]] = 1
    return table


def test_the_line_shows_time_left_rate_torque_deflection_and_losses() -> None:
    shown = line(rows(500), duration=4.0)
    elapsed = 499 / 250.0
    assert f"{4.0 - elapsed:.1f}" == "2.0"
    for part in ("   2.0 s left", "250 Hz", "+4.20 mN m", "-0.1200 rad", "2 lost"):
        assert part in shown


def test_the_time_left_is_that_of_the_profile_and_never_below_zero() -> None:
    assert line(rows(1000), duration=10.0).startswith("   6.0 s left")  # the last row is at 3.996 s
    assert line(rows(1000), duration=3.0).startswith("   0.0 s left")


@pytest.mark.parametrize(("torque", "message"), [(-0.98765, "-987.65 mN m"), (-987.65, "-987.65 N m")])
def test_the_line_fits_a_terminal_of_eighty_columns(torque: float, message: str) -> None:
    table = rows(1000)
    table["time"] = 80_000.0 + np.arange(1000) / 10_000.0
    table["torque"], table["dtheta"], table["status"] = torque, -31.4159, 1
    shown = line(table, duration=172_800.0)
    assert message in shown
    assert shown.endswith("1000 lost")
    assert len(shown) < 80


def test_the_viewer_has_a_session_of_its_own_so_that_ctrl_c_does_not_reach_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []
    popen = subprocess.Popen

    def start(*words: Any, **settings: Any) -> Any:
        viewer = popen(*words, **settings)
        started.append(os.getsid(viewer.pid))
        return viewer

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"duration": 4.0}), 10) as part:
        monkeypatch.setattr(subprocess, "Popen", start)
        with beside(part.path):
            assert len(started) == 1
    assert started[0] != os.getsid(0)


def test_a_run_does_without_a_viewer_that_cannot_be_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*words: Any, **settings: Any) -> Any:
        raise OSError(12, f"no memory for {len(words)} words and {len(settings)} settings")

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(subprocess, "Popen", fail)
    with beside(tmp_path / "a.h5.part"):
        pass


def test_before_the_first_rows_the_line_is_starting() -> None:
    assert line(rows(0), duration=4.0) == "starting"


def test_the_viewer_ends_when_the_recorder_closes_it(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"duration": 4.0}), 10) as part:
        words = command("hil.acquisition.live_view", str(part.path))
        viewer = subprocess.run(words, check=False, input=b"", capture_output=True)
    assert viewer.returncode == 0
