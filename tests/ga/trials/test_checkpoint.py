from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from ga.bounds import PAPER_BOUNDS
from ga.evolution.evolution import PRESETS, Settings
from ga.trials.checkpoint import SearchState, WrongCheckpoint, load, save
from ga.trials.outcome import Trials
from ga.trials.trials import run_trials

from .test_trials import assert_same

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.ga.conftest import Data

LONG = replace(PRESETS["paper"], generations=20_000)


@pytest.fixture(autouse=True)
def asked_after_each_thousand_generations(monkeypatch: pytest.MonkeyPatch) -> None:
    """No clock says when a run is asked to stop. The dense engine, since the other takes a minute to compile."""
    monkeypatch.setattr("ga.trials.trials._POLL", 0.0)
    monkeypatch.setattr("ga.trials.trials._CHUNK", 8_000_000)
    monkeypatch.setattr("ga.fitness.engine.WORTHWHILE", 10**30)


def once(times: int) -> Callable[[], bool]:
    """Says stop at the given time of asking."""
    asked = iter([False] * (times - 1) + [True])
    return lambda: next(asked)


def tried(data: Data, settings: Settings = LONG, **how: Any) -> Trials:
    how = {"trials": 3, "seed": 4, "workers": 1, "every": 0.0} | how
    return run_trials(data.columns, data.torque, PAPER_BOUNDS, settings, **how)


@pytest.mark.parametrize("boxes", [False, pytest.param(True, marks=pytest.mark.study)])
def test_a_run_cut_short_goes_on_to_the_same_bits(
    paper_like: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, boxes: bool
) -> None:
    if boxes:
        monkeypatch.setattr("ga.fitness.engine.WORTHWHILE", 0)
        monkeypatch.setattr("ga.fitness.engine.REPAID", 0)
        monkeypatch.setattr("ga.trials.trials._CHUNK", 200_000)
    file = tmp_path / "run.npz"
    part = tried(paper_like, stop=once(4), checkpoint=file)
    assert part.interrupted
    assert 0 == part.generations.min() < part.generations.max() < LONG.generations
    further = tried(paper_like, stop=once(4), checkpoint=file)
    assert further.made == further.evaluations - part.evaluations > 0
    end = tried(paper_like, checkpoint=file, workers=2)
    assert not end.interrupted
    assert_same(end, tried(paper_like))
    assert_same(end, tried(paper_like, checkpoint=file))  # a finished one is only read
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.npz"]


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_stopped_run_returns_is_whole(paper_like: Data, workers: int) -> None:
    part = tried(paper_like, replace(LONG, generations=10**12), stop=once(3), workers=workers)
    assert part.interrupted
    assert part.history.generation[-1] == part.generations.max()
    assert np.array_equal(part.history.fitness[:, -1], part.fitness)
    assert np.all(np.diff(part.history.fitness, axis=1) <= 0.0)
    assert part.evaluations == 30 + part.generations.sum()


def test_ctrl_c_keeps_what_is_done_where_stopping_was_asked_for(paper_like: Data, tmp_path: Path) -> None:
    def interrupt(_done: float) -> None:
        raise KeyboardInterrupt

    assert tried(paper_like, stop=lambda: False, progress=interrupt).interrupted
    with pytest.raises(KeyboardInterrupt):
        tried(paper_like, checkpoint=tmp_path / "run.npz", progress=interrupt)
    assert_same(tried(paper_like, checkpoint=tmp_path / "run.npz"), tried(paper_like))


def test_a_run_of_the_default_preset_goes_on_as_well(paper_like: Data, tmp_path: Path) -> None:
    settings = replace(PRESETS["default"], generations=500, tolerance=None)
    file = tmp_path / "run.npz"
    part = tried(paper_like, settings, stop=once(3), checkpoint=file)
    assert part.interrupted
    assert_same(tried(paper_like, settings, checkpoint=file), tried(paper_like, settings))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"seed": 5}, "different seed:"),
        ({"trials": 4}, "different number of trials:"),
        ({"settings": replace(LONG, mutation=0.1)}, "different settings:"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused(
    paper_like: Data, tmp_path: Path, change: dict[str, Any], what: str
) -> None:
    file = tmp_path / "run.npz"
    tried(paper_like, stop=once(1), checkpoint=file)
    with pytest.raises(WrongCheckpoint, match=what):
        tried(paper_like, change.pop("settings", LONG), checkpoint=file, **change)


def test_a_checkpoint_of_other_data_is_refused(paper_like: Data, tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    tried(paper_like, stop=once(1), checkpoint=file)
    other = paper_like._replace(torque=np.nextafter(paper_like.torque, 1.0))
    with pytest.raises(WrongCheckpoint, match="different data: run it as it was begun"):
        tried(other, checkpoint=file)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 torn", b"\x93NUMPY junk"])
def test_a_damaged_checkpoint_is_refused_with_its_name(paper_like: Data, tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "run.npz"
    file.write_bytes(content)
    with pytest.raises(WrongCheckpoint, match=r"run\.npz is not a checkpoint"):
        tried(paper_like, checkpoint=file)


def test_a_checkpoint_whose_parts_are_said_to_begin_before_it_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    np.savez(path, a=np.zeros(3))
    data = bytearray(path.read_bytes())
    data[-6:-2] = (int.from_bytes(data[-6:-2], "little") + 1000).to_bytes(4, "little")  # of the central directory
    path.write_bytes(data)
    with pytest.raises(WrongCheckpoint, match="not a checkpoint"):
        load(path, {})


def test_a_checkpoint_is_an_ordinary_file_and_nothing_else_is_read_or_replaced(tmp_path: Path) -> None:
    """A FIFO would hang, an endless device would fill the memory."""
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path / "fifo", Path("/dev/zero")):
        with pytest.raises(WrongCheckpoint, match="not an ordinary file"):
            load(path, {})
        with pytest.raises(OSError, match="not an ordinary file"):
            save(path, {}, SearchState([], np.zeros(1)))
    assert [item.name for item in tmp_path.iterdir()] == ["fifo"]


def test_a_compressed_checkpoint_is_none_of_ours(tmp_path: Path) -> None:
    """A few kilobytes could fill the memory."""
    np.savez_compressed(tmp_path / "a.npz", records=np.zeros(1_000_000))
    with pytest.raises(WrongCheckpoint, match="not a checkpoint"):
        load(tmp_path / "a.npz", {})


def test_saving_follows_no_link_that_waits_under_the_name_of_its_draft(paper_like: Data, tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("mine")
    (tmp_path / "run.npz.tmp").symlink_to("victim")
    tried(paper_like, stop=once(1), checkpoint=tmp_path / "run.npz")
    assert (tmp_path / "victim").read_text() == "mine"
    assert {item.name for item in tmp_path.iterdir()} == {"victim", "run.npz.tmp", "run.npz"}
