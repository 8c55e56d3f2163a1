"""An identified hand in its own MuJoCo model or URDF, and as parameters with bounds for a further identification."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse, meant
from hil.exchange.hands.xml_edit import Document, Edit, Tag, load
from hil.hand.routing import Motor, Value, fingers, read
from hil.recording.output import atomic_write

_FREE_FREQUENCY = 100.0  # Hz at which a rotor of unknown inertia swings on its tendon
_COORDINATES = {"hinge": 1, "slide": 1, "ball": 4, "free": 7}
_DRY = ' solreffriction="1e-4 1" solimpfriction="0.999 0.999 0.001"'
"""Of a friction that is dry: with MuJoCo's defaults that of a light rotor acts like a damper of twice Bc. MuJoCo raises
the time of 1e-4 s to two steps.
"""

_OWN_VALUES = ("stiffness", "damping", "frictionloss")


class HandFormat(NamedTuple):
    """A format for a hand. root: the outermost element of the model that it changes, None if it needs no model. text:
    returns the file and the warnings.
    """

    root: str | None
    text: Callable[[Sequence[Motor], Document | None], tuple[bytes, list[Diagnostic]]]


def known(folder: Path) -> tuple[tuple[Motor, ...], list[Diagnostic]]:
    """Return the motors of the hand in a folder of results that have Kc and Bc, and an error for each that has not.

    Raises WrongUse, and Untrustworthy if no motor has both.
    """
    motors = read(folder)
    missing = [
        Diagnostic(
            "no-result",
            f"{motor.name} has no {'Bc' if motor.stiffness else 'Kc'} that can be trusted, so its tendon is left out: "
            "the report of hil hand says why",
            is_error=True,
        )
        for motor in motors
        if not motor.known
    ]
    if len(missing) == len(motors):
        raise Untrustworthy(f"{folder}: no motor has both Kc and Bc, so no model is made: {missing[0].message}")
    return tuple(motor for motor in motors if motor.known), missing


def write(motors: Sequence[Motor], into: Path | None, target: Path, form: str, *, force: bool) -> list[Diagnostic]:
    """Write the motors in the format `form` and return the warnings. into: the hand's own model, of the same format.

    Raises WrongUse, and then nothing is written.
    """
    if form not in FORMATS:
        raise WrongUse(f"{target}: {form} does not hold a hand: {', '.join(FORMATS)} do, by the name's end")
    chosen = FORMATS[form]
    if chosen.root and into is None:
        raise WrongUse(f"{target} holds a hand only within the hand's own model: name that with --into HAND.{form}")
    if into is not None and not chosen.root:
        raise WrongUse(f"{target} holds parameters and no model: leave out --into")
    document = None if into is None or chosen.root is None else load(into, chosen.root)
    text, said = chosen.text(motors, document)
    with atomic_write(target, force=force) as temporary:
        temporary.write_bytes(text)
    return said


def _mujoco(motors: Sequence[Motor], model: Document | None) -> tuple[bytes, list[Diagnostic]]:
    """Return a MuJoCo model with a rotor and a fixed tendon for each motor; its angle is that of the joint it turns."""
    assert model is not None  # noqa: S101 - `write` has loaded it; for the type checker
    joints = [tag for tag in model.tags if tag.path[1:2] == ("worldbody",) and tag.path[-1] in {"joint", "freejoint"}]
    names = {tag.attributes.get("name", ""): tag for tag in joints}
    _require_joints(motors, names, model)
    hinges = {name: tag for name, tag in names.items() if _kind(tag) == "hinge"}
    _require_joints(motors, hinges, model, "hinge ")
    taken = {(tag.path[-1], tag.attributes.get("name")) for tag in model.tags}
    for motor in motors:
        if ("joint", _rotor(motor)) in taken or ("fixed", _tendon(motor)) in taken:
            raise WrongUse(
                f"{model.path} already has {_rotor(motor)} or {_tendon(motor)}: export into the model as it was before"
            )
    lines = ["  <worldbody>", *_rotors(motors), "  </worldbody>", "  <tendon>", *_tendons(motors), "  </tendon>"]
    keys = [_key(tag, joints, motors, model) for tag in model.tags if tag.path[1:] == ("keyframe", "key")]
    edits = [model.insertion(model.tags[0].end, lines), *(edit for edit in keys if edit is not None)]
    return model.edited(edits), [*_beside(motors, model, hinges), *_left_out(motors)]


def _require_joints(motors: Iterable[Motor], names: Mapping[str, Tag], model: Document, kind: str = "") -> None:
    """Raise WrongUse, with the nearest names, if the model lacks a joint of the hand."""
    wanted = dict.fromkeys(name for motor in motors for name in motor.row)
    missing = [f"no {kind}joint {name!r}{_meant(name, names)}" for name in wanted if name not in names]
    if missing:
        known = f"its {kind}joints are {', '.join(filter(None, names)) or 'without names'}"
        files = [tag.attributes.get("file", "?") for tag in model.tags if tag.path[-1] == "include"]
        inner = f"; joints may be in {', '.join(files)}, which it includes: name that file with --into" if files else ""
        raise WrongUse(
            f"{model.path} has {'; '.join(missing)}: the names in hand.toml and in the model must be the same; {known}"
            f"{inner}"
        )


def _meant(name: str, names: Iterable[str]) -> str:
    near = meant(name, names).strip(" ?")
    return f" ({near}?)" if near else ""


def _rotors(motors: Iterable[Motor]) -> Iterator[str]:
    for motor in motors:
        name, inertia = quoteattr(_rotor(motor)), motor.inertia or _placeholder(motor)
        yield f"    <body name={name}>"
        yield '      <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-12 1e-12 1e-12"/>'
        yield f'      <joint name={name} type="hinge" axis="0 0 1" limited="false" stiffness="0" frictionloss="0"'
        yield f'        armature="{inertia!r}" damping="{float(motor.motor_damping)!r}"/>'
        yield "    </body>"


def _tendons(motors: Iterable[Motor]) -> Iterator[str]:
    """Yield fixed tendons that are unloaded in the model's reference pose."""
    for motor in motors:
        values = {"stiffness": motor.stiffness, "damping": motor.damping, "frictionloss": motor.friction}
        shown = " ".join(f'{name}="{value.value!r}"' for name, value in values.items() if value is not None)
        yield f'    <fixed name={quoteattr(_tendon(motor))} limited="false" springlength="-1" {shown}{_DRY}>'
        yield f'      <joint joint={quoteattr(_rotor(motor))} coef="-1"/>'
        for joint, turns in motor.row.items():
            yield f'      <joint joint={quoteattr(joint)} coef="{float(turns)!r}"/>'
        yield "    </fixed>"


def _key(tag: Tag, joints: Sequence[Tag], motors: Sequence[Motor], model: Document) -> Edit | None:
    """Return the edit that gives a keyframe the angles of the rotors at which no tendon is loaded."""
    if not {"qpos", "qvel"} & set(tag.attributes):
        return None
    places, count = dict[str, tuple[int, float]](), 0
    for joint in joints:
        reference = float(joint.attributes.get("ref", "0"))
        places[joint.attributes.get("name", "")] = count, reference
        count += _COORDINATES.get(_kind(joint), 1)
    wanted = dict[str, str]()
    if "qpos" in tag.attributes:
        angles = [float(word) for word in tag.attributes["qpos"].split()]
        if len(angles) != count:
            raise WrongUse(
                f"{model.path}: a keyframe has {len(angles)} numbers of qpos, and the joints in the file have {count}, "
                "so the rotors' angles cannot be added: export into the file with all joints, or remove the keyframe"
            )
        rotors = (sum(r * (angles[places[j][0]] - places[j][1]) for j, r in motor.row.items()) for motor in motors)
        wanted["qpos"] = " ".join([tag.attributes["qpos"].strip(), *(repr(float(angle)) for angle in rotors)])
    if "qvel" in tag.attributes:
        wanted["qvel"] = " ".join([tag.attributes["qvel"].strip(), *("0" for _ in motors)])
    return model.changed(tag, wanted)


def _kind(tag: Tag) -> str:
    return "free" if tag.path[-1] == "freejoint" else tag.attributes.get("type", "hinge")


def _beside(motors: Sequence[Motor], model: Document, names: Mapping[str, Tag]) -> Iterator[Diagnostic]:
    """Yield warnings about what in the model still acts on the joints beside the tendons."""
    moved = {name for motor in motors for name in motor.row}
    direct = [
        tag.attributes.get("name", tag.path[-1])
        for tag in model.tags
        if tag.path[1:2] == ("actuator",) and tag.attributes.get("joint", tag.attributes.get("jointinparent")) in moved
    ]
    if direct:
        yield _warning(
            f"the actuators {', '.join(direct)} still act on the joints themselves, so that no cable is between: set "
            f'joint="{_rotor(motors[0])}" and so on to drive the rotors, whose angles are those of the joints'
        )
    held = [
        f"{name} ({', '.join(own)})"
        for name in sorted(moved)
        if (own := [v for v in _OWN_VALUES if v in names[name].attributes])
    ]
    if held:
        yield _warning(
            f"the model's own values stay at {'; '.join(held)}, and act beside the cable: remove them if they stood "
            "for it"
        )
    free = [motor.name for motor in motors if not motor.inertia]
    if free:
        yield _warning(
            f"the motor's inertia of {', '.join(free)} is not known (stand.motor_inertia): their armature is a "
            f"placeholder with which they swing at {_FREE_FREQUENCY:g} Hz"
        )


def _urdf(motors: Sequence[Motor], model: Document | None) -> tuple[bytes, list[Diagnostic]]:
    """Return a URDF with damping and friction of each joint as with all motors held; URDF has no stiffness."""
    assert model is not None  # noqa: S101 - `write` has loaded it; for the type checker
    names = {tag.attributes.get("name", ""): tag for tag in model.tags if tag.path[1:] == ("joint",)}
    _require_joints(motors, names, model)
    edits = []
    for finger in fingers(motors):
        for joint in finger.joints:
            friction = sum(abs(motor.row.get(joint, 0.0)) * motor.friction.value for motor in finger.motors)
            values = {"damping": repr(finger.damping[joint, joint]), "friction": repr(friction)}
            present = [tag for tag in names[joint].inside if tag.path[-1] == "dynamics"]
            attributes = " ".join(f'{name}="{value}"' for name, value in values.items())
            edits.append(
                model.changed(present[0], values)
                if present
                else model.insertion(names[joint].end, [f"    <dynamics {attributes}/>"])
            )
    lost = _warning(
        "URDF holds each joint's damping and friction, and no stiffness: Kc, what one joint does to the next, the "
        "motors and all intervals are left out; export into a MuJoCo model (.xml) to keep Kc, or as .json"
    )
    return model.edited(edits), [lost, *_left_out(motors)]


def _priors(motors: Sequence[Motor], _model: Document | None) -> tuple[bytes, list[Diagnostic]]:
    """Return the file that mujoco.sysid's ParameterDict.load_from_disk reads: value, and the 95 % interval as bounds.

    That reads YAML, to which 2e-05 is a text: so each number has a point.
    """
    entries = []
    for motor in motors:
        parts = {"stiffness": motor.stiffness, "damping": motor.damping, "frictionloss": motor.friction}
        for kind, part in parts.items():
            if part is not None and part.value > 0.0:
                low, high = part.ci95(motor.torque_uncertainty)
                numbers = {"nominal": part.value, "min_value": low, "max_value": high, "value": part.value}
                shown = ", ".join(f'"{name}": [{number:.9e}]' for name, number in numbers.items())
                name = json.dumps(f"{_tendon(motor)}.{kind}")
                entries.append(f'  {name}: {{"name": {name}, {shown}, "frozen": false}}')
    return ("{\n" + ",\n".join(entries) + "\n}\n").encode(), _left_out(motors)


def _left_out(motors: Iterable[Motor]) -> list[Diagnostic]:
    lost = [f"{motor.name}: {', '.join(motor.further)}" for motor in motors if motor.further]
    if not lost:
        return []
    return [
        _warning(
            f"the identified couplings have terms for which a tendon has no place ({'; '.join(lost)}): a simulation "
            "with Kc, Bc and friction alone differs by these"
        )
    ]


def _warning(message: str) -> Diagnostic:
    return Diagnostic("terms-left-out", message)


def _placeholder(motor: Motor) -> float:
    stiffness = motor.stiffness or Value(1.0)
    return stiffness.value / (2.0 * math.pi * _FREE_FREQUENCY) ** 2


def _rotor(motor: Motor) -> str:
    return f"{motor.name}_rotor"


def _tendon(motor: Motor) -> str:
    return f"{motor.name}_tendon"


FORMATS: Mapping[str, HandFormat] = MappingProxyType(
    {"mujoco": HandFormat("mujoco", _mujoco), "urdf": HandFormat("robot", _urdf), "json": HandFormat(None, _priors)}
)
"""The file formats that hold a hand, by their names in `hil.exchange.exporter`."""
