"""The truth study of benchmarks/truth.py: its sources of recordings, its bound, and how it goes on."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from hil.recording.reader import Recording

pytestmark = pytest.mark.study
BENCHMARKS = Path(__file__).parent.parent.parent / "benchmarks"
KC, BC, NOISE = 17.75e-3, 0.19e-3, 0.2e-3
PRESCRIBED = ["clean", "encoder", "skew", "coulomb", "backlash", "cubic", "drops", "outliers", "all at once"]


class Study(NamedTuple):
    """The scripts of the study, as modules."""

    cases: ModuleType
    recordings: ModuleType
    page: ModuleType
    truth: ModuleType
    truth_benches: ModuleType


@pytest.fixture(scope="module")
def study() -> Iterator[Study]:
    sys.path.insert(0, str(BENCHMARKS))
    names = ("truth_cases", "truth_recordings", "truth_page", "truth", "truth_benches")
    yield Study(*(importlib.import_module(name) for name in names))
    sys.path.remove(str(BENCHMARKS))


def test_rate_and_acceleration_are_the_derivatives_of_the_deflection(study: Study) -> None:
    time, step = np.linspace(0.1, 19.9, 997), 1e-4
    here, before, after = (study.cases.chirp(time + shift, (0.1, 15.0)) for shift in (0.0, -step, step))
    rate = (after.deflection - before.deflection) / (2.0 * step)
    acceleration = (after.rate - before.rate) / (2.0 * step)
    assert np.abs(here.rate - rate).max() < 1e-4 * np.abs(rate).max()
    assert np.abs(here.acceleration - acceleration).max() < 1e-4 * np.abs(acceleration).max()
    assert np.abs(here.deflection).max() == pytest.approx(0.35, rel=1e-3)


@pytest.mark.parametrize("name", PRESCRIBED)
def test_what_is_written_differs_from_the_closed_form_by_the_noise_that_the_case_names(study: Study, name: str) -> None:
    case = study.cases.case_named(name)
    channels = study.recordings.closed_form_channels(case, np.random.default_rng(7))
    late = 0.5e-3 if case.jitter else 0.0  # what the jitter of the instants can be
    plain = np.abs(channels["torque"] - case.torque(channels["time"]))
    usual = plain[np.isfinite(plain) & (plain < 10e-3)]
    if late:
        slope = np.abs(np.gradient(case.torque(channels["time"]), channels["time"]))
        assert np.nanmax(plain - slope * late - 2e-3 * (case.truth.Fc > 0.0)) < 6.0 * NOISE
    else:
        assert np.sqrt(np.mean(usual**2)) == pytest.approx(NOISE, rel=0.05)
    assert 1.0 - len(usual) / len(plain) == pytest.approx(case.lost + case.outliers, abs=0.01)


def test_the_motors_torque_gives_the_couplings_back_through_equation_1(study: Study) -> None:
    case = study.cases.case_named("motor side")
    channels = study.recordings.closed_form_channels(case, np.random.default_rng(3))
    time = channels["time"]
    motion = study.cases.chirp(time, (0.1, 15.0))
    inferred = 4.0 * (channels["motor_torque"] - 2e-7 * 4.0 * motion.acceleration - 1e-7 * 4.0 * motion.rate)
    off = inferred - KC * motion.deflection - BC * motion.rate
    assert np.sqrt(np.mean(off**2)) == pytest.approx(NOISE, rel=0.05)


def test_a_flank_never_pulls(study: Study) -> None:
    case = study.cases.case_named("backlash")
    time = np.arange(10_000) / 500.0
    torque, motion = case.torque(time), case.motion(time)
    assert (torque * motion.deflection >= 0.0).all()
    assert (torque[np.abs(motion.deflection) < 0.01] == 0.0).all()
    assert np.count_nonzero(torque == 0.0) > np.count_nonzero(np.abs(motion.deflection) < 0.01) + 500


def test_the_bound_of_the_clean_case_is_the_textbooks(study: Study) -> None:
    motion = study.cases.chirp(np.arange(10_000) / 500.0, (0.1, 15.0))
    columns = np.stack([motion.deflection, motion.rate], axis=1)
    errors = NOISE * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    found = study.cases.bound(study.cases.case_named("clean"))
    assert [found["Kc"], found["Bc"]] == pytest.approx(errors.tolist(), rel=1e-6)


def test_no_estimator_can_identify_the_damping_of_the_unidentifiable_cases(study: Study) -> None:
    bounds = [study.cases.bound(study.cases.case_named(name))["Bc"] for name in ("too slow", "standing still")]
    assert min(bounds) > 0.5 * BC


def test_the_clean_simulator_is_clean_and_reaches_the_amplitude_at_15_hz(study: Study, tmp_path: Path) -> None:
    study.recordings.simulated(study.cases.case_named("clean"), 0, tmp_path / "one.h5")
    with Recording(tmp_path / "one.h5") as recording:
        time, angle, torque = (recording.channel(name) for name in ("read_time", "dtheta", "torque"))
    columns = np.stack([angle, make_interp_spline(time, angle, k=5)(time, 1)], axis=1)[50:-50]
    found = np.linalg.lstsq(columns, torque[50:-50], rcond=None)[0]
    left = torque[50:-50] - columns @ np.array([KC, BC])
    assert np.abs(angle[-140:-60]).max() == pytest.approx(0.35, rel=0.02)
    assert float(np.std(left)) == pytest.approx(NOISE, rel=0.03)
    assert abs(found[0] / KC - 1.0) < 5.0 * 0.0005
    assert abs(found[1] / BC - 1.0) < 5.0 * 0.0015


def test_mujocos_joint_has_the_spring_damper_and_friction_of_the_case(study: Study, tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MUJOCO AS A SOURCE NOT TESTED: mujoco is not installed")
    study.recordings.mujoco(study.cases.case_named("coulomb"), 0, tmp_path / "one.h5")
    with Recording(tmp_path / "one.h5") as recording:
        time, angle, torque = (recording.channel(name) for name in ("read_time", "dtheta", "torque"))
    rate = make_interp_spline(time, angle, k=5)(time, 1)
    columns = np.stack([angle, rate, np.sign(rate)], axis=1)[20:-20]
    torque = torque[20:-20]
    found = np.linalg.lstsq(columns, torque, rcond=None)[0]
    assert found == pytest.approx([KC, BC, 1e-3], rel=0.01)
    assert float(np.std(torque - columns @ found)) == pytest.approx(NOISE, rel=0.1)


def test_a_case_that_mujoco_has_no_parameter_for_is_not_asked_of_it(study: Study) -> None:
    cases = study.cases.CASES
    assert [case.name for case in cases if study.recordings.can_make("MuJoCo", case)] == [
        "clean",
        "encoder",
        "skew",
        "coulomb",
        "cubic",
        "drops",
        "outliers",
        "all at once",
    ]
    with pytest.raises(ValueError, match="no parameter for the case 'backlash'"):
        study.recordings.mujoco(study.cases.case_named("backlash"), 0, Path("none.h5"))


def test_more_confidently_wrong_results_than_chance_explains_are_a_breach(study: Study) -> None:
    def row(seed: int, error: float, status: int = 0, *codes: str) -> dict[str, object]:
        ci95 = [KC * (1.0 + error - 1e-3), KC * (1.0 + error + 1e-3)]
        one = {"value": KC * (1.0 + error), "ci95": ci95}
        where = {"case": "clean", "source": "MuJoCo", "seed": seed}
        return {**where, "status": status, "codes": list(codes), "Kc": one, "Bc": {"value": None}}

    rows = [row(seed, 1.4e-3) for seed in range(20)]
    assert study.truth.breaches([*rows, row(20, 1.6e-3)]) == []
    assert study.truth.breaches([*rows, *(row(seed, 1.6e-3, 1) for seed in (20, 21, 22, 23))]) == []
    assert study.truth.breaches([*rows, *(row(seed, 1.6e-3, 0, "misfit") for seed in (20, 21, 22, 23))]) == []
    assert study.truth.breaches([*rows, *(row(seed, 1.6e-3) for seed in (20, 21, 22, 23))]) == [
        "clean, MuJoCo: 4 of 24 are confidently wrong: seeds [20, 21, 22, 23]"
    ]


def test_a_seed_makes_the_same_recording_again_and_another_does_not(study: Study) -> None:
    case = study.cases.case_named("all at once")
    first, again, other = (
        study.recordings.closed_form_channels(case, study.recordings.rng_of(case, seed))["torque"] for seed in (5, 5, 6)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_recording_of_nothing_is_found_untrustworthy(study: Study, tmp_path: Path) -> None:
    study.recordings.closed_form(study.cases.case_named("standing still"), 0, tmp_path / "one.h5")
    assert study.truth.estimate(tmp_path / "one.h5", "linear")["status"] == 1


def test_a_study_goes_on_behind_a_line_that_was_cut_short(study: Study, tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    results.write_text(
        '{"seed": 0, "source": "closed form", "case": "clean", "asked": "linear"}\n{"seed": 1, "source": "clo'
    )
    wanted = [study.truth.Job(seed, "closed form", "clean", "linear") for seed in (0, 1)]
    assert study.truth.missing(study.truth.rows_of(results), wanted) == wanted[1:]


def test_the_page_of_the_benches_counts_what_is_wrong_and_what_is_flagged(study: Study) -> None:
    def row(seed: int, error: float, status: int = 0, code: str = "") -> dict[str, object]:
        wrong = abs(error) > 1.5 * 0.02 and not status and not code
        errors = {"Kc": (error, 0.02), "Bc": (0.0, 0.1)}
        said = {"status": status, "model": "linear", "flagged": code == "misfit", "wrong": wrong}
        return {"seed": seed, "bench": "linear", "effects": "linear", "errors": errors, **said}

    name = study.truth_benches.NAMES[0]
    rows = [
        row(0, 0.0),
        row(1, 0.025),
        row(2, 0.04),
        row(3, 0.04, 1),
        row(4, 0.04, 0, "misfit"),
        row(5, 0.04, 0, "misfit"),
    ]
    text = study.truth_benches.page([one | {"bench": name, "effects": name} for one in rows])
    assert "6 recordings, 1 of them confidently wrong; 6 of a bench that a model describes, 2 of these with" in text
    assert "held Kc in 1 of 5 and Bc in 5 of 5" in text
    assert f"| {name} | 6 | linear (6) | +4.00% ± 2.00% | +0.00% ± 10.00% | 5 | 2 | 1 |" in text
    assert "2 of 6 recordings that a model describes are flagged as misfit" in text


def test_the_page_judges_bias_and_coverage(study: Study) -> None:
    case = study.cases.case_named("encoder")

    def row(error: float) -> dict[str, object]:
        half = {"Kc": 1e-3 * KC, "Bc": 3e-3 * BC}
        found: dict[str, object] = {
            name: {"value": true * (1.0 + error), "ci95": [true * (1.0 + error) - half[name], true + half[name]]}
            for name, true in (("Kc", KC), ("Bc", BC))
        }
        return {"status": 0, "plain": {"Kc": 1.1 * KC, "Bc": BC}, **found}

    good = [row(0.0)] * 95 + [row(0.0045)] * 5
    found = study.page.figures("Kc", case, good)
    assert (found.mean, found.worst, found.coverage) == pytest.approx((0.0225, 0.45, 95.0))
    assert found.plain_mean == pytest.approx(10.0)
    assert (found.low, found.high) == pytest.approx((88.8, 97.8), abs=0.1)
    assert study.page.misses(case, "Kc", found) == []
    late = study.page.figures("Kc", case, [row(0.003)] * 100)
    assert study.page.misses(case, "Kc", late) == ["Kc mean", "Kc coverage"]


def test_one_command_goes_on_with_the_study_and_writes_its_results(study: Study, tmp_path: Path) -> None:
    # a copy writes beside itself, not over the results of the repository
    shutil.copytree(BENCHMARKS, tmp_path / "benchmarks", ignore=shutil.ignore_patterns("__pycache__", "results"))
    results = tmp_path / "results.jsonl"
    results.write_text(json.dumps(study.truth.judge(study.truth.Job(0, "closed form", "clean", "linear"))))
    where = [str(BENCHMARKS.parent), os.environ.get("PYTHONPATH", "")]
    words = ["--model", "linear", "--seeds", "2", "--source", "closed form", "--case", "clean", "--workers", "1"]
    done = subprocess.run(
        [sys.executable, "benchmarks/truth.py", *words, "--results", str(results)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(where)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "2 recordings of 500 Hz, 1 done before" in done.stdout
    assert sorted(row["seed"] for row in study.truth.rows_of(results)) == [0, 1]
    written = tmp_path / "benchmarks" / "results"
    assert (written / "truth-linear.csv").read_text().count("\nclean,closed form,2,") == 1
    assert (written / "truth-linear.png").read_bytes().startswith(b"\x89PNG")


def test_the_default_stand_is_a_bench_that_is_held_against_its_own_truth(study: Study) -> None:
    row = study.truth_benches.judge(study.truth_benches.Job(9001, "default stand"))
    assert row["status"] == 0
    assert not row["wrong"]
    assert 0.0 < abs(row["errors"]["Kc"][0]) < 0.01
    assert 0.0 < abs(row["errors"]["Bc"][0]) < 0.03
