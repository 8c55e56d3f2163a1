"""`hil hand`: the campaign that follows from the file of a hand, its table, hand.json and report."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from hil.campaign.plan import load, of_hand
from hil.errors import WrongUse

from ..conftest import Hil
from .conftest import SIMULATED_HAND
from .test_doctor import HAND

REFUSED = """
[[joint]]
name = "blocked"
limits.deflection = 1e-3   # reached at once
"""


def test_a_hand_is_recorded_joint_after_joint_and_a_failure_names_its_joint_and_stops_no_other(
    hil: Hil, tmp_path: Path
) -> None:
    path = tmp_path / "hand.toml"
    path.write_text(SIMULATED_HAND.replace('[[joint]]\nname = "stiff"', f'{REFUSED}\n[[joint]]\nname = "stiff"'))
    planned = hil("hand", path, "--dry-run")
    assert "3 of 3 recordings to make; all together take 0.1 minutes" in planned.out
    assert "first: Lock soft" in planned.out
    ended = hil("hand", path, "--yes", "--json", "--workers", 1)
    assert ended.status == 1
    assert "blocked_chirp_1 failed: " in ended.err
    assert "3 of 3, stiff_chirp_1: " in ended.err
    assert re.search(r"1 of 3, soft_chirp_1: \d+ samples, \d+ lost; 0\.0 min left", ended.err)
    kept = json.loads((tmp_path / "hand" / "hand.json").read_text())
    assert kept == ended.json
    assert [failed["run"] for failed in kept["failed"]] == ["blocked_chirp_1"]
    values = {line["joint"]: line["parameters"].get("Kc", {}).get("value") for line in kept["joints"]}
    assert values.pop("blocked") is None
    assert values == {"soft": pytest.approx(0.015, rel=0.05), "stiff": pytest.approx(0.03, rel=0.05)}
    page = (tmp_path / "hand" / "report.html").read_text()
    assert page.count("<details id=") >= 4  # the runs of each joint
    assert "Recordings of soft, chirp" in page
    path.write_text(path.read_text().replace("deflection = 1e-3", "deflection = 1.1"))
    again = hil("hand", path, "--yes", "--workers", 1)  # records only what failed
    assert (again.status, again.err.count(" samples, ")) == (0, 1)
    assert "Kc and Bc of 3 of 3 joints" in again.out


def test_an_edit_of_what_was_recorded_is_refused_and_an_edit_of_the_routing_is_not(tmp_path: Path) -> None:
    path = tmp_path / "hand.toml"
    path.write_text(SIMULATED_HAND)
    first = [run.key for run in of_hand(path).runs]
    path.write_text(SIMULATED_HAND.replace("stiff = 0.5", "stiff = 0.6"))
    assert [run.key for run in of_hand(path).runs] == first
    path.write_text(SIMULATED_HAND.replace("stand.gear_ratio = 5.0", "stand.gear_ratio = 5.1"))
    assert [run.key == old for run, old in zip(of_hand(path).runs, first, strict=True)] == [True, False]
    text = HAND.replace("[hand]", "[hand]\nrepeats = 1", 1)
    path.write_text(text)
    first = [run.key for run in of_hand(path).runs]
    path.write_text(text.replace("id = 3", "id = 5"))
    assert [run.key == old for run, old in zip(of_hand(path).runs, first, strict=True)] == [True, True, False]
    path.write_text(SIMULATED_HAND.replace("[hand]", '[hand]\noutput = "../elsewhere"'))
    with pytest.raises(WrongUse, match=r"hand\.output = '\.\./elsewhere' is outside"):
        of_hand(path)
    path.write_text(SIMULATED_HAND.replace('model = "linear+offset"', 'model = "x.py:model"'))
    with pytest.raises(WrongUse, match=r"hand\.model = .*name it yourself: hil hand "):
        of_hand(path)
    with pytest.raises(WrongUse, match="is the file of a hand, whose plan follows from it: hil hand"):
        load(path)
