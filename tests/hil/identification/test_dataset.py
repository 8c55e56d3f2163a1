"""A recording that does not fit in memory is identified as one that does."""

from __future__ import annotations

from collections import Counter
from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest

from ga.evolution.evolution import PRESETS
from ga.lad import out_of_core
from ga.model.coupling import parse as parse_model
from hil.identification.candidates.choice import Choice
from hil.identification.fitting.dataset import open_dataset
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.ahead import Progress
from hil.recording.reader import Array, Recording
from hil.signals import constants, source
from hil.signals.prepare import LongRecording, Signals
from hil.signals.source import open_sources

from ..conftest import Maker


def identified(paths: list[Path], model: str = "linear+offset+cubic") -> Identification:
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    return identify(paths, parse_model(model), search)


@pytest.fixture
def recordings(make_recording: Maker) -> list[Path]:
    def spoil(channels: dict[str, Array]) -> None:
        channels["torque"][40:45] = np.nan

    return [
        make_recording("a.h5", samples=1600, noise=2e-4),
        make_recording("b.h5", samples=800, noise=2e-4, change=spoil),
    ]


@pytest.mark.study
def test_on_disk_and_in_memory_give_the_same_answer(recordings: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    whole = identified(recordings)
    monkeypatch.setattr(constants, "IN_MEMORY", 1000)
    monkeypatch.setattr(out_of_core, "_SUBSAMPLE", 1200)
    before = sorted(recordings[0].parent.iterdir())
    parts = identified(recordings)
    assert sorted(recordings[0].parent.iterdir()) == before
    assert parts.samples == whole.samples > 2300
    assert parts.optimum == pytest.approx(whole.optimum, rel=1e-10)
    assert parts.fitness == pytest.approx(whole.fitness, rel=1e-6)
    assert parts.validation.fitness == pytest.approx(whole.validation.fitness, rel=1e-9)
    assert parts.validation.nrmse == pytest.approx(whole.validation.nrmse, rel=1e-9)
    assert [diagnostic.code for diagnostic in parts.diagnostics] == [
        diagnostic.code for diagnostic in whole.diagnostics
    ]
    for one, other in zip(parts.estimates, whole.estimates, strict=True):
        assert one.value == pytest.approx(other.value, rel=1e-9)
        assert one.ci95 == pytest.approx(other.ci95, rel=1e-6)
        assert one.identifiable == other.identifiable


@pytest.mark.study
def test_blocks_on_disk_in_which_no_row_can_be_used_are_passed_over_and_counted(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a cable was out for minutes: such a block has no window, no rate and no columns."""

    def unplugged(channels: dict[str, Array]) -> None:
        channels["torque"][1300:2600] = np.nan

    path = make_recording(samples=4000, noise=2e-4, change=unplugged)
    whole = identified([path])
    monkeypatch.setattr(constants, "IN_MEMORY", 1000)
    monkeypatch.setattr(LongRecording, "stream", partialmethod(LongRecording.stream, block=500))
    monkeypatch.setattr(LongRecording, "glimpse", partialmethod(LongRecording.glimpse, parts=6, rows=500))
    parts = identified([path])
    assert parts.optimum == pytest.approx(whole.optimum, rel=1e-10)
    assert parts.samples == whole.samples
    (lost,) = (one.message for one in parts.diagnostics if one.code == "invalid-readings")
    assert lost.startswith("1300 of 4000 rows hold no number")


def test_only_a_part_of_what_is_on_disk_is_held_in_memory(
    recordings: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(constants, "IN_MEMORY", 1000)
    seen = []

    def choose(signals: Signals, whole: bool) -> Choice:
        seen.append((len(signals), whole))
        return Choice(parse_model("linear").anchored(signals.motion))

    monkeypatch.setattr(LongRecording, "glimpse", partialmethod(LongRecording.glimpse, parts=2, rows=500))
    with open_sources(recordings) as sources, open_dataset(sources, choose) as data:
        assert seen == [(len(data.signals), False)]
        assert 1000 < len(data.signals) < 2000
        assert sum(len(torque) for _, torque in data.blocks()) == data.samples > 2300


@pytest.mark.parametrize("size", [0.0, 2e-3])
def test_a_step_of_a_zero_in_what_is_on_disk_is_an_error(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, size: float
) -> None:
    def tare(channels: dict[str, Array]) -> None:
        channels["torque"][2500:] += size

    monkeypatch.setattr(constants, "IN_MEMORY", 1000)
    monkeypatch.setattr(LongRecording, "glimpse", partialmethod(LongRecording.glimpse, parts=10, rows=600))
    with (
        open_sources([make_recording(samples=6000, change=tare)]) as sources,
        open_dataset(sources, lambda signals, _: Choice(parse_model("linear").anchored(signals.motion))) as data,
    ):
        errors = [one.message for one in data.diagnostics if one.is_error]
    assert ["a zero changes" in one for one in errors] == [True] * bool(size)


def test_each_recording_is_verified_once_an_identification(
    recordings: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, verified = Counter[Path](), Counter[Path]()

    class Counted(Recording):
        def __init__(self, path: Path) -> None:
            opened[path] += 1
            super().__init__(path)

        def verify(self, progress: Progress | None = None) -> bool:
            verified[self.path] += 1
            return super().verify(progress)

    monkeypatch.setattr(source, "Recording", Counted)
    identified(recordings, "linear")
    assert opened == verified == Counter(dict.fromkeys(recordings, 1))
