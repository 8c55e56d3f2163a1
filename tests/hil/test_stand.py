"""The stand file: every problem at once, each with its key; limits that no option can raise."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.stand import SIMULATED, check_backend, load, open_servo, parse
from sim_backend.parameters import SimParameters


def test_the_built_in_stand_is_the_papers_joint() -> None:
    stand = parse(SIMULATED)
    servo, truth = open_servo(stand, seed=0, realtime=False)
    servo.close()
    assert stand.stand.torque_source == "joint"
    assert (truth["Kc"], truth["Bc"], truth["gear_ratio"]) == (17.75e-3, 0.19e-3, 4.0)
    assert (truth["motor_inertia"], truth["motor_damping"]) == (2.0e-7, 1.0e-7)


def test_a_file_with_only_a_stand_is_enough_to_import() -> None:
    stand = parse("[stand]\ngear_ratio = 6.0\n")
    assert stand.stand.gear_ratio == 6.0
    with pytest.raises(WrongUse, match="sets no limits"):
        stand.checked_limits()


def test_the_simulator_has_the_motor_the_stand_states_unless_it_is_told_its_own() -> None:
    text = '[stand]\nbackend = "sim"\ngear_ratio = 6.0\nmotor_inertia = 5e-7\n'
    _, truth = open_servo(parse(text), seed=0, realtime=False)
    assert (truth["gear_ratio"], truth["motor_inertia"]) == (6.0, 5e-7)
    _, truth = open_servo(parse(text + "[sim.motor]\ninertia = 9e-7\n"), seed=0, realtime=False)
    assert (truth["gear_ratio"], truth["motor_inertia"]) == (6.0, 9e-7)


def test_every_problem_of_a_file_is_reported_at_once_with_its_key(tmp_path: Path) -> None:
    path = tmp_path / "stand.toml"
    path.write_text(
        """
        [stand]
        gear_ratio = -4.0
        torque_source = "elbow"
        colour = "red"
        [limits]
        torque = "much"
        deflection = nan
        [sim.coupling]
        stiffness = -1.0
        sitffness = 2.0
        [sim.sensors]
        motor_counts = 2.5
        [valve]
        """
    )
    with pytest.raises(WrongUse) as refusal:
        load(path)
    said = str(refusal.value)
    for key in (
        "stand.gear_ratio",
        "stand.torque_source",
        "stand.colour: no such key",
        "limits.torque",
        "limits.deflection",
        "limits.velocity: must be given",
        "sim.coupling.stiffness",
        "sim.coupling.sitffness: no such key",
        "sim.sensors.motor_counts",
        "valve: no such key",
    ):
        assert key in said
    assert "10 problem(s)" in said


def test_every_parameter_of_the_simulator_can_be_set_in_its_table() -> None:
    from dataclasses import fields

    lines = []
    for table in fields(SimParameters):
        lines.append(f"[sim.{table.name}]")
        defaults = getattr(SimParameters(), table.name)
        for parameter in fields(defaults):
            value = getattr(defaults, parameter.name)
            if value is not None:
                lines.append(f"{parameter.name} = {str(value).lower() if isinstance(value, bool) else value!r}")
    assert parse("[stand]\n" + "\n".join(lines)).sim == SimParameters()
    assert len(lines) > 45


@pytest.mark.parametrize(
    ("name", "said"),
    [("simm", "did you mean 'sim'"), ("valve", "known are sim"), (None, "names no backend")],
)
def test_an_unknown_backend_is_refused_with_the_known_ones(name: str | None, said: str) -> None:
    with pytest.raises(WrongUse, match=said):
        check_backend(name)


@pytest.mark.parametrize(("text", "said"), [(b"[stand\n", "not TOML"), (b"\xff\xfe", "cannot be read")])
def test_what_is_no_toml_is_refused(tmp_path: Path, text: bytes, said: str) -> None:
    path = tmp_path / "stand.toml"
    path.write_bytes(text)
    with pytest.raises(WrongUse, match=said):
        load(path)
