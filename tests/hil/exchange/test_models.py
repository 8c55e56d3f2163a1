"""The coupling as a model of other programs, each read back by a reader of its own."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from hil.errors import Untrustworthy, WrongUse
from hil.exchange import models
from hil.exchange.coupling import Coupling, of_json, of_result
from hil.exchange.exporter import export_coupling

from ..conftest import Hil, Maker

KC, BC, FC = 0.01775, 1.9e-4, 3e-4
COUPLING = Coupling(
    KC, (0.0177, 0.0178), BC, (1.8e-4, 2.0e-4), FC, "linear+coulomb",
    {"Kc": (KC, "N*m/rad"), "Bc": (BC, "N*m*s/rad"), "Fc": (FC, "N*m")}, ("a--b */ <x>.h5",),
)  # fmt: skip


def result(**changes: Any) -> dict[str, Any]:
    def parameter(value: float, unit: str) -> dict[str, Any]:
        return {"value": value, "unit": unit, "ci95": [0.9 * value, 1.1 * value], "trusted": True}

    found = {"Kc": parameter(KC, "N*m/rad"), "Bc": parameter(BC, "N*m*s/rad")}
    table: dict[str, Any] = {"schema": "hil-identification/2", "model": "linear", "recordings": ["a.h5"]}
    return table | {"parameters": found, "warnings": [], "errors": []} | changes


@pytest.mark.parametrize("written", [models.mujoco, models.urdf, models.sdf])
def test_no_name_of_a_recording_ends_the_comment_that_it_stands_in(written: Callable[[Coupling], str]) -> None:
    hostile = ("a--->b.h5", "--><include file='/etc/passwd'/><!-", "c--", "\x1b-\x00-\ud800>.h5")
    root = ET.fromstring(written(replace(COUPLING, source=hostile, model="linear---><evil/>")))  # noqa: S314 - ours
    assert not {"include", "evil"} & {one.tag for one in root.iter()}


@pytest.mark.study
def test_mujoco_reads_the_model(tmp_path: Path) -> None:
    import mujoco

    export_coupling(COUPLING, tmp_path / "a.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    found = (np.ravel(model.jnt_stiffness)[0], np.ravel(model.dof_damping)[0], np.ravel(model.dof_frictionloss)[0])
    assert found == (KC, BC, FC)


@pytest.mark.study
def test_a_mujoco_model_that_is_simulated_and_recorded_gives_its_kc_and_bc_again(hil: Hil, tmp_path: Path) -> None:
    """The motor's torque through equation (1), as from a real drive without a torque cell."""
    import mujoco

    (tmp_path / "result.json").write_text(json.dumps(result()))
    assert hil("export", "result.json", "-o", "finger.xml")[:2] == (
        0, "finger.xml: Kc 0.01775 N m/rad, Bc 0.00019 N m s/rad (linear)\n",
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "finger.xml"))
    model.opt.timestep = step = 1e-4  # MuJoCo holds the torque over a step: as late as half of it
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    times, phases = np.arange(0.0, 8.0, step), np.array([0.0, 2.0, 1.0, 4.0, 3.0])
    torques = 1e-3 * np.sin(2.0 * math.pi * np.outer(times, [0.5, 1.3, 2.9, 5.1, 8.3]) + phases).sum(axis=1)
    noise = 2e-5 * generator.standard_normal(times.size)
    lines = []
    for index, (time, torque) in enumerate(zip(times.tolist(), torques.tolist(), strict=True)):
        data.ctrl[0] = torque
        mujoco.mj_step(model, data)
        if index % 20 == 0:
            angle, _, read = data.sensordata.tolist()
            lines.append(f"{time:.4f},{read + noise[index]:.9g},{angle!r}")
    (tmp_path / "log.csv").write_text("time_s,motor_torque_Nm,motor_position_rad\n" + "\n".join(lines) + "\n")
    inertia = float(model.body("motor").inertia[2])
    (tmp_path / "stand.toml").write_text(f"[stand]\nmotor_inertia = {inertia!r}\n")
    columns = ("--time", "time", "--motor-torque", "motor_torque_Nm", "--motor-position", "motor_position_rad")
    assert hil("import", "log.csv", *columns, "--stand", "stand.toml", "-o", "log.h5")[0] == 0
    ended = hil("identify", "log.h5", "--model", "linear", "--trials", "2", "--json")
    parameters = json.loads(ended.out)["parameters"]
    assert parameters["Kc"]["value"] == pytest.approx(KC, rel=2e-3)
    assert parameters["Bc"]["value"] == pytest.approx(BC, rel=1e-2)


@pytest.mark.parametrize(("name", "path"), [("a.urdf", "joint/dynamics"), ("a.sdf", "model/joint/axis/dynamics")])
def test_urdf_and_sdf_hold_the_dynamics_where_their_specifications_have_them(
    tmp_path: Path, name: str, path: str
) -> None:
    export_coupling(COUPLING, tmp_path / name)
    root = ET.parse(tmp_path / name).getroot()  # noqa: S314 - our own file
    dynamics = root.find(path)
    assert dynamics is not None
    found = dynamics.attrib | {part.tag: part.text for part in dynamics}
    assert (float(found["damping"] or 0), float(found["friction"] or 0)) == (BC, FC)
    stiffness = root.findtext("gazebo/springStiffness") or found.get("spring_stiffness")
    assert float(stiffness or 0) == KC


def test_a_c_compiler_reads_the_header(tmp_path: Path) -> None:
    export_coupling(COUPLING, tmp_path / "a.h")
    text = (tmp_path / "a.h").read_text()
    assert {name: float(value) for name, value in re.findall(r"#define HIL_(\w+) (\S+) /\*", text)} == {
        "KC": KC, "BC": BC, "FC": FC,
    }  # fmt: skip
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("C HEADER NOT COMPILED: there is no cc")
    program = '#include "a.h"\n#include <stdio.h>\nint main(void){printf("%.17g",HIL_KC);return 0;}\n'
    (tmp_path / "a.c").write_text(program)
    subprocess.run([compiler, "-Wall", "-Werror", "-o", tmp_path / "a", tmp_path / "a.c"], check=True)
    assert float(subprocess.run([tmp_path / "a"], check=True, capture_output=True, text=True).stdout) == KC


def test_json_holds_every_parameter(tmp_path: Path) -> None:
    export_coupling(COUPLING, tmp_path / "a.json")
    table = json.loads((tmp_path / "a.json").read_text())
    assert table["stiffness"] == {"value": KC, "unit": "N*m/rad", "ci95": [0.0177, 0.0178]}
    assert table["parameters"]["Fc"] == {"value": FC, "unit": "N*m"}


def test_terms_that_a_joint_of_a_simulator_does_not_have_are_warned_of() -> None:
    assert COUPLING.left_out() == []
    found = of_json(result(model="linear+offset+cubic+backlash"), "a.json").left_out()
    assert [one.code for one in found] == ["terms-left-out"]
    assert "no place for cubic, backlash" in found[0].message


def test_a_result_that_must_not_be_trusted_is_not_exported() -> None:
    table = result(errors=[{"code": "misfit", "parameter": "Bc", "message": "Bc may be wrong by 30 %"}])
    table["parameters"]["Bc"]["trusted"] = False
    with pytest.raises(Untrustworthy, match=r"a.json: Bc cannot be trusted.*: Bc may be wrong by 30 %"):
        of_json(table, "a.json")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "a.json is empty"),
        ("[1]", "is no result of hil identify: write one with"),
        ('{"schema": "other/1"}', "schema 'other/1'"),
        (json.dumps(result(parameters={})), "lacks the value or interval of Kc or Bc"),
        (json.dumps(result(parameters=3)), "lacks the value or interval of Kc or Bc"),
        ("[" * 100_000, "is no result of hil identify"),
    ],
)
def test_what_is_no_result_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(WrongUse, match=said):
        of_result(tmp_path / "a.json")


def test_a_recording_is_identified_and_exported_in_one_command(hil: Hil, tmp_path: Path, make_recording: Maker) -> None:
    make_recording("a.h5", samples=600, noise=1e-5)
    status, out, _ = hil("export", "a.h5", "-o", "a.sdf")
    assert (status, out.startswith("a.sdf: Kc 0.0")) == (0, True)
    text = (tmp_path / "a.sdf").read_text()
    assert float(re.findall("<spring_stiffness>(.*)</", text)[0]) == pytest.approx(0.02, rel=1e-3)
    status, _, err = hil("export", "a.h5", "-o", "a.sdf")
    assert (status, "a.sdf exists" in err) == (2, True)
