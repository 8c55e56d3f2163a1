"""The commands as a person runs them: what they print, where, and the status they end with."""

from __future__ import annotations

import gzip
import os
import re
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hil.cli.app import run
from hil.cli.record import record as record_command
from hil.recording.channels import Row
from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, RecordingWriter

from ..conftest import Ended, Hil, Maker, copied, edited, exit_status

SHORT = ("--duration", "1", "--fade", "0.2")


def record(hil: Hil, *words: object) -> Ended:
    return hil("record", "--backend", "sim", "--profile", "chirp", *words)


# --- the main job ----------------------------------------------------------------------------------------------------


def test_recordings_are_numbered_and_nothing_is_printed_on_standard_error(hil: Hil, tmp_path: Path) -> None:
    first, second = record(hil, *SHORT), record(hil, *SHORT)
    assert (first.status, second.status) == (0, 0)
    assert first.out.startswith("recordings/run1.h5: 501 samples")
    assert second.out.startswith("recordings/run2.h5: 501 samples")
    assert first.err == second.err == ""
    assert sorted(path.name for path in (tmp_path / "recordings").iterdir()) == ["run1.h5", "run2.h5"]


def test_the_main_job_finds_the_stiffness_the_simulator_was_given_without_looking_at_it(hil: Hil) -> None:
    """Within 1 % of Kc, against the truth in the file, with honest sensors in between."""
    record(hil, "--duration", 3, "--seed", 1, "-o", "a.h5")
    with Recording(Path("a.h5")) as recording:
        truth = recording.truth()
    with edited(Path("a.h5")) as file:
        del file["truth"]
    ended = hil("identify", "a.h5", "--trials", 1, "--json")
    assert ended.status == 0
    found = ended.json
    assert found["parameters"]["Kc"]["value"] == pytest.approx(truth["Kc"], rel=0.01)
    assert found["parameters"]["Bc"]["value"] == pytest.approx(truth["Bc"], rel=0.05)
    assert found["fitness"]["optimiser_gap"] < 1e-6


def test_the_json_of_identify_is_the_designs(hil: Hil, make_recording: Maker) -> None:
    found = hil("identify", make_recording(noise=1e-5, samples=600), "--json").json
    keys = "schema recordings model preset seed torque_scale windows parameters fitness samples trials evaluations"
    tests = (
        "seconds validation warnings errors model_selection lack_of_fit dynamic_stiffness deflection fixture controller"
    )
    assert list(found) == [*keys.split(), *tests.split()]
    assert (found["schema"], found["model"], found["preset"]) == ("hil-identification/2", "linear", "default")
    kc = found["parameters"]["Kc"]
    assert {"value", "unit", "ci95", "conditional", "choice_share", "identifiable", "trusted"} <= set(kc)
    assert set(kc["conditional"]) == {"value", "ci95"}
    assert set(kc["optimiser_repeatability"]) == {"best", "trials_mean", "trials_std"}
    assert (kc["unit"], found["parameters"]["Bc"]["unit"], found["fitness"]["unit"]) == ("N*m/rad", "N*m*s/rad", "N*m")
    assert set(found["fitness"]) == {"value", "best_trial", "optimiser_gap", "unit"}
    assert set(found["validation"]) == {"fitness", "nrmse"}
    assert found["trials"] == 30
    assert 500 < found["samples"] < 600  # without those beside the ends, where there is no rate
    assert found["evaluations"] > 30
    assert found["seconds"] > 0


def test_every_reported_number_is_what_its_name_says(hil: Hil, make_recording: Maker) -> None:
    """Recomputed here with NumPy from the signals alone."""
    from hil.signals.prepare import prepare

    path = make_recording(noise=2e-4)
    found = hil("identify", path, "--model", "linear", "--json", "--trials", 7).json
    with Recording(path) as recording:
        signals = prepare(recording, None)
    exact = [found["parameters"][name]["conditional"]["value"] for name in ("Kc", "Bc")]
    best = [found["parameters"][name]["optimiser_repeatability"]["best"] for name in ("Kc", "Bc")]
    columns = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])

    def mean_error(genes: list[float]) -> float:
        return float(np.mean(np.abs(signals.torque - columns @ genes)))

    fitness = found["fitness"]
    assert fitness["best_trial"] == pytest.approx(mean_error(best), rel=1e-12)
    assert fitness["value"] == pytest.approx(mean_error(exact), rel=1e-12)
    assert fitness["optimiser_gap"] == pytest.approx(fitness["best_trial"] / fitness["value"] - 1.0, abs=1e-12)
    assert fitness["value"] <= fitness["best_trial"]
    low, high = found["parameters"]["Kc"]["ci95"]
    assert low < 0.02 < high
    # held out: every fifth of ten blocks, against a fit to the rest; Gaussian noise of 0.2 mN m
    assert found["validation"]["fitness"] == pytest.approx(2e-4 * np.sqrt(2 / np.pi), rel=0.1)
    assert found["validation"]["nrmse"] == pytest.approx(2e-4 / float(np.std(signals.torque)), rel=0.2)


def test_the_exit_status_is_by_the_parameters_that_are_required(hil: Hil, make_recording: Maker) -> None:
    """One speed there and back: dry friction and damping are the same, and the stiffness is not touched by it."""

    def triangle(channels: dict[str, Array]) -> None:
        rate = 0.8 * np.sign(np.cos(2.0 * np.pi * channels["time"]))
        channels["dtheta"] = 0.4 / np.pi * np.arcsin(np.sin(2.0 * np.pi * channels["time"]))
        noise = 1e-4 * np.random.default_rng(1).standard_normal(len(rate))
        channels["torque"] = 0.02 * channels["dtheta"] + 2e-4 * rate + noise

    words = ("identify", make_recording(change=triangle, samples=600), "--model", "linear", "--trials", 1)
    assert hil(*words, "--require", "K").status == 2
    ended = hil(*words, "--require", "Kc", "--json")
    assert ended.status == 0
    assert {name: one["trusted"] for name, one in ended.json["parameters"].items()} == {"Kc": True, "Bc": False}
    ended = hil(*words)
    assert ended.status == 1
    stiffness, damping = ended.out.splitlines()[0].split(",  ")
    assert "±" in stiffness
    assert "trusted" not in stiffness
    assert damping.endswith("(not identifiable)")


@pytest.mark.study
def test_the_papers_preset_arrives_at_the_exact_optimum(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(noise=2e-4, kc=0.01775, bc=1.9e-4, samples=500)
    words = ("--model", "linear", "--preset", "paper", "--generations", 10_000, "--trials", 2, "--json")
    found = hil("identify", path, *words).json
    kc = found["parameters"]["Kc"]
    assert found["evaluations"] == 2 * (10 + 10_000)
    assert kc["optimiser_repeatability"]["trials_mean"] == pytest.approx(kc["value"], rel=0.01)
    assert kc["bounds"] == [0.5e-3, 0.2]
    assert found["fitness"]["optimiser_gap"] >= 0.0


UNITS = ("--time-unit", "s", "--torque-unit", "N*m", "--dtheta-unit", "rev")
LOCKED = ("--time", "TIME", "--torque", "TORQUE", "--dtheta", "POSITION", *UNITS)


def thinned(source: Path) -> Path:
    """Write every third row of a table: what a recording shows hardly changes, and its identification takes half."""
    with gzip.open(source, "rt", encoding="utf-8") as table, gzip.open("thin.csv.gz", "wt", encoding="utf-8") as thin:
        heading, *rows = table
        thin.writelines([heading, *rows[::3]])
    return Path("thin.csv.gz")


@pytest.mark.study
def test_a_real_locked_output_is_imported_and_identified(hil: Hil, locked_output: Path) -> None:
    source = thinned(locked_output / "split_onyx_12pre1.csv.gz")
    assert hil("import", source, *LOCKED, "--where", "test_nr==100", "-o", "a.h5").status == 0
    refused = hil("identify", "a.h5", "--trials", "1")
    assert (refused.status, "hil hysteresis" in refused.err) == (1, True)
    found = hil("identify", "a.h5", "--model", "linear+offset+backlash+dahl", "--trials", "1", "--json").json
    stiffness = found["parameters"]["Kc"]
    assert 190.0 < stiffness["conditional"]["value"] < 225.0
    assert stiffness["ci95"][0] < stiffness["conditional"]["value"] < stiffness["ci95"][1]
    assert found["parameters"]["Fd"]["value"] > 0.0
    assert "coarse-clock" in {warning["code"] for warning in found["warnings"]}
    assert not found["parameters"]["Bc"]["identifiable"]
    assert any(
        warning["parameter"] == "Bc" and "cannot be distinguished from friction" in warning["message"]
        for warning in found["errors"]
    )


@pytest.mark.study
def test_a_real_drive_that_hardly_leaves_its_play_has_a_gap_and_no_stiffness(hil: Hil, locked_output: Path) -> None:
    """Its encoder moves by 0.03 rad while hardly any torque is there (SOURCE.md)."""
    source = locked_output / "base_onyx_runin1.csv.gz"
    assert hil("import", thinned(source), *LOCKED, "--where", "test_nr==2", "-o", "thin.h5").status == 0
    selected = hil("identify", "thin.h5", "--trials", "1", "--json")
    assert selected.status == 1
    assert not selected.json["parameters"]["Kc"]["trusted"]
    named = hil("identify", "thin.h5", "--model", "linear+offset+coulomb+backlash", "--trials", "1", "--json").json
    assert 0.02 < named["parameters"]["gap"]["value"] < 0.04
    assert named["parameters"]["gap"]["identifiable"]
    assert not named["parameters"]["Kc"]["identifiable"]


MOTOR_SIDE = """\
[stand]
name = "no torque cell"
backend = "sim"
gear_ratio = 4.0
motor_inertia = 2.0e-7
motor_damping = 1.0e-7
torque_source = "motor"
[limits]
torque = 0.03
deflection = 1.0
velocity = 100.0
temperature = 80.0
"""


@pytest.mark.parametrize(
    ("quantity", "amplitude", "warned"),
    [("torque", 0.006, False), pytest.param("position", 0.3, True, marks=pytest.mark.study)],
)
def test_motor_torque_under_a_position_loop_is_warned_of_and_not_trusted(
    hil: Hil, tmp_path: Path, quantity: str, amplitude: float, *, warned: bool
) -> None:
    (tmp_path / "stand.toml").write_text(MOTOR_SIDE)
    words = ("--mode", quantity, "--amplitude", amplitude, "--duration", "2", "-o", "a.h5", "--json")
    recorded = hil("record", "--stand", "stand.toml", *words)
    assert recorded.status == 0
    assert [warning["code"] for warning in recorded.json["warnings"]] == ["motor-side"] * warned
    assert ("warning [motor-side]" in recorded.err) == warned
    found = hil("identify", "a.h5", "--model", "linear+offset", "--trials", "1", "--json")
    said = [error for error in found.json["errors"] if error["code"] == "motor-side"]
    assert found.status == (1 if warned else 0)
    assert [warning["parameter"] for warning in said] == ["Bc"] * warned
    assert all("--mode torque" in warning["message"] for warning in said)
    off = found.json["parameters"]["Bc"]["value"] / 1.9e-4 - 1.0
    assert (abs(off) > 0.5) == warned  # why it is said


def test_the_demo_runs_the_main_job_and_says_where_the_files_are(
    hil: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a quarter of its time; the README's commands are run as they stand as a study."""
    monkeypatch.setattr("hil.cli.demo.record", partial(record_command, duration=5.0))
    ended = hil("demo")
    assert ended.status == 0
    for name in ("run1.h5", "run1.html"):
        assert (tmp_path / "hil-demo" / name).exists()
        assert f"hil-demo/{name}" in ended.out + ended.err
    assert re.search(r"^true Kc of the simulated joint: 17\.75 mN m/rad; the interval, .*, holds it$", ended.out, re.M)
    assert re.search(r"^true Bc of the simulated joint: 0\.19 mN m s/rad; the interval, .*, holds it$", ended.out, re.M)


@pytest.mark.study
def test_the_demo_of_a_hand_compares_each_joint_with_its_truth_and_resumes(hil: Hil, tmp_path: Path) -> None:
    first = hil("demo", "--hand")
    assert first.status == 0
    assert re.findall(r"^true (\w+ of \w+): .*, holds it$", first.out, re.M) == [
        f"{name} of {joint}" for joint in ("index_mcp", "index_pip", "thumb_mcp") for name in ("Kc", "Bc")
    ]
    kept = sorted((tmp_path / "hil-demo/hand").glob("*.h5"))
    assert len(kept) == 3
    before = [path.stat().st_mtime_ns for path in kept]
    assert hil("demo", "--hand").status == 0
    assert [path.stat().st_mtime_ns for path in kept] == before


def test_a_result_that_leaves_the_expected_band_ends_in_status_one_with_the_reason(
    hil: Hil, make_recording: Maker
) -> None:
    words = ("identify", make_recording(noise=1e-4, samples=600), "--model", "linear", "--trials", 1)
    assert hil(*words, "--expect", "Kc=20mN*m/rad:2%", "--expect", "Bc=0.0002:20%").status == 0
    for band, reason in (
        ("Kc=21mN*m/rad:2%", "not within 20.58 mN m/rad to"),
        ("Kc=0.02:0.3%", "the 95 % interval of Kc"),
    ):
        ended = hil(*words, "--expect", band)
        assert (ended.status, f"--expect {band}" in ended.err, reason in ended.err) == (1, True, True), ended.err
    for band in ("Kc", "Kc=20", "Fc=1:2%", "Kc=20kg:2%", "Kc=nan:2%", "Kc=20:-2%", "Kc=20:2"):
        assert hil(*words, "--expect", band).status == 2


def test_identify_answers_first_and_shows_its_tables_only_when_asked(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(noise=1e-4, samples=500)
    brief, verbose = (hil("identify", path, "--trials", 1, *words).out for words in ((), ("--verbose",)))
    assert brief.splitlines()[0].startswith("Kc = ")
    assert len(brief.splitlines()) == 4
    assert verbose.splitlines()[0] == brief.splitlines()[0]
    for table in ("95 % interval", "model selection", "optimiser repeatability"):
        assert table not in brief
        assert table in verbose


def test_inspect_says_what_a_recording_holds(hil: Hil) -> None:
    record(hil, "--duration", 3, "--fade", 0.2, "-o", "a.h5")
    seen = hil("inspect", "a.h5", "--json").json
    assert seen["usable"]
    assert seen["samples"] == 1501
    assert seen["rate"] == pytest.approx(500.0, rel=1e-3)
    assert seen["duration"] == pytest.approx(3.0, abs=0.02)
    assert seen["torque_noise"] == pytest.approx(2e-4, rel=0.15)  # the cell's noise, as the simulator's default
    assert seen["end_reason"] == "done"
    with Recording(Path("a.h5")) as recording:
        assert seen["lost"] == np.count_nonzero(recording.channel("status") == 1)
        assert seen["deflection"] == pytest.approx(
            np.nanmax(recording.channel("dtheta")) - np.nanmin(recording.channel("dtheta"))
        )
    assert "usable" in hil("inspect", "a.h5").out


def test_an_unfinished_recording_in_a_folder_that_is_read_only_is_recovered_elsewhere(
    hil: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = tmp_path / "there"
    there.mkdir()
    part = unfinished(there / "a.h5")
    before = part.read_bytes()
    monkeypatch.setattr(os, "access", lambda folder, _: folder != there)
    ended = hil("recover", part)
    assert (ended.status, "still there, in a folder that cannot be written" in " ".join(ended.out.split())) == (0, True)
    assert (tmp_path / "a.h5").exists()
    assert part.read_bytes() == before


# --- bad input -------------------------------------------------------------------------------------------------------


def unfinished(path: Path) -> Path:
    with RecordingWriter(path, Header(profile={"kind": "chirp"}), 1000) as part:
        for seq in range(800):
            time = seq / 500.0
            part.append(Row(seq, time, 0.0, torque=0.02 * np.sin(9 * time), dtheta=np.sin(9 * time)))
    return part.path


def no_trace(ended: Ended) -> bool:
    return "Traceback" not in ended.err and len(ended.err.strip().splitlines()) <= 3


def test_an_unfinished_recording_is_identified_and_said_to_be_one(hil: Hil, tmp_path: Path) -> None:
    path = unfinished(tmp_path / "a.h5")
    ended = hil("identify", path, "--model", "linear", "--trials", 1, "--json")
    assert 600 < ended.json["samples"] < 800  # the ends are left out
    assert ended.json["parameters"]["Kc"]["value"] == pytest.approx(0.02, rel=1e-3)
    assert "unfinished" in {warning["code"] for warning in ended.json["warnings"]}
    assert "it never ended" in ended.err


@pytest.mark.parametrize("samples", [0, 1])
def test_an_empty_or_one_sample_file_is_not_to_be_trusted(hil: Hil, make_recording: Maker, samples: int) -> None:
    ended = hil("identify", make_recording(samples=samples))
    assert ended.status == 1
    assert "usable sample" in ended.err
    assert no_trace(ended)


def test_a_constant_deflection_is_refused(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(change=lambda channels: channels.update(dtheta=np.full(2000, 0.1)))
    for command in ("identify", "inspect"):
        ended = hil(command, path)
        assert ended.status == 1
        assert "the deflection never changes: no Kc or Bc can be estimated; record a motion of the joint" in ended.err
        assert no_trace(ended)


@pytest.mark.parametrize("words", [(), ("--preset", "paper")])
def test_an_unusable_recording_is_reported_in_the_json_too(
    hil: Hil, make_recording: Maker, words: tuple[str, ...]
) -> None:
    path = make_recording(change=lambda channels: channels.update(dtheta=np.full(2000, 0.1)))
    ended = hil("identify", path, *words, "--json")
    assert ended.status == 1
    assert ended.json["recordings"] == [str(path)]
    assert [ended.json["parameters"][name]["value"] for name in ("Kc", "Bc")] == [None, None]
    assert not any(parameter["identifiable"] for parameter in ended.json["parameters"].values())
    assert [(warning["code"], warning["parameter"]) for warning in ended.json["errors"]] == [
        ("unusable", "Kc"),
        ("unusable", "Bc"),
    ]
    assert all("record a motion" in error["message"] for error in ended.json["errors"])


WRONG_WORDS = [
    (("record", "--backend", "simm"), "did you mean 'sim'"),
    (("record", "--backend", "sim", "--amplitude", "1"), "beyond the stand's limit of 0.03 N m"),
    (("record", "--backend", "sim", "--mode", "position", "--amplitude", "9"), "limit of 1 rad"),
    (("record", "--backend", "sim", "--amplitude", "nan"), "--amplitude 'nan' is not a number"),
    (("record", "--backend", "sim", "--band", "15:0.1"), "reversed"),
    (("record", "--backend", "sim", "--band", "low:high"), "LOW:HIGH"),
    (("record", "--backend", "sim", "--rate", "0"), "--rate 0"),
    (("record", "--backend", "sim", "--stand", "x.toml"), "not both"),
    (("record", "--stand", "x.toml"), "cannot be read"),
    (("record",), "which stand?"),
    (("record", "--backend", "sim", "-o", "none/a.h5"), "none is not a folder"),
    (("identify", "a.h5", "--model", "linear+colour"), "colour"),
    (("identify", "a.h5", "--preset", "papper"), "unknown --preset"),
    (("identify", "a.h5", "--bounds", "Kc=5:0.01"), "lower one first"),
    (("identify", "a.h5", "--bounds", "Kc=5"), "NAME=LOW:HIGH"),
    (("identify", "a.h5", "--bounds", "Kx=0:1"), "no such parameter; it has Kc, Bc"),
    (("identify", "a.h5", "--selection", "biggest"), "selection"),
    (("identify", "a.h5", "--population", "3"), "--population: population of 3"),
    (("import", "a.csv", "-o", "b.h5", "--time", "t", "--torque", "q"), "cannot be read"),
    (("import", "a.csv", "-o", "b.h5", "--time", "t", "--torque", "q", "--dtheta", "p"), "cannot be read"),
    (("recover", "a.h5"), "does not end in .part"),
    (("frobnicate",), "No such command"),
]


def test_wrong_words_end_in_a_sentence_and_status_two(hil: Hil, make_recording: Maker) -> None:
    make_recording(samples=50)
    for words, said in WRONG_WORDS:
        ended = hil(*words)
        assert (ended.status, said in ended.err, "Traceback" in ended.err, ended.out) == (2, True, False, ""), words


def test_a_read_only_target_is_wrong_use_and_leaves_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    """Root may write anywhere, so where the suite runs as root a copy of this process gives that right up first."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "locked"
        folder.mkdir(mode=0o555)
        Path(name).chmod(0o755)
        words = ["record", "--backend", "sim", "--duration", "1", "-o"]
        assert run([*words, f"{name}/a.h5"]) == 0  # loads what an unprivileged user might not reach

        def unprivileged() -> int:
            if os.getuid() == 0:
                os.setuid(65534)
            return run([*words, f"{folder}/a.h5"])

        assert exit_status(copied(unprivileged)) == 2
        assert "cannot be written (Permission denied)" in capfd.readouterr().err
        assert list(folder.iterdir()) == []


def test_a_value_is_within_the_given_bounds_or_refused(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(noise=1e-5, samples=600)
    ended = hil("identify", path, "--bounds", "Kc=0.03:5")
    assert ended.status == 1
    assert "Kc would be 0.02 N m/rad, outside --bounds Kc=0.03:5" in ended.err
    assert hil("identify", path, "--bounds", "Kc=0.019:5").status == 0
    bounded = hil("identify", path, "--model", "linear+skew", "--bounds", "skew=1e-3:2e-3", "--json").json
    assert bounded["parameters"]["skew"]["value"] == 1e-3
    assert bounded["parameters"]["skew"]["at_bound"] == "low"
    assert ("at-bound", "skew") in {(one["code"], one["parameter"]) for one in bounded["warnings"]}


def test_a_traceback_is_shown_only_on_request(hil: Hil) -> None:
    assert "Traceback" not in hil("identify", "none.h5").err
    assert "Traceback" in hil("identify", "none.h5", "--debug").err


def test_the_profiles_are_explained(hil: Hil) -> None:
    out = hil("record", "--list-profiles").out
    for kind in ("chirp", "multisine", "sine", "steps", "ramp", "prbs", "file"):
        assert kind in out


@pytest.mark.parametrize(
    ("kind", "quantity"),
    [("multisine", "torque"), ("steps", "torque"), ("ramp", "position"), ("prbs", "torque"), ("file", "position")],
)
def test_every_profile_records(hil: Hil, tmp_path: Path, kind: str, quantity: str) -> None:
    (tmp_path / "set.csv").write_text("0,0\n0.2,0.004\n0.4,0\n")
    words = ("--setpoints", "set.csv") if kind == "file" else ("--duration", "0.4")
    ended = hil("record", "--backend", "sim", "--profile", kind, "--mode", quantity, *words, "--json")
    assert (ended.status, ended.json["samples"], ended.json["end_reason"]) == (0, 201, "done")
