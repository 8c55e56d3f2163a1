"""The emulated SimpleFOC board as the library's documentation shows it, for clients that are not ours."""

from __future__ import annotations

import pytest

from sim_backend.parameters import CouplingParameters, SimParameters
from sim_backend.wire.commander.device import CommanderDevice
from sim_backend.wire.commander.emulator import CommanderTiming, new_board
from sim_backend.wire.commander.printer import MACHINE, NOTHING, ON_REQUEST

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


WARNING = "Warn: \\r detected! \n"


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("M\r", WARNING * 3),  # looked at as the end, as a target, and as a value
        ("ME1\r", WARNING + "Status: 1\r\n"),
        ("ME\r", WARNING * 3 + "Status: 1\r\n"),
        ("M0.4\r", WARNING + "Target: 0.400\r\n"),
        ("M0.4\r\n", WARNING + "Target: 0.400\r\n"),
        ("@\r", WARNING * 2 + "Verb:on!\r\n"),
        ("#\r", WARNING * 2 + "Decimal:3\r\n"),
    ],
)
def test_a_carriage_return_ends_a_command_and_is_warned_of_at_every_look(
    device: CommanderDevice, command: str, reply: str
) -> None:
    assert "".join(device.type(character) for character in command) == reply


def test_only_the_friendly_mode_warns_of_a_carriage_return(device: CommanderDevice) -> None:
    for verbose in (ON_REQUEST, MACHINE):
        typed(device, f"@{verbose}")
        assert "Warn" not in "".join(device.type(character) for character in "ME\r")


@pytest.mark.parametrize(("verbose", "reply"), [(1, ""), (2, ""), (3, "M0.000\r\n")])
def test_the_bare_letter_of_a_motor_prints_its_target_in_the_machine_mode_only(
    device: CommanderDevice, verbose: int, reply: str
) -> None:
    typed(device, f"@{verbose}")
    assert typed(device, "M") == reply


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("MLX", "Limits| err"),
        ("MVX", "PID vel| err"),
        ("MSX", "Sensor | err"),
        ("MWX", "PWM Mod | err"),
        ("MWC", "PWM Mod | center: 1"),
        ("MR", "R phase: 0"),
        ("MR0.5", "R phase: 0.500"),
        ("MM#2", "Monitor | decimal: 2"),
        ("MMX", "Monitor | err"),
        ("MMS0001011", "Monitor | 0001011"),
        ("MMS", "Monitor | 1100011"),
        ("MMC", "Monitor | clear"),
        ("MMD50", "Monitor | downsample: 50"),
        ("MCD3", "Motion: downsample: 3"),
        ("MC4", "Motion:angle open"),
        ("MT3", "Torque: est. curr"),
        ("MT9", "Torque: volt"),
        ("MFX", "MOT | err"),
        ("MXX", "unknown cmd err"),
    ],
)
def test_other_commands_are_answered_in_the_librarys_words(device: CommanderDevice, command: str, reply: str) -> None:
    assert typed(device, command) == f"{reply}\r\n"


@pytest.mark.parametrize("mode", [1, 2])
def test_a_target_does_not_outlive_its_kind_of_motion_since_library_2_4(mode: int) -> None:
    kept = CommanderDevice(SimParameters(), version=(2, 3))
    dropped = CommanderDevice(SimParameters(), version=(2, 4))
    for device in (kept, dropped):
        typed(device, "M0.4")
        typed(device, f"MC{mode}")
    assert kept.motion.target == pytest.approx(0.4)
    assert dropped.motion.target == 0.0


def test_the_monitor_prints_by_itself_once_it_has_a_downsample() -> None:
    board = new_board(timing=CommanderTiming())
    board.receive(b"MMS0000011\n", 0.0)
    assert board.due() == float("inf")
    board.receive(b"MMD100\n", 0.1)
    loop = CommanderTiming().loop
    lines = board.receive(b"", 0.1 + 1000 * loop + 1e-3)
    assert len(lines) == 10
    assert all(line == b"0.0000\t0.0000\r\n" for _, line in lines)
    board.receive(b"MMD0\n", 0.3)
    assert board.receive(b"", 0.5) == []
    board.receive(b"MMD100\n", 0.6)
    assert len(board.receive(b"", 0.6 + 100 * loop + 1e-3)) == 1  # none from the time in between


def test_a_stream_that_the_line_cannot_carry_slows_the_program_down() -> None:
    board = new_board(timing=CommanderTiming(), baudrate=9600)
    board.receive(b"MMS1111111\n", 0.0)
    board.receive(b"MMD1\n", 0.2)
    bytes_ = sum(len(piece) for _, piece in board.receive(b"", 1.2))
    assert 0.8 * 960 < bytes_ < 1.1 * 960
