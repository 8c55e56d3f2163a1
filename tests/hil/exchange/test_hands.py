"""A hand in its own model: what changes in the file, what is refused, and what MuJoCo makes of it."""

from __future__ import annotations

import difflib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.errors import Untrustworthy, WrongUse
from hil.exchange.hands import formats
from hil.hand.routing import Motor, Value, as_json, finger

from ..conftest import Hil

BASE = Motor(
    "index_mcp", "index_mcp", Value(0.018, 2e-4), Value(2e-4, 4e-6), Value(3e-4, 1e-5), {"index_pip": 0.75},
    torque_uncertainty=0.02, inertia=3.2e-6, motor_damping=1.6e-6,
)  # fmt: skip
MOTORS = (
    BASE,
    replace(BASE, name="extensor", stiffness=Value(0.03), damping=Value(1e-4), turns={"index_pip": -0.5}),
    replace(BASE, name="index_pip", joint="index_pip", stiffness=Value(0.01), friction=Value(0.0), turns={}),
)
MODEL = """<?xml version="1.0"?>
<!-- my hand -->
<mujoco model="hand">
  <compiler angle="degree"/>
  <default><joint damping="0.1" armature='0.01' range="-90 90"/></default>
  <worldbody>
    <body  name="palm" >
      <body name="proximal"><joint name="index_mcp" axis="0 1 0"/><geom size=".01" mass=".02"/>
        <body name="middle" pos="0 0 0.04"><joint name="index_pip" axis="0 1 0" damping="0.2"/>
          <geom size=".01" mass=".01" pos="0 0 .02"/></body></body>
    </body>
  </worldbody>
  <actuator><position name="a1" joint="index_mcp" kp="2"/></actuator>
  <keyframe>
    <key name="bent" qpos="0.2  0.4"/>
  </keyframe>
</mujoco>
"""
URDF = """<robot name="hand">
  <link name="palm"/><link name="a"/><link name="b"/>
  <joint name="index_mcp" type="revolute">
    <parent link="palm"/><child link="a"/><limit lower="0" upper="1" effort="1" velocity="1"/>
    <dynamics friction = '9'   damping="0.1"/> <!-- a guess -->
  </joint>
  <joint name="index_pip" type="revolute"><parent link="a"/><child link="b"/></joint>
</robot>
"""


def exported(folder: Path, name: str, model: str | None, motors: tuple[Motor, ...] = MOTORS) -> tuple[Path, list[str]]:
    """The exported file, and the messages of its warnings."""
    into = None
    form = {".xml": "mujoco", ".urdf": "urdf", ".json": "json"}[Path(name).suffix]
    if model is not None:
        into = folder / f"model-{name}"
        into.write_bytes(model.encode())
    said = formats.write(motors, into, folder / name, form, force=True)
    return folder / name, [one.message for one in said]


def changes(before: str, after: str) -> list[str]:
    return [line for line in difflib.ndiff(before.splitlines(), after.splitlines()) if line[0] in "+-"]


def test_a_mujoco_model_gains_rotors_and_tendons_and_keeps_every_other_byte(tmp_path: Path) -> None:
    path, said = exported(tmp_path, "out.xml", MODEL)
    text = path.read_text()
    begin, end = text.index('  <worldbody>\n    <body name="index_mcp_rotor"'), text.rindex("</mujoco>")
    rest = text[:begin] + text[end:]
    assert changes(MODEL, rest)[0] == '-     <key name="bent" qpos="0.2  0.4"/>'
    assert [line[0] for line in changes(MODEL, rest)] == ["-", "+"]
    assert re.search(r'qpos="0.2  0.4 0\.5\d* 0\.0 0\.4"', rest)
    for said_of in ("a1", "index_pip (damping)"):
        assert sum(said_of in message for message in said) == 1
    crlf, _ = exported(tmp_path, "crlf.xml", MODEL.replace("\n", "\r\n"))
    assert crlf.read_bytes() == text.replace("\n", "\r\n").encode()
    with pytest.raises(WrongUse, match="already has index_mcp_rotor"):
        exported(tmp_path, "twice.xml", text)


def test_a_urdf_gets_damping_and_friction_with_all_motors_held_and_says_what_is_lost(tmp_path: Path) -> None:
    path, said = exported(tmp_path, "out.urdf", URDF)
    changed = changes(URDF, path.read_text())
    damping, friction = 0.75**2 * 2e-4 + 0.25 * 1e-4 + 2e-4, 3e-4 * 1.25
    assert next(line for line in changed if line[0] == "+") == (
        '+     <dynamics friction="0.0006"   damping="0.00030000000000000003"/> <!-- a guess -->'
    )
    [new] = re.findall(r'<child link="b"/>\s*<dynamics damping="(\S+)" friction="(\S+)"/>\s*</joint>', path.read_text())
    assert [float(word) for word in new] == pytest.approx([damping, friction])
    assert "Kc" in said[0]


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (MODEL.replace('name="index_pip"', 'name="Index_PIP"'), r"'index_pip' \(did you mean 'Index_PIP'\?\)"),
        (MODEL.replace('name="index_pip"', 'name="index_pip" type="slide"'), "no hinge joint 'index_pip'"),
        (MODEL.replace('<body name="middle" pos="0 0 0.04">', '<include file="m.xml"/><body>').replace("pip", "dip"),
         r"m\.xml, which it includes"),
        (MODEL.replace('qpos="0.2  0.4"', 'qpos="0.2"'), "has 1 numbers of qpos"),
        ('<!DOCTYPE a [<!ENTITY b "c">]>' + MODEL[22:], "document type or entities"),
        (MODEL[:-12], "is no XML file"),
        (URDF, "begins with <robot>"),
        ("<mujoco>" * 600, "nested more than"),
        (MODEL.replace("my", "\0"), "not stored as UTF-8"),
    ],
)  # fmt: skip
def test_a_model_that_does_not_fit_or_is_hostile_is_refused_and_nothing_is_written(
    tmp_path: Path, model: str, said: str
) -> None:
    with pytest.raises(WrongUse, match=said):
        exported(tmp_path, "out.xml", model)
    assert not (tmp_path / "out.xml").exists()


def test_a_motor_without_a_trusted_value_is_left_out_and_named(tmp_path: Path) -> None:
    broken = replace(MOTORS[2], damping=None)
    (tmp_path / "hand.json").write_text(json.dumps({"motors": as_json([*MOTORS[:2], broken])}))
    motors, [error] = formats.known(tmp_path)
    assert motors == MOTORS[:2]
    assert error.is_error
    assert error.message.startswith("index_pip has no Bc")
    for text, kind in ((json.dumps({"motors": as_json([broken])}), Untrustworthy), ("{}", WrongUse), ("[[", WrongUse)):
        (tmp_path / "hand.json").write_text(text)
        with pytest.raises(kind, match=r"hand\.json|no motor has both"):
            formats.known(tmp_path)


def test_the_command_exports_a_folder_and_says_what_does_not_fit_together(hil: Hil, tmp_path: Path) -> None:
    (tmp_path / "hand").mkdir()
    (tmp_path / "hand" / "hand.json").write_text(json.dumps({"motors": as_json(MOTORS)}))
    (tmp_path / "own.xml").write_text(MODEL)
    (tmp_path / "run.h5").touch()
    ended = hil("export", "hand", "--into", "own.xml", "-o", "out.xml")
    assert (ended.status, ended.out) == (0, "out.xml: 3 motors of 3\n")
    assert "index_mcp_tendon" in (tmp_path / "out.xml").read_text()
    for words, said in (
        (("hand", "-o", "a.xml"), "name that with --into"),
        (("hand", "--into", "own.xml", "-o", "a.json"), "leave out --into"),
        (("hand", "--into", "own.xml", "-o", "a.sdf"), "sdf does not hold a hand"),
        (("hand", "--into", "own.xml", "-o", "own.xml", "--force"), "own.xml"),
        (("run.h5", "--into", "own.xml", "-o", "a.xml"), "no folder of hil hand"),
        (("own.xml", "-o", "a.csv"), "own.xml"),
    ):
        ended = hil("export", *words)
        assert (ended.status, said in ended.err) == (2, True), ended.err


def test_priors_are_values_and_their_95_percent_intervals(tmp_path: Path) -> None:
    path, _ = exported(tmp_path, "priors.json", None)
    table: dict[str, Any] = json.loads(path.read_text())
    assert len(table) == 3 * 3 - 1  # no friction: no bounds of it
    stiff = table["index_mcp_tendon.stiffness"]
    half = 1.959964 * np.hypot(2e-4, 0.02 * 0.018)
    assert stiff["nominal"] == stiff["value"] == [0.018]
    assert (*stiff["min_value"], *stiff["max_value"]) == pytest.approx((0.018 - half, 0.018 + half))


def test_the_yaml_that_mujoco_sysid_reads_has_a_number_for_each_prior(tmp_path: Path) -> None:
    """ParameterDict.load_from_disk reads YAML 1.1 and takes these five keys of each parameter."""
    yaml = pytest.importorskip("yaml", reason="PRIORS NOT READ AS YAML: it is not installed")
    path, _ = exported(tmp_path, "priors.json", None)
    for name, one in yaml.safe_load(path.read_text()).items():
        assert one.keys() == {"name", "nominal", "min_value", "max_value", "value", "frozen"}
        assert one["name"] == name
        assert all(isinstance(one[key][0], float) for key in ("nominal", "min_value", "max_value", "value"))
        assert one["min_value"] < one["nominal"] < one["max_value"]


@pytest.fixture
def simulated(tmp_path: Path) -> Any:
    """The exported model, its joints locked by a huge inertia, without gravity."""
    mujoco = pytest.importorskip("mujoco", reason="EXPORTED HAND NOT SIMULATED: mujoco is not installed")
    path, _ = exported(tmp_path, "out.xml", MODEL)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep, model.opt.gravity[:] = 1e-4, 0.0
    model.opt.tolerance = 0.0  # which MuJoCo scales by the mean of the inertias
    for name in ("index_mcp", "index_pip"):
        model.dof_armature[model.joint(name).dofadr[0]] = 1e6
    return model


@pytest.mark.study
@pytest.mark.parametrize("motor", MOTORS, ids=lambda motor: motor.name)
def test_each_kc_and_bc_returns_from_a_simulation_of_the_exported_model_with_its_joints_locked(
    simulated: Any, motor: Motor
) -> None:
    import mujoco

    assert motor.stiffness
    assert motor.damping
    data = mujoco.MjData(simulated)
    dof = simulated.joint(f"{motor.name}_rotor").dofadr[0]
    rows, length = [], 40_000
    for step in range(length):
        time = step * simulated.opt.timestep
        data.qfrc_applied[dof] = 4e-3 * np.sin(2.0 * np.pi * (0.3 + 3.0 * time) * time)
        mujoco.mj_step(simulated, data)
        rows.append((data.qpos[dof], data.qvel[dof], data.qacc[dof], data.qfrc_applied[dof]))
    angle, rate, acceleration, torque = np.array(rows).T
    angle = angle - rate * simulated.opt.timestep  # the state for which MuJoCo computed the acceleration
    rate = rate - acceleration * simulated.opt.timestep
    reaction = torque - motor.inertia * acceleration - motor.motor_damping * rate
    kept = np.abs(rate) > 0.05
    columns = np.column_stack([angle, rate, np.sign(rate)])[kept]
    stiffness, damping, friction = np.linalg.lstsq(columns, reaction[kept], rcond=None)[0]
    assert stiffness == pytest.approx(motor.stiffness.value, rel=0.01)
    assert damping == pytest.approx(motor.damping.value, rel=0.03)
    assert friction == pytest.approx(motor.friction.value, rel=0.05, abs=2e-6)


@pytest.mark.study
def test_a_moved_motor_and_a_turned_joint_of_the_exported_model_read_the_stiffness_matrix(simulated: Any) -> None:
    import mujoco

    stiffness = finger(MOTORS).stiffness
    dofs = {name: simulated.joint(name).dofadr[0] for name in stiffness.joints}
    data, small = mujoco.MjData(simulated), 0.01
    torques = {}
    for moved in (*stiffness.joints, "index_mcp_rotor", "extensor_rotor"):
        mujoco.mj_resetData(simulated, data)
        data.qpos[simulated.joint(moved).qposadr[0]] = small
        mujoco.mj_forward(simulated, data)
        torques[moved] = {name: data.qfrc_passive[dof] / small for name, dof in dofs.items()}
    for column in stiffness.joints:
        for row in stiffness.joints:
            assert -torques[column][row] == pytest.approx(stiffness[row, column], rel=0.02)
    both = [torques[f"{name}_rotor"]["index_pip"] for name in ("index_mcp", "extensor")]
    assert sum(both) == pytest.approx(
        stiffness["index_pip", "index_mcp"], rel=0.02
    )  # what the joint's motors pull there
    assert simulated.key("bent").qpos == pytest.approx([0.2, 0.4, 0.5, 0.0, 0.4])
