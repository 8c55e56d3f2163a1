"""The stand file: every problem at once, each with its key; limits that no option can raise."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import get_type_hints

import pytest
from pydantic import TypeAdapter, ValidationError

from drivers.dynamixel.config import DynamixelConfig, Mode
from drivers.moteus.config import MoteusConfig
from drivers.servo import Quantity
from hil.errors import WrongUse
from hil.quantities import physical
from hil.stand.devices import BACKENDS, SENSORS, Device, check_backend
from hil.stand.fault_file import load_plan
from hil.stand.file import SIMULATED, load, parse
from hil.stand.opening import open_servo
from hil.units import dimension_of
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


def test_the_simulator_has_the_motor_of_the_stand_unless_it_has_its_own() -> None:
    _, truth = open_servo(parse('[stand]\nbackend = "sim"\n'), seed=0, realtime=False)
    assert truth["gear_ratio"] == 1.0  # the stand's, even where it is not stated
    text = '[stand]\nbackend = "sim"\ngear_ratio = 6.0\nmotor_inertia = 5e-7\n'
    _, truth = open_servo(parse(text), seed=0, realtime=False)
    assert (truth["gear_ratio"], truth["motor_inertia"]) == (6.0, 5e-7)
    _, truth = open_servo(parse(text + "[sim.motor]\ninertia = 9e-7\n"), seed=0, realtime=False)
    assert (truth["gear_ratio"], truth["motor_inertia"]) == (6.0, 9e-7)


def test_a_value_may_carry_its_unit() -> None:
    limits = 'torque = "30 mN*m"\ndeflection = "60 deg"\nvelocity = "100 rpm"\ntemperature = "80 degC"\n'
    stand = parse(f'[stand]\nmotor_inertia = "2 g*cm^2"\nzero = "90 deg"\n[limits]\n{limits}')
    assert stand.stand.motor_inertia == pytest.approx(2e-7)
    assert stand.stand.zero == pytest.approx(math.pi / 2.0)
    found = stand.checked_limits()
    assert (found.torque, found.temperature) == pytest.approx((0.03, 80.0))
    assert (found.deflection, found.velocity) == pytest.approx((math.pi / 3.0, math.pi * 10.0 / 3.0))


def test_every_error_is_said_at_once_with_its_key_in_a_sentence_of_our_own() -> None:
    text = """
        [stand]
        gear_ratio = "four"
        name = 3
        torque_stays_on_if_host_dies = "perhaps"
        torque_source = "elbow"
        motor_inertia = "2 g"
        colour = "red"
        [limits]
        torque = -1
        deflection = inf
        velocity = [1]
        [sim]
        coupling = 3
        [sim.sensors]
        motor_counts = 2.5
        [valve]
    """
    with pytest.raises(WrongUse) as refusal:
        parse(text)
    for said in (
        "stand.gear_ratio = 'four': must be a number",
        "stand.name = 3: must be a text in quotation marks",
        "stand.torque_stays_on_if_host_dies = 'perhaps': must be true or false",
        "stand.torque_source = 'elbow': must be 'motor' or 'joint'",
        "stand.motor_inertia: '2 g': 'g' is not a unit of inertia",
        "limits.torque = -1: must be above 0",
        "limits.deflection = inf: must be a finite number",
        "limits.velocity = [1]: must be a number",
        "sim.coupling = 3: must be a table",
        "sim.sensors.motor_counts = 2.5: must be a whole number",
        "stand.colour: no such key",
        "valve: no such key",
        "12 error(s)",
    ):
        assert said in str(refusal.value)
    assert "Input should" not in str(refusal.value)


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ("limits", "torque"),
        ("stand", "gear_ratio"),
        ("dynamixel", "id"),
        ("dynamixel", "sign"),
        ("dynamixel", "baudrate"),
        ("winding", "resistance"),
        ("sim.sensors", "motor_counts"),
    ],
)
def test_true_is_no_number(table: str, key: str) -> None:
    with pytest.raises(WrongUse, match=f"{table}.{key}: true is not a number"):
        parse(f"[{table}]\n{key} = true\n")


def test_of_many_errors_the_first_are_listed(tmp_path: Path) -> None:
    plan = tmp_path / "faults.toml"
    plan.write_text(f"[[fault]]\n{'k' * 6000} = 1\n" * 100)
    for refused in (lambda: load_plan(plan), lambda: parse("[stand]\n" + "".join(f"k{n} = 1\n" for n in range(300)))):
        with pytest.raises(WrongUse, match=r"has \d00 error\(s\)") as refusal:
            refused()
        assert len(str(refusal.value)) < 5000
        assert str(refusal.value).endswith("80 more")


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
    ("name", "message"), [("simm", "did you mean 'sim'"), ("valve", "known are sim"), (None, "has no backend")]
)
def test_an_unknown_backend_is_refused_with_the_known_ones(name: str | None, message: str) -> None:
    with pytest.raises(WrongUse, match=message):
        check_backend(name)


def test_a_backends_own_table_is_checked_with_the_rest_of_the_file() -> None:
    text = """
    [stand]
    gear_ratio = 0.0
    backend = "dynamixel"
    [dynamixel]
    model = "xl333"
    id = 300
    bauderate = 57600
    """
    with pytest.raises(WrongUse, match=r"5 error\(s\)") as refusal:
        parse(text)
    message = str(refusal.value)
    for key in ("stand.gear_ratio", "dynamixel.port: must be given", "dynamixel.model = 'xl333'", "dynamixel.id = 300"):
        assert key in message
    assert "dynamixel.bauderate: no such key" in message


def test_keys_that_do_not_fit_each_other_are_all_named() -> None:
    table = 'port = "p"\nmodel = "xl430-w250"\nmode = "current"\nwatchdog = 0.01\n'
    with pytest.raises(WrongUse, match=r"dynamixel\.mode.+no current control; dynamixel\.watchdog"):
        parse(f"[stand]\n[dynamixel]\n{table}")


def test_a_backend_without_its_table_is_refused_with_what_the_table_must_hold() -> None:
    stand = parse('[stand]\nbackend = "dynamixel"\n')
    with pytest.raises(WrongUse, match=r"no \[dynamixel\]: add it with at least port, model"):
        open_servo(stand)


@pytest.mark.parametrize("device", [*BACKENDS.values(), *SENSORS.values()], ids=[*BACKENDS, *SENSORS])
def test_a_device_of_the_registry_can_be_loaded_and_forbids_unknown_keys(device: Device) -> None:
    with pytest.raises(ValidationError) as refusal:
        TypeAdapter(device.table_class()).validate_python({"no_such_key": 1})
    assert any(error["loc"] == ("no_such_key",) for error in refusal.value.errors())
    if device.opener:
        module, name = device.opener.split(":")
        assert callable(getattr(import_module(module), name))


@pytest.mark.parametrize(
    ("model", "mode", "quantity", "expected"),
    [
        ("xl330-m288", None, Quantity.TORQUE, "current"),
        ("xl330-m288", None, Quantity.POSITION, "current-based-position"),
        ("xl330-m288", "extended-position", Quantity.POSITION, "extended-position"),
        ("xl430-w250", None, Quantity.POSITION, "extended-position"),
    ],
)
def test_the_set_points_select_the_mode_of_a_dynamixel(
    model: str, mode: Mode | None, quantity: Quantity, expected: str
) -> None:
    assert DynamixelConfig(port="p", model=model, mode=mode).for_quantity(quantity).mode == expected


def test_the_set_points_select_the_mode_of_a_moteus_that_leaves_it_open() -> None:
    table = MoteusConfig(interface="socketcan", channel="can0")
    for quantity in Quantity:
        chosen = table.for_quantity(quantity)
        assert (chosen.mode, chosen.quantity, chosen.for_quantity(quantity)) == (quantity.value, quantity, chosen)
    with pytest.raises(ValueError, match="does not command position"):
        table.for_quantity(Quantity.TORQUE).for_quantity(Quantity.POSITION)


@pytest.mark.parametrize(
    ("table", "quantity", "message"),
    [
        ('model = "xl430-w250"', Quantity.TORQUE, "no current control"),
        ('model = "xl330-m288"\nmode = "current"', Quantity.POSITION, "does not command position"),
    ],
)
def test_set_points_that_a_drive_does_not_accept_are_refused_before_its_port_is_opened(
    table: str, quantity: Quantity, message: str
) -> None:
    stand = parse(f'[stand]\nbackend = "dynamixel"\n[dynamixel]\nport = "/dev/none"\n{table}\n')
    with pytest.raises(WrongUse, match=message):
        open_servo(stand, quantity=quantity)


@pytest.mark.parametrize(("text", "message"), [(b"[stand\n", "not TOML"), (b"\xff\xfe", "cannot be read")])
def test_what_is_no_toml_is_refused(tmp_path: Path, text: bytes, message: str) -> None:
    path = tmp_path / "stand.toml"
    path.write_bytes(text)
    with pytest.raises(WrongUse, match=message):
        load(path)


PURE = {"gear_ratio", "static_friction_ratio", "hysteresis_exponent", "lost_reply", "torque_uncertainty"} | {
    "torque_scale",
    "scale",  # N m for a count, or for whatever a cell prints
    "tare",
}
"""Keys that are numbers without a unit."""


def numbers(kind: type) -> dict[str, object]:
    hints = get_type_hints(kind, include_extras=True)
    return {key: hint for key, hint in hints.items() if "float" in str(hint) and not key.startswith("_")}


@pytest.mark.parametrize("name", [*BACKENDS, *SENSORS])
def test_every_physical_key_of_a_device_names_its_unit(name: str) -> None:
    """So that a person may write "100 ms" wherever a number of seconds stands."""
    table = (BACKENDS.get(name) or SENSORS[name]).table_class()
    units = list(physical(table))
    tables = {owner for owner, _, _ in units} | {table}
    known = {(owner, key) for owner, key, _ in units}
    assert all(dimension_of(unit) for _, _, unit in units)
    bare = {key for owner in tables for key in numbers(owner) if (owner, key) not in known}
    assert bare <= PURE


def test_a_drive_and_the_simulator_take_values_with_units() -> None:
    stand = parse(
        '[stand]\n[dynamixel]\nport = "p"\nmodel = "xl330-m288"\nreturn_delay = "508 us"\nwatchdog = "100 ms"\n'
        'torque_constant = "400 mN*m/A"\n[sim.drive]\ntorque_limit = "0.5 N m"\nsupply_voltage = "12000 mV"\n'
        '[sim.motor]\nwinding_resistance = "8.7 ohm"\n[sim.coupling]\nstiffness = "17.75 mN*m/rad"\n'
    )
    servo, sim = stand.devices["dynamixel"], stand.sim
    assert (servo.return_delay, servo.watchdog, servo.torque_constant) == (508e-6, 0.1, 0.4)
    assert (sim.drive.torque_limit, sim.drive.supply_voltage) == (0.5, 12.0)
    assert (sim.motor.winding_resistance, sim.coupling.stiffness) == (8.7, 0.01775)


def test_a_wrong_unit_is_refused_with_its_line_its_key_and_the_dimension() -> None:
    with pytest.raises(WrongUse) as refusal:
        parse(
            '[stand]\n\n[sim.coupling]\nsitffness = 1\ngap = "1 mm"\n[mit]\nwatchdog = "5 V"\ninterface = "virtual"\n'
        )
    said = str(refusal.value).splitlines()
    assert "  line 4: sim.coupling.sitffness: no such key; did you mean 'stiffness'?" in said
    assert "  line 5: sim.coupling.gap: '1 mm': 'mm' is not a unit of angle; write '10 mrad'" in said
    assert "  line 7: mit.watchdog: '5 V': 'V' is not a unit of time; write '10 ms'" in said
    assert "  line 6: mit.channel: must be given" in said
