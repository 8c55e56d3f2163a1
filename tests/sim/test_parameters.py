from __future__ import annotations

import ast
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from sim_backend import parameters as module
from sim_backend.parameters import SimParameters

ADAPTER = TypeAdapter(SimParameters)


def refused(table: dict[str, Any]) -> dict[tuple[int | str, ...], str]:
    with pytest.raises(ValidationError) as caught:
        ADAPTER.validate_python(table)
    return {error["loc"]: error["msg"] for error in caught.value.errors()}


def test_an_empty_table_is_the_papers_joint() -> None:
    stand = ADAPTER.validate_python({})
    assert stand == SimParameters()
    assert (stand.coupling.stiffness, stand.coupling.damping) == (17.75e-3, 0.19e-3)


def test_every_default_survives_its_own_bounds() -> None:
    assert ADAPTER.validate_python(ADAPTER.dump_python(SimParameters())) == SimParameters()


def test_all_that_is_wrong_is_reported_at_once_each_with_its_key() -> None:
    wrong = refused(
        {
            "motor": {"inertia": -1.0, "colour": "red"},
            "coupling": {"stiffness": float("nan")},
            "sensors": {"motor_counts": 0, "torque_cell_offset": float("inf")},
            "link": {"lost_reply": 1.0},
            "fixtures": {},
        }
    )
    assert set(wrong) == {
        ("motor", "inertia"),
        ("motor", "colour"),
        ("coupling", "stiffness"),
        ("sensors", "motor_counts"),
        ("sensors", "torque_cell_offset"),
        ("link", "lost_reply"),
        ("fixtures",),
    }


@pytest.mark.parametrize(
    ("table", "where", "key"),
    [
        ({"coupling": {"gap": 0.1, "slack": 0.1}}, ("coupling",), "coupling.slack"),
        ({"coupling": {"bristle_damping": 1.0}}, ("coupling",), "coupling.bristle_damping"),
        ({"link": {"reply_timeout": 1e-4}}, ("link",), "link.reply_timeout"),
        ({"link": {"watchdog": 1e-3}}, ("link",), "link.watchdog"),
        ({"drive": {"torque_limit": 1e-6}}, (), "drive.torque_limit"),
    ],
)
def test_a_combination_no_stand_can_have_is_refused_by_the_key_at_fault(
    table: dict[str, Any], where: tuple[str, ...], key: str
) -> None:
    wrong = refused(table)
    assert set(wrong) == {where}
    assert key in wrong[where]


def test_open_motor_parameters_are_the_stands_and_stated_ones_hold() -> None:
    stand = ADAPTER.validate_python({"motor": {"gear_ratio": 9.0}})
    motor = stand.resolved(gear_ratio=5.0, motor_inertia=3e-6).motor
    assert (motor.gear_ratio, motor.inertia, motor.viscous_friction) == (9.0, 3e-6, 1e-7)
    assert stand.motor.inertia is None


def listed() -> dict[str, str]:
    """Every key with its default as the page writes it."""
    found = {}
    for table in fields(SimParameters):
        for entry in fields(getattr(SimParameters(), table.name)):
            value = entry.default
            switch = {None: "[stand]", True: "true", False: "false"}
            key = f"{table.name}.{entry.name}"
            found[key] = switch[value] if value is None or isinstance(value, bool) else f"{value:g}"
    return found


def test_every_parameter_says_what_it_is_in_its_unit() -> None:
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    for table in (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name != "SimParameters"):
        for entry, after in zip(table.body, table.body[1:], strict=False):
            if isinstance(entry, ast.AnnAssign) and ast.unparse(entry.target) != "__pydantic_config__":
                assert isinstance(after, ast.Expr), ast.unparse(entry)


def test_the_page_about_the_simulator_lists_every_parameter_with_its_default() -> None:
    page = Path(__file__).parents[2] / "docs" / "simulator.md"
    rows = [line.split("|")[1:3] for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    written = {key.strip().strip("`"): default.strip() for key, default in rows}
    assert written == listed()
