"""`hil hysteresis` as a person runs it, on recordings and on tables without a time."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from statistics import median

import numpy as np
import pytest

import hil as api
from hil.exchange.importer import Column, import_table
from hil.exchange.row_filter import RowFilter

from ..conftest import Hil, Maker

WEIGHTS = "load [N m],scale,angle [deg]\n" + "".join(f"{m},{m},{m / 10}\n" for m in [0, 2, 4, 6, 8, 6, 4, 2, 0])
PHASE = np.linspace(0.0, 5.0 * np.pi, 500)
TWO_SIDED = "load [N m],angle [deg]\n" + "".join(f"{8 * np.sin(one)},{np.sin(one - 0.1)}\n" for one in PHASE)


def test_a_table_of_weights_has_a_stiffness_and_no_damping(hil: Hil) -> None:
    Path("w.csv").write_text(WEIGHTS)
    ended = hil("hysteresis", "w.csv", "--json")
    assert ended.status == 0
    assert ended.json["loading_stiffness"]["value"] == pytest.approx(10.0 * 180.0 / np.pi, rel=1e-6)
    assert ended.json["damping"] is None
    shown = hil("hysteresis", "w.csv", "--part", "2:8N*m", "--report", "w.html", "--plot", "p")
    assert shown.out.startswith("loading stiffness 573 N m/rad from 2 to 8 N m\nhysteresis at 0 N m ")
    assert shown.out.count("Bc") == shown.out.count("for Bc") + 1
    assert "hil-hysteresis/1" in Path("w.html").read_text()
    assert Path("p/hysteresis.png").stat().st_size > 1000


@pytest.mark.parametrize(("size", "prefix"), [("", ""), ("m", "m")])
def test_a_page_shows_first_what_one_came_for_and_its_torques_with_one_prefix(hil: Hil, size: str, prefix: str) -> None:
    Path("w.csv").write_text(TWO_SIDED.replace("[N m]", f"[{size}N m]"))
    assert hil("hysteresis", "w.csv", "--report", "w.html").status == 0
    page = Path("w.html").read_text()
    body = page[page.index("<body>") : page.index('<script type="application/json" id="result">')]
    assert body.index("lost motion at") < body.index("</header>")
    assert f"<h2>Stiffness, {prefix}N m/rad</h2>" in body
    assert "<details" not in body
    assert body.count("Bc cannot come from this") == 1
    assert set(re.findall(r"\b([mu]?)N m", body[: body.index("<footer")])) == {prefix}


@pytest.mark.parametrize("words", [("identify", "--trials", 1), ("inspect",), ("hysteresis",)])
def test_a_command_that_cannot_draw_says_so_before_it_writes_anything(
    hil: Hil, make_recording: Maker, monkeypatch: pytest.MonkeyPatch, words: tuple[object, ...]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    report = () if words[0] == "inspect" else ("--report", "r.html")
    path = make_recording(samples=400, noise=2e-4)
    ended = hil(*words, path, "--plot", "p", *report)
    assert (ended.status, "pip install 'hil[plot]'" in ended.err, ended.out) == (2, True, "")
    assert [one.name for one in Path().iterdir()] == [path.name]


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


@pytest.mark.parametrize("torque", [0.001, np.nan, 1e300 * np.arange(2000.0)], ids=["rests", "unread", "huge"])
def test_a_recording_without_a_load_has_no_loop(make_recording: Maker, torque: float | np.ndarray) -> None:
    with pytest.raises(api.Untrustworthy, match="torque or angle never changes"):
        api.hysteresis(make_recording(change=lambda channels: channels.update(torque=np.full(2000, torque))))


def test_a_torque_without_a_stroke_loads_no_joint(tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text("torque [N*m],angle [rad]\n1,0\n-1,0\n" + 4 * "0,0.1\n")
    with pytest.raises(api.Untrustworthy, match="no branch"):
        api.hysteresis(tmp_path / "w.csv")


COLUMNS = {"time": Column("TIME", "s"), "torque": Column("TORQUE", "N*m"), "dtheta": Column("POSITION", "rev")}


@pytest.mark.parametrize(("noise", "warned"), [(0.02, False), (2.0, True)])
def test_noise_above_the_torque_of_the_lost_motion_is_a_warning(tmp_path: Path, noise: float, warned: bool) -> None:
    load = 25.0 * np.arcsin(np.sin(np.linspace(0.0, 19.0, 3000)))
    read = load + np.random.default_rng(0).normal(0.0, noise, 3000)
    np.savetxt(tmp_path / "a.csv", np.c_[read, load / 500.0], delimiter=",", header="t [N m],q [rad]", comments="")
    found = api.hysteresis(tmp_path / "a.csv")
    assert ["It hides part of a gap" in one for one in found.as_json()["warnings"]] == [True] * warned


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
