"""Recordings of rows that no bench makes: they end in a sentence, or the rows are left out and said so."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hil.cli.terminal import out
from hil.recording.reader import Array

from ..conftest import Hil, Maker

Change = Callable[[dict[str, Array]], object]


def times(factor: float, *names: str) -> Change:
    def change(channels: dict[str, Array]) -> None:
        for name in names:
            channels[name] *= factor

    return change


def put(name: str, value: float, at: slice = slice(None)) -> Change:
    return lambda channels: channels[name].__setitem__(at, value)


def whole_seconds(channels: dict[str, Array]) -> None:
    channels["time"] = np.floor(channels["time"] / 0.2)


REFUSED: dict[str, tuple[Change, str]] = {
    "huge": (times(1e300, "torque", "dtheta"), "usable sample"),
    "beyond a double": (times(1e308, "torque"), "usable sample"),
    "tiny angle": (times(1e-300, "dtheta"), "the deflection never changes"),
    "tiny torque": (times(1e-300, "torque"), "the torque never changes"),
    "tiny time": (times(1e-300, "time"), "apart, which no recorder does"),
    "slow": (times(1000.0, "time"), "the samples are 2 s apart (0.5 Hz), too slow"),
    "whole seconds": (whole_seconds, "100 successive rows share the time stamp 0 s. The stamps are whole seconds"),
    "a clock that stood still": (put("time", 0.0, slice(0, 50)), "50 successive rows share the time stamp 0 s"),
    "one time": (put("time", 0.0), "200 successive rows share the time stamp 0 s"),
    "backwards": (put("time", 0.0, slice(70, 71)), "time goes backwards"),
    "no time": (put("time", math.nan), "usable sample"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_rows_that_no_bench_makes_are_refused_in_a_sentence(hil: Hil, make_recording: Maker, name: str) -> None:
    change, words = REFUSED[name]
    path = make_recording(change=change, samples=200)
    for command in ("inspect", "identify"):
        ended = hil(command, path)
        assert ended.status == 1
        assert words in ended.err
        assert "fault in hil" not in ended.err


def test_one_impossible_number_is_left_out_and_said_so(hil: Hil, make_recording: Maker) -> None:
    """Kc is that of the closed form, 0.02 N m/rad, as if the row were not there."""
    ended = hil(
        "identify",
        make_recording(noise=1e-5, samples=1000, change=put("torque", 1e300, slice(700, 701))),
        "--model",
        "linear",
        "--json",
    )
    assert ended.status == 0
    assert ended.json["parameters"]["Kc"]["value"] == pytest.approx(0.02, rel=1e-3)
    assert "1 of 1000 rows hold no number, or one beyond 1e+12" in ended.err


def test_a_time_that_a_stamp_of_ros_cannot_hold_is_refused(hil: Hil, make_recording: Maker) -> None:
    ended = hil("export", make_recording(change=put("time", 1e17)), "-o", "a.mcap")
    assert ended.status == 2
    assert "a row has the time 1e+17 s, which a time stamp of ROS cannot hold" in ended.err
    assert not Path("a.mcap").exists()


def test_what_an_ascii_terminal_cannot_show_is_spelled_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "out"
    with place.open("w", encoding="ascii") as stream:
        monkeypatch.setattr("sys.stdout", stream)
        out("Kc = 17.78 ± 0.02 mN m/rad of Zürich")
    assert place.read_text(encoding="ascii") == "Kc = 17.78 +/- 0.02 mN m/rad of Z\\xfcrich\n"


@pytest.mark.study
@pytest.mark.parametrize("words", [("inspect",), ("identify", "--model", "linear")])
def test_a_picture_of_rows_beyond_any_bench_is_drawn(hil: Hil, make_recording: Maker, words: tuple[str, ...]) -> None:
    path = make_recording(change=partial(put("torque", 1.7e308, slice(0, 2000, 2))))
    option = ("--plot", "a") if words == ("inspect",) else ("--report", "a.html")
    assert "fault in hil" not in hil(*words, path, *option).err
