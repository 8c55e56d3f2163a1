"""Ctrl-C while a command searches: the result so far, the message, and that the search can be resumed."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ga.first_run import announce
from hil.cli.app import run
from hil.cli.progress import Lines, progress

from ..conftest import Maker

LONG = (
    "--model",
    "linear",
    "--preset",
    "paper",
    "--generations",
    "100000",
    "--trials",
    "3",
    "--workers",
    "2",
    "--json",
)


@pytest.fixture(autouse=True)
def in_short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a search look for Ctrl-C at once and often: a short one is interrupted on a quick computer too."""
    monkeypatch.setattr("ga.trials.trials._POLL", 0.002)
    monkeypatch.setattr("ga.trials.trials._CHUNK", 4_000_000)


@contextmanager
def interrupting() -> Iterator[Callable[[str, float], None]]:
    """In the place of the progress bar: Ctrl-C at the first sign of the search."""

    def interrupt(what: str, _done: float) -> None:
        if what == "searching":
            raise KeyboardInterrupt

    yield interrupt


@pytest.mark.study
def test_an_interrupted_search_goes_on_to_the_result_of_one_in_one_go(
    make_recording: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["identify", str(make_recording(noise=1e-4)), *LONG]
    state = tmp_path / "search.npz"
    monkeypatch.setattr("sys.argv", ["hil", *words, "--checkpoint", str(state)])
    with monkeypatch.context() as patch:
        patch.setattr("hil.cli.identify.progress", interrupting)
        assert run([*words, "--checkpoint", str(state)]) == 130
    out, err = capfd.readouterr()
    part = json.loads(out)
    assert part["evaluations"] < 3 * 100_000
    assert "not-converged" in [warning["code"] for warning in part["warnings"]]
    assert f"resume with: hil {' '.join(words)} --checkpoint {state}" in err

    assert run([*words, "--checkpoint", str(state)]) == 0
    gone_on = json.loads(capfd.readouterr().out)
    assert run(words) == 0
    whole = json.loads(capfd.readouterr().out)
    for table in (gone_on, whole):
        del table["seconds"]
    assert gone_on == whole


def test_an_interrupted_search_without_a_checkpoint_still_prints_its_result(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hil.cli.identify.progress", interrupting)
    assert run(["identify", str(make_recording(noise=1e-4)), *LONG]) == 130
    out, err = capfd.readouterr()
    assert json.loads(out)["parameters"]["Kc"]["value"] > 0.0
    assert "use --checkpoint to be able to resume" in err


@pytest.mark.study
def test_an_interrupted_replication_goes_on_when_the_command_is_given_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["replicate", "--evaluations", "100000", "--trials", "2", "-o", str(tmp_path), "--json"]
    with monkeypatch.context() as patch:
        patch.setattr("hil.cli.replicate.progress", interrupting)
        assert run(words) == 130
    out, err = capfd.readouterr()
    assert json.loads(out)["interrupted"]
    state = tmp_path / "search-2x100000-seed0.npz"
    assert f"{state} holds the progress" in err
    assert state.exists()
    assert run(words) == 0
    found = json.loads(capfd.readouterr().out)
    assert not found["interrupted"]
    assert found["evaluations"] == 2 * (10 + 100_000)
    assert not state.exists()


def test_a_file_that_is_no_checkpoint_is_left_alone(
    make_recording: Maker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, precious = make_recording(noise=1e-4), tmp_path / "notes.txt"
    precious.write_text("mine")
    assert run(["identify", str(path), "--checkpoint", str(precious)]) == 2
    assert "notes.txt is not a checkpoint" in capfd.readouterr().err
    assert precious.read_text() == "mine"


def test_a_checkpoint_that_cannot_be_written_is_told_before_the_search(
    make_recording: Maker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    nowhere = tmp_path / "none" / "search.npz"
    assert run(["identify", str(make_recording()), *LONG, "--checkpoint", str(nowhere)]) == 2
    assert f"{nowhere.parent} is not a folder" in capfd.readouterr().err


def test_elsewhere_than_on_a_terminal_a_long_search_says_a_line_now_and_then(capfd: pytest.CaptureFixture[str]) -> None:
    seconds = iter(range(0, 100_000, 4))
    lines = Lines(now=lambda: float(next(seconds)))
    for percent in range(101):  # 4 s each
        lines("searching", percent / 100.0)
    said = capfd.readouterr().err.splitlines()
    assert said[:2] == ["searching: 10% done, about 360 s left", "searching: 20% done, about 320 s left"]
    assert len(said) == 10


def test_what_is_quick_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    lines = Lines(now=lambda: 0.0)
    for percent in range(101):
        lines("searching", percent / 100.0)
    assert capfd.readouterr().err == ""


def test_what_the_first_run_compiles_is_said_at_once_and_goes_on(capfd: pytest.CaptureFixture[str]) -> None:
    with progress():
        announce(compiled=0)
        announce(compiled=1)
    assert capfd.readouterr().err.splitlines() == ["compiling what runs here for the first time (0 functions done)"]
    seconds = iter(range(0, 100, 4))
    lines = Lines(now=lambda: float(next(seconds)))
    for count in range(6):
        lines(f"compiling ({count})", math.nan)
    assert capfd.readouterr().err.splitlines() == ["compiling (0)", "compiling (3)"]


@pytest.mark.study
def test_a_search_of_many_generations_says_first_how_long_it_will_take(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hil.signals.constants.LONG_SEARCH", 5_000)
    words = ["identify", str(make_recording()), "--model", "linear", "--preset", "paper", "--trials", "1", "--json"]
    run([*words, "--workers", "1", "--generations", "5000"])
    said = capfd.readouterr().err
    assert re.search(r"searching with 5,000 evaluations: about \d+:\d\d:\d\d h; Ctrl-C ends it", said)
    run([*words, "--workers", "1", "--generations", "500"])
    assert "evaluations: about" not in capfd.readouterr().err
