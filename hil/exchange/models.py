"""Write the coupling as a file for other programs: MuJoCo, URDF, SDF, a C header or JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple
from xml.etree import ElementTree as ET

from hil.exchange.coupling import Coupling
from hil.units import NO_UNIT

SCHEMA = "hil-coupling/1"
_FREE_FREQUENCY = 100.0  # Hz at which the coupling swings with the placeholder of the motor's inertia
_RADIUS = 0.01  # m of the body that stands for the rotor

Attributes = dict[str, str]


class ModelFormat(NamedTuple):
    """A file format for the coupling: its suffix, the function that writes it, and whether it holds every parameter of
    the model.
    """

    suffix: str
    text: Callable[[Coupling], str]
    complete: bool = False


def mujoco(coupling: Coupling) -> str:
    """Return a MuJoCo model: a motor, the coupling, and a locked joint, with sensors of angle, rate and torque.

    The motor's inertia in the model is a placeholder.
    """
    root = _root("mujoco", coupling, {"model": "coupling"})
    inertia = _number(_placeholder(coupling))
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(root, "option", timestep="0.0005", integrator="implicitfast", gravity="0 0 0")
    joint = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name="joint")
    joint.append(ET.Comment(" locked to the world; add a joint here to release it "))
    motor = ET.SubElement(joint, "body", name="motor")
    motor.append(ET.Comment(" the inertia is a placeholder: write the motor's, times the gear ratio squared "))
    ET.SubElement(motor, "inertial", pos="0 0 0", mass="0.01", diaginertia=f"{inertia} {inertia} {inertia}")
    hinge = ET.SubElement(motor, "joint", name="coupling", type="hinge", axis="0 0 1")
    hinge.attrib |= {"stiffness": _number(coupling.stiffness), "damping": _number(coupling.damping)}
    if coupling.friction:
        hinge.set("frictionloss", _number(coupling.friction))
    ET.SubElement(motor, "geom", type="cylinder", size=f"{_RADIUS} {_RADIUS}", contype="0", conaffinity="0")
    ET.SubElement(ET.SubElement(root, "actuator"), "motor", name="motor", joint="coupling")
    sensor = ET.SubElement(root, "sensor")
    ET.SubElement(sensor, "jointpos", name="dtheta", joint="coupling")
    ET.SubElement(sensor, "jointvel", name="dtheta_dot", joint="coupling")
    ET.SubElement(sensor, "actuatorfrc", name="motor_torque", actuator="motor")
    return _text(root)


def urdf(coupling: Coupling) -> str:
    """Return a URDF with the joint's damping and friction. The stiffness is in Gazebo's extension, because URDF has no
    stiffness.
    """
    root = _root("robot", coupling, {"name": "coupling"})
    for name in ("base", "motor"):
        ET.SubElement(root, "link", name=name)
    joint = ET.SubElement(root, "joint", name="coupling", type="continuous")
    ET.SubElement(joint, "parent", link="base")
    ET.SubElement(joint, "child", link="motor")
    ET.SubElement(joint, "axis", xyz="0 0 1")
    ET.SubElement(joint, "dynamics", damping=_number(coupling.damping), friction=_number(coupling.friction))
    gazebo = ET.SubElement(root, "gazebo", reference="coupling")
    ET.SubElement(gazebo, "springStiffness").text = _number(coupling.stiffness)
    ET.SubElement(gazebo, "springReference").text = "0"
    return _text(root)


def sdf(coupling: Coupling) -> str:
    """Return an SDF model with the joint's spring stiffness, damping and friction."""
    root = _root("sdf", coupling, {"version": "1.9"})
    model = ET.SubElement(root, "model", name="coupling")
    for name in ("base", "motor"):
        ET.SubElement(model, "link", name=name)
    joint = ET.SubElement(model, "joint", name="coupling", type="revolute")
    ET.SubElement(joint, "parent").text = "base"
    ET.SubElement(joint, "child").text = "motor"
    axis = ET.SubElement(joint, "axis")
    ET.SubElement(axis, "xyz").text = "0 0 1"
    dynamics = ET.SubElement(axis, "dynamics")
    ET.SubElement(dynamics, "damping").text = _number(coupling.damping)
    ET.SubElement(dynamics, "friction").text = _number(coupling.friction)
    ET.SubElement(dynamics, "spring_reference").text = "0"
    ET.SubElement(dynamics, "spring_stiffness").text = _number(coupling.stiffness)
    return _text(root)


def c_header(coupling: Coupling) -> str:
    """Return a C header with one macro for each parameter and each number for a controller, SI."""
    lines = [
        "#ifndef HIL_COUPLING_H",
        "#define HIL_COUPLING_H",
        "",
        *(f"/* {line} */" for line in _notes(coupling)),
        "",
    ]
    for name, (value, unit) in coupling.parameters.items():
        comment = "" if unit == NO_UNIT else f" /* {_safe(unit)} */"
        lines.append(f"#define HIL_{_macro(name)} {_number(value)}{comment}")
    for name, (value, interval, unit) in coupling.controller.items():
        ends = [f"95 % interval {interval[0]:.6g} to {interval[1]:.6g}"] if interval else []
        comment = ", ".join([*([] if unit == NO_UNIT else [_safe(unit)]), *ends])
        lines.append(f"#define HIL_{_macro(name)} {_number(value)} /* {comment} */")
    return "\n".join([*lines, "", "#endif", ""])


def _macro(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9]", "_", name).upper()


def as_json(coupling: Coupling) -> str:
    """Return a JSON object with every parameter, SI."""
    table = {
        "schema": SCHEMA,
        "stiffness": {"value": coupling.stiffness, "unit": "N*m/rad", "ci95": list(coupling.stiffness_interval)},
        "damping": {"value": coupling.damping, "unit": "N*m*s/rad", "ci95": list(coupling.damping_interval)},
        "friction": {"value": coupling.friction, "unit": "N*m"},
        "model": coupling.model,
        "parameters": {name: {"value": value, "unit": unit} for name, (value, unit) in coupling.parameters.items()},
        "controller": {
            name: {"value": value, "unit": unit} | ({"ci95": list(interval)} if interval else {})
            for name, (value, interval, unit) in coupling.controller.items()
        },
        "recordings": list(coupling.source),
    }
    return json.dumps(table, indent=2, allow_nan=False) + "\n"


FORMATS: Mapping[str, ModelFormat] = MappingProxyType(
    {
        "mujoco": ModelFormat(".xml", mujoco),
        "urdf": ModelFormat(".urdf", urdf),
        "sdf": ModelFormat(".sdf", sdf),
        "c": ModelFormat(".h", c_header, complete=True),
        "json": ModelFormat(".json", as_json, complete=True),
    }
)
"""All file formats for the coupling, by the name that --format takes."""


def _placeholder(coupling: Coupling) -> float:
    """Return an inertia, kg m^2, with which the coupling oscillates at a frequency that a simulation can follow."""
    return abs(coupling.stiffness) / (2.0 * math.pi * _FREE_FREQUENCY) ** 2


def _number(value: float) -> str:
    return repr(float(value))


def _notes(coupling: Coupling) -> list[str]:
    """Return sentences about the source and the uncertainty of the numbers, for a comment in XML and C."""
    low, high = coupling.stiffness_interval
    least, most = coupling.damping_interval
    return [
        f"made by hil export from {_safe(', '.join(coupling.source))}, model {_safe(coupling.model)}; SI, at the joint",
        f"Kc {coupling.stiffness:.6g} N*m/rad, 95 % interval {low:.6g} to {high:.6g}",
        f"Bc {coupling.damping:.6g} N*m*s/rad, 95 % interval {least:.6g} to {most:.6g}",
    ]


def _safe(text: str) -> str:
    """Return the text without characters that would end a comment in XML or C, or begin a new line."""
    plain = "".join(character if character.isprintable() else "?" for character in text)
    return re.sub("-(?=-)", "- ", plain).replace("*/", "* /").rstrip("-\\")


def _root(tag: str, coupling: Coupling, attributes: Attributes) -> ET.Element:
    root = ET.Element(tag, attributes)
    for line in _notes(coupling):
        root.append(ET.Comment(f" {line} "))
    return root


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
