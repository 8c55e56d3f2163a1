"""The whole way: a chirp through the emulated SimpleFOC board and torque cell in device timing, and Kc and Bc of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.loadcell.config import LoadCellConfig
from drivers.loadcell.sensor import LoadCell
from drivers.servo import Quantity, Servo
from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse as model
from hil.acquisition import excitation
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.recorder import Recorder, tick_count
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.writer import Header, RecordingWriter
from hil.stand.file import parse
from hil.stand.servo import StandServo
from sim_backend.parameters import CouplingParameters, FixtureParameters, SimParameters
from sim_backend.wire.loadcell.emulator import SCALE, SETTLING, EmulatedLoadCell, LoadCellBoard

from ...loopback import SerialLoopback

STAND = """
[stand]
torque_stays_on_if_host_dies = true
gear_ratio = 4.0
motor_inertia = 2.0e-7
motor_damping = 1.0e-7
torque_source = "{source}"
[limits]
torque = 0.03
deflection = 1.5
velocity = 100.0
temperature = 80.0
"""
KC, BC = 17.75e-3, 0.19e-3
SHARE = FixtureParameters().stiffness / (FixtureParameters().stiffness + KC)  # of a deflection that the cable takes
ETA, RATE, DURATION = 4.0, 250.0, 4.0
PLANT = SimParameters(coupling=CouplingParameters(stiffness=KC, damping=BC, coulomb_friction=0.0))
COUNT = 2.0 * math.pi / PLANT.sensors.motor_counts / ETA  # rad at the joint
CURRENT = PLANT.sensors.current_lsb * PLANT.motor.torque_constant * ETA  # N m at the joint


def chirped(servo: Servo, source: str, band: tuple[float, float], path: Path) -> Identification:
    text = STAND.format(source=source)
    profile = excitation.make(
        "chirp",
        Quantity.TORQUE,
        amplitude=0.01,
        default_amplitude=0.01,
        duration=DURATION,
        band=band,
        rate=RATE,
        seed=0,
    )
    header = Header(profile=profile.attributes() | {"rate": RATE}, stand_toml=text)
    part = RecordingWriter(path, header, tick_count(profile, RATE))
    outcome = Recorder(parse(text), servo, profile, RATE, part).run(StopRequest())
    servo.close()
    part.finish(outcome.end_reason)
    part.close()
    assert (outcome.end_reason, outcome.lost, outcome.late) == ("done", 0, 0)
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    return identify([path], model("linear+offset+skew"), search)


def held_to_theory(found: Identification, torque_count: float, period: float = 0.0) -> None:
    """Kc and Bc are the truth within what counts and a cell's period, s, allow, whatever the signs of the errors.

    A torque is off by half a count, a deflection by half a count, which Kc turns into torque, and a reading that is
    held for a period is by half of it older or younger than on average. Least squares passes on no more than the sum of
    its weights' magnitudes times these; a skew's effect on the torque is a column of its own.
    """
    motion = found.signals.motion
    rate = found.signals.motion.dtheta_dot
    late = KC * rate + BC * np.gradient(rate, motion.time)
    design = np.column_stack([found.signals.motion.dtheta, rate, np.ones_like(rate), late])
    worst = np.abs(np.linalg.pinv(design)) @ (0.5 * (torque_count + KC * COUNT + period * np.abs(late)))
    value = {estimate.name: estimate.value for estimate in found.estimates}
    assert worst[0] < 0.03 * KC
    assert value["Kc"] == pytest.approx(KC * SHARE, abs=worst[0])
    assert value["Bc"] == pytest.approx(BC * SHARE**2, abs=worst[1])
    # in fact the roundings of thousands of samples cancel
    assert value["Kc"] == pytest.approx(KC * SHARE, rel=0.003)
    assert value["Bc"] == pytest.approx(BC * SHARE**2, rel=0.03)


def test_a_chirp_through_a_simplefoc_board_gives_stiffness_and_damping_back(
    make_foc: Callable[..., Any], tmp_path: Path
) -> None:
    rig = make_foc(parameters=PLANT)
    held_to_theory(chirped(rig.open(), "motor", (0.1, 10.0), tmp_path / "run.h5"), CURRENT)


def with_cell(rig: Any, board: LoadCellBoard) -> Servo:
    servo = rig.open()
    port = SerialLoopback(EmulatedLoadCell(board, rig.bus, now=rig.clock.now()), rig.clock, board.baudrate)
    config = LoadCellConfig(port="loopback", scale=SCALE, baudrate=board.baudrate)
    return StandServo(servo, 0.0, LoadCell(config, clock=rig.clock, port=port))


def test_a_fast_torque_cell_at_the_joint_gives_stiffness_and_damping_back(
    make_foc: Callable[..., Any], tmp_path: Path
) -> None:
    servo = with_cell(make_foc(parameters=PLANT), LoadCellBoard(rate=1000.0, baudrate=921_600))
    held_to_theory(chirped(servo, "joint", (0.1, 10.0), tmp_path / "run.h5"), SCALE, period=1e-3)


def test_a_slow_torque_cell_gives_the_stiffness_back_and_no_damping(
    make_foc: Callable[..., Any], tmp_path: Path
) -> None:
    """80 readings a second, each the mean over 50 ms: of a sine at 1 Hz sinc(0.05) is left, 0.4 % too little."""
    highest, board = 1.0, LoadCellBoard()
    servo = with_cell(make_foc(parameters=PLANT), board)
    found = chirped(servo, "joint", (0.1, highest), tmp_path / "run.h5")
    kc = next(estimate.value for estimate in found.estimates if estimate.name == "Kc")
    missing = 1.0 - np.sinc(highest * SETTLING / board.rate)
    assert KC * SHARE * (1.0 - missing - 0.001) < kc < KC * SHARE * 1.001
