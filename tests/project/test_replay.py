"""The archive of recordings with known Kc and Bc, and the gate between two revisions that identified it."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).parent.parent.parent / "benchmarks"
GOOD = {
    "file": "a.h5",
    "kind": "plain",
    "half": "seen",
    "knowable": "Kc Bc",
    "status": "0",
    "model": "linear",
    "Kc_true": "0.3",
    "Kc": "0.3",
    "Kc_half": "0.01",
    "Kc_trusted": "1",
    "codes": "",
    "seconds": "4",
    "slow": "1",
    "Bc_true": "3e-3",
    "Bc": "3e-3",
    "Bc_half": "1e-4",
    "Bc_trusted": "1",
}


@pytest.fixture
def replay() -> Iterator[ModuleType]:
    sys.path.insert(0, str(BENCHMARKS))
    yield importlib.import_module("replay")
    sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize(
    ("changed", "broken"),
    [
        ({"Kc": "0.32"}, ["confidently wrong: 1, old 0", "right, with", "intervals that hold Kc"]),
        ({"Kc": "0.32", "codes": "misfit"}, ["right, with", "misfit or refusal", "intervals that hold Kc"]),
        (
            {"Bc_trusted": "0", "codes": "not-identifiable"},
            ["right, with", "misfit or refusal", "intervals that hold Bc"],
        ),
        ({"Bc_half": "1.4e-4"}, ["half width of Bc over the old, median: 1.40"]),
        ({"seconds": "9"}, ["processor time: 9 s, old 4 s"]),
        ({"seconds": "9", "slow": "9"}, []),
    ],
)
def test_the_gate_names_what_got_worse(
    replay: ModuleType, monkeypatch: pytest.MonkeyPatch, changed: dict[str, str], broken: list[str]
) -> None:
    monkeypatch.setattr(replay, "HOLDS", (0.93, 1.0))
    new = GOOD | ({"seconds": "1"} | changed)
    failed = [sentence for met, sentence in replay.gate([GOOD], [new]) if not met]
    assert [sentence[: len(start)] for sentence, start in zip(failed, broken, strict=True)] == broken


@pytest.mark.study
def test_a_replay_identifies_what_is_in_the_archive(replay: ModuleType, tmp_path: Path) -> None:
    archive = importlib.import_module("archive")
    kinds = ("100 Hz, chirp", "physical, hand, torque cell")
    entries = [entry for entry in (*archive.of_benches(), *archive.of_physics()) if entry.kind in kinds]
    archive.make_archive(tmp_path, entries[:4])
    wanted = replay.fair(replay.rows_of(tmp_path / "index.csv"))
    replay.run(tmp_path, tmp_path / "rows.csv", wanted[:2], 1)
    replay.run(tmp_path, tmp_path / "rows.csv", wanted, 1)  # goes on
    rows = replay.rows_of(tmp_path / "rows.csv")
    assert sorted(row["file"] for row in rows) == sorted(path.name for path in tmp_path.glob("*.h5"))
    assert {row["kind"] for row in rows} == set(kinds)
    assert "wrong" not in [replay.outcome(row) for row in rows]
    assert not replay.compared(rows, rows)  # the time is not halved
