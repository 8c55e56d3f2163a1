"""A campaign: what its plan may say, what it records and resumes, and what it makes of the results."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.servo import DriverError
from hil.acquisition.heat import TooHot
from hil.acquisition.limits import LimitReached
from hil.acquisition.phases import Outcome
from hil.api.runs import Run, simulate
from hil.campaign.conduct import Desk, record_all
from hil.campaign.journal import Journal
from hil.campaign.plan import load
from hil.campaign.results import Line, Measured, Results, Value, marked, scores
from hil.campaign.table import diagnostics, table, write_page
from hil.diagnostics import Diagnostic, over_limit
from hil.errors import Declined, WrongUse
from hil.stand.toml_table import line_of

from ..conftest import Hil

ROOT = Path(__file__).parents[3]
PLAN = """
[campaign]
output = "out"
model = "linear+offset"
trials = 1
repeats = 2
[[profile]]
name = "short"
band = [0.5, 8.0]
duration = 1.0
fade = 0.2
[[joint]]
name = "soft"
[joint.sim.coupling]
stiffness = 0.015
[[joint]]
name = "stiff"
[joint.sim.coupling]
stiffness = 0.03
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def test_a_campaign_records_identifies_and_reports_every_joint_and_never_repeats_what_is_done(
    hil: Hil, plan: Path, tmp_path: Path
) -> None:
    found = hil("campaign", plan, "--json", "--workers", 1).json
    assert [line["joint"] for line in found["joints"]] == ["soft", "stiff"]
    soft, stiff = (line["parameters"]["Kc"]["value"] for line in found["joints"])
    assert soft == pytest.approx(0.015, rel=0.05)
    assert stiff == pytest.approx(0.03, rel=0.05)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "soft" in page
    assert "stiff" in page
    recordings = sorted((tmp_path / "out").glob("*.h5"))
    for result in (tmp_path / "out").glob("*.json"):
        for one in json.loads(result.read_text()).get("result", {}).get("warnings", []):
            assert escape(one["message"]) in page
    before = {path: path.stat().st_mtime_ns for path in recordings}
    assert len(recordings) == 4
    recordings[0].unlink()  # one is missing: only this one is recorded again
    again = hil("campaign", plan, "--json", "--workers", 1)
    after = {path: path.stat().st_mtime_ns for path in recordings}
    assert [path for path in recordings if after[path] != before[path]] == recordings[:1]
    assert again.json["joints"][1] == found["joints"][1]


def test_a_joint_that_fails_is_noted_and_the_next_one_is_recorded(hil: Hil, plan: Path, tmp_path: Path) -> None:
    plan.write_text(
        PLAN.replace("repeats = 2", "repeats = 1").replace(
            'name = "soft"\n[joint.sim.coupling]\nstiffness = 0.015', 'name = "soft"\nstand = "missing.toml"'
        )
    )
    ended = hil("campaign", plan, "--json")
    assert ended.status == 1
    assert [one["run"] for one in ended.json["failed"]] == ["soft_short_1"]
    assert "missing.toml" in ended.json["failed"][0]["reason"]
    assert ended.json["joints"][1]["parameters"]["Kc"]["value"] == pytest.approx(0.03, rel=0.05)
    runs = json.loads((tmp_path / "out" / "campaign.json").read_text())["runs"]
    assert [bool(entry["failure"]) for entry in runs.values()] == [True, False]


def test_a_drive_that_may_still_have_torque_ends_the_campaign_at_once(
    plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan.write_text(
        PLAN.replace('name = "soft"\n[joint.sim.coupling]\nstiffness = 0.015', 'name = "soft"\nstand = "a.toml"')
    )
    loaded, recorded = load(plan), []

    def failing(stand: object, profile: str, *, alarm: Callable[[str], object], **settings: object) -> None:
        del stand, profile
        recorded.append(settings["output"])
        alarm("the torque may still be on")
        raise DriverError("no reply\nthe torque may still be on")

    monkeypatch.setattr("hil.campaign.conduct.record", failing)
    journal = Journal(loaded)
    with pytest.raises(DriverError, match="may still be on"):
        record_all(loaded, journal, Desk(lambda _text: None, lambda _text: None, sleep=lambda _seconds: None))
    assert len(recorded) == 1
    assert "may still be on" in journal.failure(loaded.runs[0])


def test_a_person_who_does_not_agree_that_the_motor_moves_ends_the_campaign(
    plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan.write_text(
        PLAN.replace('name = "soft"\n[joint.sim.coupling]\nstiffness = 0.015', 'name = "soft"\nstand = "a.toml"')
    )
    asked: list[str] = []

    def declined(*words: object, agree: Callable[[str], object], **settings: object) -> None:
        del words, settings
        agree("the motor will move")
        raise Declined("nothing was driven")

    monkeypatch.setattr("hil.campaign.conduct.record", declined)
    loaded = load(plan)
    with pytest.raises(Declined):
        record_all(loaded, Journal(loaded), Desk(asked.append, asked.append, asked.append))
    assert asked == ["the motor will move"]


def test_recordings_of_a_real_joint_wait_for_it_to_cool_down(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = PLAN.replace("repeats = 2", "repeats = 3\ncool_down = 60.0")
    plan.write_text(
        text.replace('name = "soft"\n[joint.sim.coupling]\nstiffness = 0.015', 'name = "soft"\nstand = "a.toml"')
    )

    def failing(*words: object, **settings: object) -> None:
        del words, settings
        raise LimitReached("the winding is too warm")

    monkeypatch.setattr("hil.campaign.conduct.record", failing)
    monkeypatch.setattr("hil.campaign.conduct.simulate", failing)
    loaded = load(plan)
    waits: list[float] = []
    record_all(loaded, Journal(loaded), Desk(lambda _text: None, lambda _text: None, sleep=waits.append))
    assert waits == [60.0, 60.0]


def test_a_recording_that_exceeded_a_limit_is_named(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def over(path: Path, *words: object, **settings: object) -> Run:
        del words, settings
        return Run(path, Outcome(samples=9), (over_limit("the torque was above its limit"),))

    monkeypatch.setattr("hil.campaign.conduct.simulate", over)
    loaded, said = load(plan), list[str]()
    record_all(loaded, Journal(loaded), Desk(said.append, lambda _text: None))
    assert sum("the torque was above its limit" in text for text in said) == len(loaded.runs)


@pytest.mark.study
def test_a_recording_that_the_heat_budget_refuses_is_made_after_the_rest_that_it_needs(
    plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan.write_text(PLAN)
    waits: list[float] = []

    def warm(path: Path, profile: str, **settings: Any) -> Any:
        if not waits:
            raise TooHot("the winding would reach 75 degC", 240.0)
        return simulate(path, profile, **settings)

    monkeypatch.setattr("hil.campaign.conduct.simulate", warm)
    loaded = load(plan)
    journal, said = Journal(loaded), list[str]()
    record_all(loaded, journal, Desk(said.append, lambda _text: None, sleep=waits.append))
    assert waits == [240.0]
    assert said[0].endswith("the winding is too warm for it")
    assert all(journal.is_done(run) for run in loaded.runs)


def test_an_outlier_is_named_with_its_value_its_ratio_and_its_score() -> None:
    lines = [
        Line(f"j{at}", "chirp", "", (), {"Kc": Value(kc, (0.99 * kc, 1.01 * kc), "N*m/rad")}, {"Kc": None, "Bc": None})
        for at, kc in enumerate((0.018, 0.019, 0.02, 0.021, 0.022, 0.045))
    ]
    [text] = [one.message for one in diagnostics(Results(tuple(marked(lines)), (), {}))]
    score = (
        0.6745
        * math.log(0.045 / math.sqrt(0.02 * 0.021))
        / np.median([abs(math.log(kc / math.sqrt(0.02 * 0.021))) for kc in (0.018, 0.019, 0.02, 0.021, 0.022, 0.045)])
    )
    assert text.startswith("j5, chirp: Kc is 45 mN m/rad, 2.2 times the hand's median of 20.5 (")
    assert f"z-score {score:.1f}" in text


def test_a_joint_without_a_parameter_does_not_repeat_and_leaves_the_campaign_incomplete(plan: Path) -> None:
    kc, bc = Value(0.02, (0.019, 0.021), "N*m/rad"), Value(2e-4, (1e-4, 3e-4), "N*m*s/rad")
    why = Diagnostic("two-stiffnesses", "a: two stiffnesses", "Bc", is_error=True)
    runs = load(plan).runs
    measured = tuple(Measured(run, {"Kc": kc}, diagnostics=(why,)) for run in runs[:2])
    odd = Line("a", "chirp", "", measured, {"Kc": kc}, {"Kc": True, "Bc": None})
    good = Line("b", "chirp", "", measured, {"Kc": kc, "Bc": bc}, {"Kc": True, "Bc": True})
    found = Results((odd, good), (), {})
    headings, *rows = table(found)
    assert [row[-1] for row in rows] == ["no Bc (two-stiffnesses)", "repeats"]
    assert headings == ["joint", "recordings", "Kc, mN m/rad", "Bc, mN m s/rad", "state"]
    assert not found.complete
    [error] = diagnostics(found)
    assert (error.is_error, error.message) == (True, "a, chirp: no recording identifies Bc: a: two stiffnesses")
    assert Results((good,), (), {}).complete
    page = write_page(load(plan), found, plan.with_name("r.html")).read_text(encoding="utf-8")
    assert page.count('<th scope="col">Bc, mN m s/rad</th>') == 3  # of the hand, and of the recordings of each joint


def test_a_dry_run_shows_what_would_be_recorded_and_makes_nothing(hil: Hil, plan: Path, tmp_path: Path) -> None:
    ended = hil("campaign", plan, "--dry-run")
    first, *lines = ended.out.splitlines()
    assert first.startswith("4 of 4 recordings to make")
    assert len(lines) == 4
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "line", "message"),
    [
        (("repeats = 2", "repeat = 2"), 6, "campaign.repeat: no such key: did you mean 'repeats'?"),
        (("duration = 1.0", "duration = -2.0"), 10, "profile.duration = -2.0: must be above 0"),
        (('name = "stiff"', 'nam = "stiff"'), 17, "joint.nam: no such key: did you mean 'name'?"),
        (('name = "stiff"', 'name = "a/b"'), 17, "joint.name = 'a/b': must be letters"),
    ],
)
def test_a_mistake_in_a_plan_is_named_with_its_line_and_key(
    hil: Hil, plan: Path, change: tuple[str, str], line: int, message: str
) -> None:
    plan.write_text(PLAN.replace(*change))
    ended = hil("campaign", plan)
    assert ended.status == 2
    assert f"line {line}: {message}" in ended.err


def test_a_plan_runs_a_python_file_only_if_the_person_names_it(hil: Hil, plan: Path) -> None:
    plan.write_text(PLAN.replace('"linear+offset"', '"model.py:creeping"'))
    ended = hil("campaign", plan, "--dry-run")
    assert ended.status == 2
    assert f"hil campaign {plan} --model model.py:creeping" in ended.err
    assert hil("campaign", plan, "--dry-run", "--model", "model.py:creeping").status == 0


@pytest.mark.parametrize("output", ["..", "out/../../elsewhere", "/tmp/elsewhere", "link/out", "a\\u0000b"])  # noqa: S108
def test_a_plan_writes_nothing_outside_its_folder(hil: Hil, plan: Path, tmp_path: Path, output: str) -> None:
    (tmp_path / "link").symlink_to("/")
    plan.write_text(PLAN.replace('output = "out"', f'output = "{output}"'))
    ended = hil("campaign", plan, "--dry-run")
    assert ended.status == 2
    assert "is outside the plan's folder" in ended.err


def test_a_plan_that_is_no_toml_says_the_line(hil: Hil, plan: Path) -> None:
    plan.write_text("[campaign\n")
    ended = hil("campaign", plan)
    assert (ended.status, "line 1" in ended.err) == (2, True)


def test_two_joints_of_one_name_are_refused(plan: Path) -> None:
    plan.write_text(PLAN.replace('"stiff"', '"soft"'))
    with pytest.raises(WrongUse, match="two \\[\\[joint\\]\\]"):
        load(plan)


@pytest.mark.study
def test_a_recording_of_other_settings_is_refused(hil: Hil, plan: Path) -> None:
    once = PLAN.replace("repeats = 2", "repeats = 1").partition('[[joint]]\nname = "stiff"')[0]
    plan.write_text(once)
    assert hil("campaign", plan).status == 0
    plan.write_text(once.replace("0.015", "0.016"))
    ended = hil("campaign", plan)
    assert ended.status == 2
    assert "other settings" in ended.err


def test_checks_of_the_drift_repeat_the_first_recording(plan: Path) -> None:
    plan.write_text(PLAN.replace("repeats = 2", "repeats = 2\ndrift_check_every = 2"))
    names = [run.name for run in load(plan).runs]
    assert names == [
        "soft_short_1", "soft_short_2", "drift-check_soft_short_1",
        "stiff_short_1", "stiff_short_2", "drift-check_soft_short_2",
    ]  # fmt: skip


def test_the_example_has_twenty_two_joints() -> None:
    plan = load(ROOT / "examples" / "hand.toml")
    assert len({run.joint.name for run in plan.runs}) == 22


def test_the_plan_of_the_page_can_be_loaded(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "campaigns.md").read_text(encoding="utf-8")
    block = re.search(r"<!-- write plan.toml -->\n```toml\n(.+?)```", page, re.DOTALL)
    assert block is not None
    (tmp_path / "plan.toml").write_text(block[1])
    assert len(load(tmp_path / "plan.toml").runs) == 9


def test_every_pretension_is_asked_for_before_its_first_recording(plan: Path) -> None:
    plan.write_text(PLAN.replace('name = "soft"', 'name = "soft"\npretensions = ["1 N", "2 N"]\nbefore = "Lock it."'))
    asked = [run.asks for run in load(plan).runs if run.asks]
    assert asked == ["Lock it. Set the pretension of soft to 1 N.", "Set the pretension of soft to 2 N."]


def test_a_line_is_found_for_every_key_of_a_plan() -> None:
    lines = PLAN.splitlines()
    table = tomllib.loads(PLAN)
    for at, joint in enumerate(table["joint"]):
        assert lines[line_of(PLAN, ["joint", at, "name"]) - 1] == f'name = "{joint["name"]}"'
        stiffness = f"stiffness = {joint['sim']['coupling']['stiffness']}"
        assert lines[line_of(PLAN, ["joint", at, "sim", "coupling", "stiffness"]) - 1] == stiffness


@pytest.mark.parametrize(
    ("values", "out"), [([1.0, 1.1, 0.9, 1.05, 2.5], [4]), ([1.0, 1.1, 0.9, 1.05], []), ([1.0] * 6, [])]
)
def test_a_value_far_from_the_median_of_five_or_more_stands_out(values: list[float], out: list[int]) -> None:
    assert [at for at, score in enumerate(scores(values)) if abs(score) > 3.5] == out
