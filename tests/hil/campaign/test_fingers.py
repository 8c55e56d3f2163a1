"""The fingers of a hand: from the results of a campaign to JSON, page and Python."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.campaign import fingers
from hil.campaign.journal import keep_result
from hil.campaign.plan import CampaignTable, JointTable, Plan, ProfileTable, Run
from hil.campaign.results import Line, Measured, Results, Value
from hil.errors import WrongUse
from hil.hand import file as hand_file

HAND = """
[hand]
backend = "sim"
[stand]
gear_ratio = 2.0
[[joint]]
name = "flexor"
moves = "mcp"
also_moves = {pip = -0.5}
routing_uncertainty = 0.04
stand.motor_inertia = 1e-7
[[joint]]
name = "pip"
[[joint]]
name = "thumb"
"""


def result(friction: float) -> dict[str, Any]:
    part = {"value": friction, "ci95": [0.0, None], "ci95_without_torque_scale": [0.0, friction + 1.96e-5]}
    return {"model": "linear+offset+cubic+coulomb", "parameters": {"Fc": part}}


def measured(folder: Path) -> tuple[Plan, Results]:
    """Results of a hand of three motors, two recordings each; the thumb has no Bc."""
    hand, settings, lines = hand_file.parse(HAND), CampaignTable(), list[Line]()
    scale = {"torque_uncertainty": 0.1}
    for number, joint in enumerate(hand.joints):
        kc = 0.02 * (number + 1)
        values = {"Kc": Value(kc, (0.7 * kc, 1.3 * kc), "N*m/rad", highest=kc * (1 + 0.0196), **scale)}
        if joint.name != "thumb":
            values["Bc"] = Value(1e-4, (0.8e-4, 1.2e-4), "N*m*s/rad", highest=1.0196e-4, **scale)
        recorded = []
        for repeat in (1, 2):
            path = folder / f"{joint.name}_{repeat}.h5"
            path.touch()
            run = Run(path.stem, JointTable(name=joint.name), ProfileTable(name="chirp"), "", repeat, path, "key")
            keep_result(run, settings.model, settings.trials, result(1e-4 * repeat))
            recorded.append(Measured(run, values))
        lines.append(Line(joint.name, "chirp", "", tuple(recorded), values, {"Kc": True, "Bc": True}))
    runs = tuple(one.run for line in lines for one in line.measured)
    return Plan(folder / "hand.toml", settings, folder, runs, hand), Results(tuple(lines), (), {})


def test_the_motors_of_a_hand_come_from_its_results_its_file_and_what_was_identified_beside(tmp_path: Path) -> None:
    flexor, pip, thumb = fingers.motors(*measured(tmp_path))
    assert flexor.row == {"mcp": 1.0, "pip": -0.5}
    assert flexor.stiffness is not None
    assert (flexor.stiffness.value, flexor.stiffness.error) == pytest.approx((0.02, 2e-4), rel=1e-3)
    assert (flexor.torque_uncertainty, flexor.turns_uncertainty, flexor.drive) == (0.1, 0.04, "sim")
    assert flexor.friction.value == pytest.approx(1.5e-4)
    assert flexor.friction.error == pytest.approx(5e-5)  # the two recordings differ by more than their errors
    assert (flexor.inertia, flexor.further) == (4e-7, ("cubic",))
    assert pip.known
    assert thumb.damping is None


def test_python_and_page_show_the_matrices_with_named_joints_that_the_file_of_results_holds(tmp_path: Path) -> None:
    identified = fingers.motors(*measured(tmp_path))
    (tmp_path / "hand.json").write_text(json.dumps(fingers.hand_json(identified)))
    result = hil.load_hand(tmp_path)
    stiffness = result.stiffness_matrix()
    assert stiffness.joints == ("mcp", "pip", "thumb")
    assert stiffness["pip", "mcp"] == stiffness["mcp", "pip"] == pytest.approx(-0.01)
    assert np.asarray(stiffness).tolist()[2] == [0.0, 0.0, pytest.approx(0.06)]
    assert result.damping_matrix("pip")["pip", "pip"] == pytest.approx(1.25e-4)
    assert np.isnan(result.damping_matrix("thumb").values).all()
    assert result["flexor"].joint == "mcp"
    with pytest.raises(WrongUse, match="did you mean 'thumb'"):
        result.stiffness_matrix("tumb")
    [section] = fingers.sections(identified)
    half = 1.959964e3 * 0.01 * np.sqrt(0.01**2 + 0.1**2 + 0.04**2)
    assert section.rows[1] == ["K mcp, mN m/rad", "20.0 ± 3.9", f"-10.0 ± {half:.1f}"]
    assert section.rows[0] == ["", "mcp", "pip"]
    [finger, _] = json.loads((tmp_path / "hand.json").read_text())["fingers"]
    assert finger["routing"] == [[1.0, -0.5], [0.0, 1.0]]
    assert finger["stiffness"]["ci95"][1][0] == pytest.approx([-0.01 - half / 1e3, -0.01 + half / 1e3])
    for folder in (tmp_path / "hand.json", tmp_path / "none"):
        with pytest.raises(WrongUse, match="no folder"):
            hil.load_hand(folder)
