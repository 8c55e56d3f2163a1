"""The live line: what it shows is what the rows say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from hil.live import line
from hil.part import Header, PartFile, missing_row
from hil.store import ROW


def rows(written: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    table = np.full(1000, np.array(missing_row(2**64 - 1), dtype=ROW))
    table["seq"][:written] = np.arange(written)
    table["time"][:written] = np.arange(written) / 250.0
    table["torque"][:written] = 0.0042
    table["dtheta"][:written] = -0.12
    table["status"][[3, 9]] = 1
    return table


def test_the_line_shows_time_left_rate_torque_deflection_and_losses() -> None:
    shown = line(rows(500), duration=4.0)
    elapsed = 499 / 250.0
    for part in (f"{4.0 - elapsed:.1f} s left", "250 Hz", "+4.20 mN m", "-0.1200 rad", "2 lost"):
        assert part in shown


def test_before_the_first_rows_the_line_says_so() -> None:
    assert line(rows(0), duration=4.0) == "starting"


def test_the_viewer_ends_when_the_recorder_lets_go_of_it(tmp_path: Path) -> None:
    with PartFile(tmp_path / "a.h5", Header(profile={"duration": 4.0}), 10) as part:
        command = [sys.executable, "-m", "hil.live", str(part.path)]
        viewer = subprocess.run(command, check=False, input=b"", capture_output=True)
    assert viewer.returncode == 0
