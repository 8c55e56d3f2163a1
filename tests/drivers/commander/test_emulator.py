"""The emulated SimpleFOC board as the library's documentation shows it, for clients that are not ours."""

from __future__ import annotations

import pytest

from sim_backend.parameters import CouplingParameters, SimParameters
from sim_backend.wire.commander.device import MACHINE, NOTHING, ON_REQUEST, CommanderDevice

FRIENDLY = ["Motion:torque", "Torque: foc curr", "Target: 0.400"]


@pytest.fixture
def device() -> CommanderDevice:
    return CommanderDevice(SimParameters())


def typed(device: CommanderDevice, text: str) -> str:
    return "".join(device.type(character) for character in text + "\n")


@pytest.mark.parametrize(
    ("verbose", "replies"),
    [
        (
            None,
            [
                "Motion:torque",
                "Torque: foc curr",
                "Target: 0.400",
                "Limits| curr: 1.500",
                "Status: 0",
                "PID vel| P: 0.200",
            ],
        ),
        (ON_REQUEST, ["torque", "foc curr", "0.400", "1.500", "0", "0.200"]),
        (MACHINE, ["MCtorque", "MTfoc curr", "M0.400", "MLC1.500", "ME0", "MVP0.200"]),
    ],
)
def test_the_documentations_commands_are_answered_in_each_mode(
    device: CommanderDevice, verbose: int | None, replies: list[str]
) -> None:
    if verbose is not None:
        typed(device, f"@{verbose}")
    commands = ["MC0", "MT2", "M0.4", "MLC1.5", "ME0", "MVP"]
    assert [typed(device, command) for command in commands] == [f"{reply}\r\n" for reply in replies]


def test_all_states_come_in_one_line_with_the_decimals_that_were_set(device: CommanderDevice) -> None:
    typed(device, "@1")
    typed(device, "M0.5")
    assert typed(device, "MMG7").split(";")[0] == "0.500"
    assert typed(device, "#6") == "6\r\n"
    assert [len(number.strip().partition(".")[2]) for number in typed(device, "MMG7").split(";")] == [6] * 7
    assert typed(device, "MMG6") == "0.000000\r\n"
    assert typed(device, "MMG8") == "err\r\n"


def test_a_quiet_board_still_obeys_and_an_unknown_letter_is_not_answered(device: CommanderDevice) -> None:
    typed(device, f"@{NOTHING}")
    assert typed(device, "M0.25") == ""
    assert device.motion.target == 0.25
    typed(device, f"@{ON_REQUEST}")
    assert typed(device, "Q1") == ""
    assert typed(device, "?") == "M:motor\r\n"
    assert typed(device, "MX") == "err\r\n"


def test_a_command_longer_than_the_buffer_is_cut_as_the_library_cuts_it(device: CommanderDevice) -> None:
    typed(device, "@1")
    assert typed(device, "M0." + "0" * 17 + "M1") == "1.000\r\n"


def test_a_number_is_read_as_far_as_it_is_one(device: CommanderDevice) -> None:
    typed(device, "@1")
    assert [typed(device, text).strip() for text in ("M0.5x", "M-.5", "M+1e-1", "M--1")] == [
        "0.500",
        "-0.500",
        "0.100",
        "0.000",
    ]


@pytest.mark.parametrize(("mode", "target"), [(1, 4.0), (2, 0.5)])
def test_velocity_and_angle_mode_reach_their_targets(mode: int, target: float) -> None:
    loose = CouplingParameters(stiffness=1e-6, damping=0.0, coulomb_friction=0.0)
    device = CommanderDevice(SimParameters(coupling=loose))
    motor = device.motor
    typed(device, f"MC{mode}")
    typed(device, f"M{target}")
    motor.run(1.0)
    assert (motor.velocity if mode == 1 else device.motion.angle(motor)) == pytest.approx(target, rel=0.01)


def test_a_disabled_motor_repeats_its_last_current_and_carries_none(device: CommanderDevice) -> None:
    motor = device.motor
    typed(device, "M0.2")
    motor.run(0.05)
    typed(device, "ME0")
    motor.run(0.1)
    assert motor.law.current(motor) == pytest.approx(0.2, abs=2e-3)
    assert motor.torque == 0.0


@pytest.mark.parametrize(("version", "carried"), [((2, 3), 0.3), ((2, 4), 0.1)])
def test_the_current_limit_bounds_a_torque_target_since_library_2_4_only(
    version: tuple[int, int], carried: float
) -> None:
    device = CommanderDevice(SimParameters(), version=version)
    for command in ("MLC0.1", "M0.3"):
        typed(device, command)
    device.motor.run(0.02)
    assert device.motion.current(device.motor) == pytest.approx(carried, abs=3e-3)
