"""The lateness that a recording stores is that of its rows."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from drivers.servo import Status
from hil.cli import app as cli
from hil.recording.channels import ROW, Row, Rows
from hil.recording.lateness import Lateness
from hil.recording.reader import Recording


def rows_with(late: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Rows:
    rows = np.full(len(late), np.array(Row(0), dtype=ROW))
    rows["seq"] = np.arange(len(late))
    rows["time"] = rows["seq"] / 500.0 + late
    return rows


@pytest.mark.parametrize("median", [2e-6, 1e-4, 3e-2])
def test_the_quantiles_are_those_of_the_rows(median: float) -> None:
    late = median * np.random.default_rng(0).lognormal(size=20_000)
    lateness = Lateness(500.0)
    for block in np.array_split(rows_with(late), 7):
        lateness.add(block)
    seen = lateness.attributes()
    for name, share in (("lateness_p50", 0.5), ("lateness_p99", 0.99)):
        assert seen[name] == pytest.approx(np.quantile(late, share), rel=0.01, abs=1e-9)
    assert seen["lateness_max"] == pytest.approx(late.max())
    assert seen["missed"] == 0


def test_missed_ticks_are_counted_and_have_no_lateness() -> None:
    rows = rows_with(np.full(100, 1e-5))
    rows["status"][10:13] = int(Status.MISSED | Status.LATE | Status.NO_REPLY)
    rows["time"][10:13] += 1.0
    rows["time"][20] = math.nan
    lateness = Lateness(500.0)
    lateness.add(rows)
    assert lateness.attributes()["missed"] == 3
    assert lateness.attributes()["lateness_max"] == pytest.approx(1e-5)


@pytest.mark.study
def test_in_virtual_time_nothing_is_late_and_a_table_has_no_lateness(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.h5"
    assert cli.run(["record", "--backend", "sim", "--duration", "1", "--band", "2:20", "-o", str(path)]) == 0
    with Recording(path) as recording:
        assert recording.attributes["lateness_p99"] < 1e-6
    assert math.isnan(Lateness(math.nan).attributes()["lateness_max"])
    capfd.readouterr()
    cli.run(["inspect", str(path), "--json"])
    seen = json.loads(capfd.readouterr().out)
    assert seen["missed"] == 0
    assert max(seen["lateness"]) < 1e-6
