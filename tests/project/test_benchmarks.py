"""The scripts of benchmarks/ run to their end and write what they say; of their times, only ratios are asserted."""

from __future__ import annotations

import csv
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
pytestmark = pytest.mark.study
RATIO = re.compile(r"at 2,500 samples `hil, default` .+?(the fastest [^,]+), .+?\*\*([\d.]+) times (faster|slower)")
BENCH = ("cma", "cmaes", "deap", "pygad", "pymoo")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which peers.py has run with its shorter recording."""
    missing = [name for name in BENCH if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f"PEERS NOT TESTED: {', '.join(missing)} not installed, pip install '.[bench]'")
    folder = tmp_path_factory.mktemp("peers")
    # a copy writes beside itself, not over the results of the repository
    shutil.copytree(ROOT / "benchmarks", folder / "benchmarks", ignore=shutil.ignore_patterns("__pycache__", "results"))
    subprocess.run(
        [sys.executable, "benchmarks/peers.py", "--samples", "2500", "--seeds", "3", "--cap", "0.1"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=True,
    )
    return folder


def test_the_comparison_with_others_names_every_method_in_its_table(written: Path) -> None:
    text = (written / "benchmarks" / "results" / "peers.csv").read_text(encoding="utf-8")
    methods = (
        "pymoo GA",
        "pygad",
        "DEAP GA",
        "DEAP CMA-ES",
        "scipy DE",
        "pycma",
        "cmaes",
        '"hil, default"',
        '"hil, paper"',
    )
    assert text.startswith("# Time to the optimum")
    assert [name for name in methods if f"\n{name}," not in text] == []


def test_no_ratio_to_other_optimisers_has_fallen_by_a_third_since_it_was_published(written: Path) -> None:
    published, now = (
        {which: float(times) if word == "faster" else 1.0 / float(times) for which, times, word in RATIO.findall(text)}
        for text in ((root / "benchmarks/results/peers.csv").read_text(encoding="utf-8") for root in (ROOT, written))
    )
    assert len(published) == 2
    assert {which: ratio for which, ratio in published.items() if not now.get(which, 0.0) > ratio / 1.5} == {}


def test_the_comparison_with_others_draws_its_picture(written: Path) -> None:
    assert (written / "docs" / "pictures" / "peers.png").read_bytes().startswith(b"\x89PNG")


def test_the_design_benchmark_compares_every_case_with_its_prediction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With two of its six cases: a torque that is prescribed, and a deflection."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    design = importlib.import_module("design")
    monkeypatch.setattr("page.RESULTS", tmp_path)
    monkeypatch.setattr(design, "CASES", (design.CASES[0], design.CASES[4]))
    monkeypatch.setattr("sys.argv", ["design.py", "--seeds", "2"])
    design.main()
    table = (tmp_path / "design.csv").read_text(encoding="utf-8")
    rows = list(csv.reader(line for line in table.splitlines() if "%" in line and not line.startswith("#")))
    assert [row[2] for row in rows] == ["Kc", "Bc"] * 2
    assert all(0.0 < float(row[5]) < 10.0 for row in rows)  # the ratio of found to predicted error, of two recordings


def test_a_changed_byte_of_a_recording_is_noticed_or_has_no_effect() -> None:
    """A short form of what benchmarks/mutants.py does ten thousand times."""
    command = [sys.executable, "benchmarks/mutants.py", "--times", "15", "--rows", "40"]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "no breach" in done.stdout
    for outcome in ("refused", "reported as changed", "rows reported as lost", "without effect"):
        assert outcome in done.stdout


@pytest.mark.parametrize(
    ("adapter", "signal", "more"),
    [
        ("dynamixel X, no watchdog", "KILL", []),
        ("odrive, no watchdog", "STOP", []),
        ("dynamixel X, no watchdog", "KILL", ["--start", "process-1"]),
        ("dynamixel X, no watchdog", "KILL", ["--start", "stdin,stdout,stderr", "--python"]),
    ],
)
def test_killing_the_recorder_leaves_no_torque_on_a_drive_without_a_watchdog(
    adapter: str, signal: str, more: list[str]
) -> None:
    # runs in real time, since a process can only be killed there
    words = ["--times", "1", "--patient", "--adapter", adapter, "--signal", signal, *more]
    done = subprocess.run(
        [sys.executable, "benchmarks/killing.py", *words],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines() if "| 1 |" in line]
    drive = f"{adapter}; {more[1]}" if more else adapter
    assert [row[:2] for row in rows] == [[drive, signal]], done.stderr
    assert [(row[2], row[4] != "stays on", row[7]) for row in rows] == [("1", True, "0")]


def test_a_loss_of_power_costs_no_row_that_was_synced_and_alters_none() -> None:
    """A short form of what benchmarks/power_loss.py does at every call to the system."""
    words = ["--seconds", "0.4", "--rate", "100", "--cuts", "4", "--orders", "1"]
    done = subprocess.run(
        [sys.executable, "benchmarks/power_loss.py", *words],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 2:
        pytest.skip("strace is not here, or not permitted")
    assert (done.returncode, done.stderr) == (0, "")
    assert "41 rows, 4 cuts, 12 states of the disk" in done.stdout


def test_a_killed_recorder_loses_no_row() -> None:
    done = subprocess.run(
        [sys.executable, "benchmarks/row_loss.py", "--times", "1", "--rates", "100"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines() if line.startswith("| 100 |")]
    assert [row[1:3] for row in rows] == [["recorder", "1"], ["recorder and writing process", "1"]], done.stderr
    assert int(rows[0][5]) <= 1  # the row that was under way
