"""The motors and the fingers of a hand, from the results of its campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ga.model.terms import of_kind
from hil.campaign import results
from hil.campaign.journal import kept_result
from hil.campaign.plan import Plan
from hil.exchange.coupling import unrepresented
from hil.hand.file import HandJoint
from hil.hand.routing import Finger, JointMatrix, Motor, Value, as_json, fingers
from hil.report.formatting import Section, people_unit, rounded_with_value
from hil.signals.constants import NORMAL


def motors(plan: Plan, found: results.Results) -> list[Motor]:
    """Return the motors of the plan's hand with what was identified of each; [] if the plan is not that of a hand."""
    lines = {line.joint: line for line in found.lines}
    joints = () if plan.hand is None else plan.hand.joints
    return [_motor(joint, plan, lines[joint.name]) for joint in joints if joint.name in lines]


def hand_json(identified: Sequence[Motor]) -> dict[str, Any]:
    """Return the motors and the fingers' matrices, for the file of the hand's results; {} without a motor."""
    if not identified:
        return {}
    return {"motors": as_json(identified), "fingers": [finger.as_json() for finger in fingers(identified)]}


def sections(identified: Sequence[Motor]) -> list[Section]:
    """Return a section of a page for each finger that tendons connect, with both matrices and their intervals."""
    return [_section(finger) for finger in fingers(identified) if len(finger.motors) > 1]


def _section(finger: Finger) -> Section:
    rows = [["", *finger.joints], *_rows("K", finger.stiffness), *_rows("B", finger.damping)]
    text = "The torque at the joint of a row for a deflection or rate at that of a column, all motors held."
    if (finger.stiffness.values < 0.0).any():
        text += " A negative entry: one joint's deflection pulls the next the opposite way."
    return Section(f"The finger of {', '.join(finger.joints)}, with 95 % intervals", rows, [text])


def _rows(name: str, matrix: JointMatrix) -> list[list[str]]:
    """Return a row for each joint: its name with that of the matrix and the unit, and the entries."""
    largest = np.nanmax(np.abs(matrix.values), initial=0.0)
    factor, unit = people_unit(matrix.unit, milli=bool(largest < 1.0))
    half = 0.5 * factor * (matrix.ci95[..., 1] - matrix.ci95[..., 0])
    rows = []
    for joint, values, halves in zip(matrix.joints, factor * matrix.values, half, strict=True):
        cells = [" ± ".join(rounded_with_value(*pair)) for pair in zip(halves, values, strict=True)]
        unknown = np.isnan(values)
        rows.append([f"{name} {joint}, {unit}", *np.where(unknown, "not known", cells).tolist()])
    return rows


def _motor(joint: HandJoint, plan: Plan, line: results.Line) -> Motor:
    stand, names = joint.stand, {"Kc": "stiffness", "Bc": "damping"}
    values = {
        kind: Value(line.values[name].value, line.values[name].error) if name in line.values else None
        for name, kind in names.items()
    }
    settings = plan.settings
    kept = [kept_result(one.run, settings.model, settings.trials) for one in line.measured if one.values]
    tables = [table for table in kept if table is not None]
    sim = stand.simulated().motor if stand.stand.backend == "sim" else None
    inertia = (sim.inertia if sim else stand.stand.motor_inertia) or 0.0
    damping = (sim.viscous_friction if sim else stand.stand.motor_damping) or 0.0
    device = stand.devices.get(str(stand.stand.backend))
    return Motor(
        joint.name,
        joint.moves,
        values["stiffness"],
        values["damping"],
        friction=_friction([table["parameters"] for table in tables]),
        turns=dict(joint.also_moves),
        turns_uncertainty=joint.routing_uncertainty,
        torque_uncertainty=max((one.torque_uncertainty for one in line.values.values()), default=0.0),
        drive=f"{stand.stand.backend} {getattr(device, 'model', '')}".strip(),
        inertia=inertia * stand.stand.gear_ratio**2,
        motor_damping=damping * stand.stand.gear_ratio**2,
        further=tuple(dict.fromkeys(term for table in tables for term in unrepresented(str(table["model"])))),
    )


def _friction(tables: Sequence[Mapping[str, Any]]) -> Value:
    """Return the dry friction of a joint, N m: the mean over its recordings, with the largest of their errors and of
    their spread.
    """
    values, errors = [0.0], [0.0]
    if tables:
        parts = [[table[name] for name in of_kind(table, "dry friction")] for table in tables]
        values = [sum(float(part["value"]) for part in each) for each in parts]
        ends = [[part.get("ci95_without_torque_scale", part["ci95"])[1] for part in each] for each in parts]
        highs = [sum(high for high in each if high is not None) for each in ends]
        errors = [max(high - value, 0.0) / NORMAL for high, value in zip(highs, values, strict=True)]
    return Value(float(np.mean(values)), max(float(np.max(errors)), float(np.std(values))))
