"""`hil hysteresis` as a person runs it, on recordings and on tables without a time."""

from __future__ import annotations

from pathlib import Path
from statistics import median

import numpy as np
import pytest

import hil as api
from hil.exchange.importer import Column, import_table
from hil.exchange.row_filter import RowFilter

from ..conftest import Hil, Maker

WEIGHTS = "load [N m],scale,angle [deg]\n" + "".join(f"{m},{m},{m / 10}\n" for m in [0, 2, 4, 6, 8, 6, 4, 2, 0])


def test_a_table_of_weights_has_a_stiffness_and_no_damping(hil: Hil) -> None:
    Path("w.csv").write_text(WEIGHTS)
    ended = hil("hysteresis", "w.csv", "--json")
    assert ended.status == 0
    assert ended.json["loading_stiffness"]["value"] == pytest.approx(10.0 * 180.0 / np.pi, rel=1e-6)
    assert ended.json["damping"] is None
    shown = hil("hysteresis", "w.csv", "--part", "2:8N*m", "--report", "w.html", "--plot", "p")
    assert shown.out.startswith("loading stiffness 573 N m/rad, from 2 N m to 8 N m; no Bc from this")
    assert "Bc cannot come from this" in shown.out
    assert "hil-hysteresis/1" in Path("w.html").read_text()
    assert Path("p/hysteresis.png").stat().st_size > 1000


def test_a_fast_recording_has_no_stiffness_by_its_slope(hil: Hil, make_recording: Maker) -> None:
    ended = hil("hysteresis", make_recording(noise=1e-5))
    assert (ended.status, ended.out) == (1, "")
    assert "a.h5 is not slow: a stroke takes 0." in ended.err


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        (WEIGHTS.replace(" [N m]", ""), (), "no column with a unit of torque: name the column with --torque"),
        (
            WEIGHTS.replace(" [N m]", ""),
            ("--torque", "load"),
            "does not say the unit of 'load': give it with --torque-unit",
        ),
        (WEIGHTS, ("--part", "8:2"), "write LOW:HIGH in N m"),
        (WEIGHTS.replace(",scale", ",scale [mN m]"), (), "2 columns with a unit of torque"),
    ],
)
def test_a_table_that_does_not_say_what_is_what_is_refused(
    hil: Hil, text: str, words: tuple[str, ...], said: str
) -> None:
    Path("w.csv").write_text(text)
    ended = hil("hysteresis", "w.csv", *words)
    assert ended.status == 2
    assert said in ended.err


def test_a_recording_that_rests_has_no_loop(make_recording: Maker) -> None:
    def rest(channels: dict[str, np.ndarray]) -> None:
        channels["torque"][:] = 0.001

    with pytest.raises(api.Untrustworthy, match="torque or angle never changes"):
        api.hysteresis(make_recording(change=rest))


COLUMNS = {"time": Column("TIME", "s"), "torque": Column("TORQUE", "N*m"), "dtheta": Column("POSITION", "rev")}


@pytest.mark.study
def test_three_ramps_of_each_real_actuator_agree(tmp_path: Path, locked_output: Path) -> None:
    ratios = []
    for source in locked_output.glob("*.csv.gz"):
        runs = [tmp_path / f"{source.stem}{run}.h5" for run in (100, 101, 102)]
        for run in runs:
            import_table(source, run, COLUMNS, [RowFilter.parse(f"test_nr=={run.stem[-3:]}")])
        each = api.hysteresis(runs).measures.by_recording.values()
        ratios.append(max(each) / min(each))
    assert median(ratios) < 1.08
    assert max(ratios) < 1.2
