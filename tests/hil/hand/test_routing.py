"""Matrices of fingers from motors and a routing: against closed forms, energies, draws and files of others."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.hand.routing import Finger, Motor, Value, as_json, finger, fingers, read

Array = NDArray[np.float64]
JOINTS = ("mcp", "pip", "dip")
BASE = Motor(
    "flexor", "mcp", Value(0.02, 2e-4), Value(2e-4, 4e-6), turns={"pip": 0.7, "dip": -0.4}, turns_uncertainty=0.03,
    torque_uncertainty=0.02, drive="xl330",
)  # fmt: skip
MOTORS = (
    BASE,
    replace(BASE, name="extensor", stiffness=Value(0.03, 1e-4), damping=Value(1e-4, 5e-6), turns={"pip": -0.5}),
    replace(BASE, name="pip", joint="pip", stiffness=Value(0.01, 1e-4), turns={"dip": 0.9}, drive="st3215"),
    replace(BASE, name="dip", joint="dip", stiffness=Value(0.015, 3e-4), turns={}),
)


def entries(of: Finger) -> Array:
    return np.concatenate([np.ravel(of.stiffness.values), np.ravel(of.damping.values)])


def drawn(generator: np.random.Generator) -> tuple[Motor, ...]:
    """The motors of a hand for which MOTORS is an estimate: errors of each kind drawn as their definitions say."""
    scales = {drive: 1.0 + 0.02 * generator.standard_normal() for drive in ("xl330", "st3215")}

    def value(of: Value | None, scale: float) -> Value:
        assert of is not None
        return Value(scale * of.value + of.error * generator.standard_normal())

    return tuple(
        replace(
            motor,
            stiffness=value(motor.stiffness, scales[motor.drive]),
            damping=value(motor.damping, scales[motor.drive]),
            turns={name: turns * (1.0 + 0.03 * generator.standard_normal()) for name, turns in motor.turns.items()},
        )
        for motor in MOTORS
    )


def test_the_stiffness_is_the_curvature_of_the_energy_in_the_tendons() -> None:
    """Not by the routing's product: the energy of each tendon by its stretch, differentiated twice."""

    def energy(angles: dict[str, float]) -> float:
        stretches = [
            angles[one.joint] + sum(angles[name] * turns for name, turns in one.turns.items()) for one in MOTORS
        ]
        stiff = [one.stiffness.value for one in MOTORS if one.stiffness]
        return 0.5 * sum(k * stretch**2 for k, stretch in zip(stiff, stretches, strict=True))

    whole = finger(MOTORS)
    assert whole.joints == JOINTS
    for row in JOINTS:
        for column in JOINTS:
            bent = {name: float(name == row) + float(name == column) for name in JOINTS}
            single = [{name: float(name == joint) for name in JOINTS} for joint in (row, column)]
            curvature = energy(bent) - sum(energy(one) for one in single)  # exact for a quadratic energy
            assert whole.stiffness[row, column] == pytest.approx(curvature, rel=1e-12)
    assert whole.stiffness["mcp", "pip"] == pytest.approx(0.02 * 0.7 - 0.03 * 0.5)  # the closed form of one entry
    assert whole.damping["dip", "dip"] == pytest.approx(2e-4 * (0.4**2 + 0.9**2 + 1.0))


def test_the_covariance_of_all_entries_is_that_of_draws_and_the_intervals_hold_95_in_100() -> None:
    generator = np.random.default_rng(1)
    whole, count = finger(MOTORS), 4000
    draws = np.array([entries(finger(drawn(generator))) for _ in range(count)])
    spread = np.sqrt(np.diag(whole.covariance))
    assert draws.std(axis=0) == pytest.approx(spread, rel=0.05)
    correlation = whole.covariance / np.outer(spread, spread)
    assert np.corrcoef(draws.T) == pytest.approx(correlation, abs=0.06)
    ends = np.concatenate([np.reshape(part.ci95, (-1, 2)) for part in (whole.stiffness, whole.damping)])
    inside = (ends[:, 0] <= draws) & (draws <= ends[:, 1])
    assert inside.mean(axis=0) == pytest.approx(0.95, abs=0.015)


def test_motors_of_one_kind_of_drive_share_the_error_of_the_torque_scale() -> None:
    alike = replace(BASE, stiffness=Value(0.02), turns={}, turns_uncertainty=0.0)
    same = finger([alike, replace(alike, name="b")]).stiffness.ci95[0, 0]
    apart = finger([alike, replace(alike, name="b", drive="st3215")]).stiffness.ci95[0, 0]
    assert np.ptp(same) == pytest.approx(2 * 1.96 * 0.02 * 0.04, rel=1e-3)
    assert np.ptp(same) / np.ptp(apart) == pytest.approx(math.sqrt(2.0))


def test_a_hand_falls_into_fingers_by_its_tendons_and_an_unknown_value_spoils_only_what_it_enters() -> None:
    thumb = replace(BASE, name="thumb", joint="thumb", turns={})
    late = replace(BASE, name="late", joint="wrist", turns={"thumb": 0.1})
    assert [[one.name for one in group.motors] for group in fingers([*MOTORS, thumb, late])] == [
        ["flexor", "extensor", "pip", "dip"], ["thumb", "late"],
    ]  # fmt: skip
    [known, single] = fingers([replace(MOTORS[2], stiffness=None), MOTORS[3], thumb])
    assert [math.isnan(number) for number in np.ravel(known.stiffness.values)] == [True] * 4
    assert np.isfinite(np.asarray(known.damping)).all()
    assert tuple(single.stiffness.ci95[0, 0]) == pytest.approx(Value(0.02, 2e-4).ci95(0.02))
    [partly] = fingers([MOTORS[0], replace(MOTORS[3], damping=None)])
    assert np.isnan(partly.damping.values).tolist() == [[False] * 3, [False, True, False], [False] * 3]
    assert json.loads(json.dumps(partly.as_json(), allow_nan=False))["damping"]["values"][1][1] is None
    with pytest.raises(KeyError, match="did you mean 'dip'"):
        partly.stiffness["dib", "dip"]


def test_motors_return_from_their_file_and_what_is_no_motor_is_refused_with_its_place(tmp_path: Path) -> None:
    table = {"motors": as_json(MOTORS)}
    (tmp_path / "hand.json").write_text(json.dumps(table))
    assert read(tmp_path) == MOTORS
    table["motors"][1]["stiffness"]["value"] = math.inf
    for wrong, said in ((table, "1.stiffness.value"), ({"motors": []}, "0 motors"), ([], "no motors of a hand: write")):
        (tmp_path / "hand.json").write_text(json.dumps(wrong))
        with pytest.raises(WrongUse, match=said):
            read(tmp_path)
