"""The whole way: a chirp of positions through an emulated servo with a torque cell at the joint, and its Kc and Bc."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

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
from hil.recording.writer import Header, RecordingWriter
from hil.stand.file import parse
from hil.stand.servo import StandServo
from sim_backend.parameters import CouplingParameters, FixtureParameters
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.feetech.tables import MODELS
from sim_backend.wire.loadcell.emulator import SCALE, EmulatedLoadCell, LoadCellBoard
from sim_backend.wire.packets.regulator import joint_at_horn

from ...loopback import SerialLoopback

STAND = """
[stand]
gear_ratio = 1.0
torque_source = "{source}"
torque_stays_on_if_host_dies = true
[limits]
torque = 0.4
deflection = 1.5
velocity = 60.0
temperature = 65.0
"""
KC, BC = 17.75e-3, 0.19e-3
SHARE = FixtureParameters().stiffness / (FixtureParameters().stiffness + KC)  # of a deflection that the cable takes
RATE = 250.0
COUPLING = CouplingParameters(stiffness=KC, damping=BC, coulomb_friction=0.0)


def with_cell(rig: Any, servo: Servo) -> Servo:
    board = LoadCellBoard(rate=1000.0, baudrate=921_600)
    port = SerialLoopback(EmulatedLoadCell(board, rig.device, now=rig.clock.now()), rig.clock, board.baudrate)
    config = LoadCellConfig(port="loopback", scale=SCALE, baudrate=board.baudrate)
    return StandServo(servo, 0.0, LoadCell(config, clock=rig.clock, port=port))


def identified(
    servo: Servo, quantity: Quantity, amplitude: float, source: str, path: Path, *, duration: float = 5.0
) -> dict[str, float]:
    text = STAND.format(source=source)
    profile = excitation.make(
        "chirp",
        quantity,
        amplitude=amplitude,
        default_amplitude=amplitude,
        duration=duration,
        band=(0.1, 10.0),
        rate=RATE,
        seed=0,
    )
    header = Header(profile=profile.attributes() | {"rate": RATE}, stand_toml=text)
    part = RecordingWriter(path, header, tick_count(profile, RATE))
    outcome = Recorder(parse(text), servo, profile, RATE, part).run(StopRequest())
    servo.close()
    part.finish(outcome.end_reason)
    part.close()
    assert (outcome.end_reason, outcome.lost, outcome.late, outcome.saturated) == ("done", 0, 0, 0)
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    found = identify([path], model("linear+offset+skew"), search)
    return {estimate.name: estimate.value for estimate in found.estimates}


@pytest.mark.parametrize("name", ["sts3215", "scs0009"])
def test_a_chirp_of_positions_with_a_torque_cell_gives_stiffness_and_damping_back(
    make_feetech: Callable[..., Any], tmp_path: Path, name: str
) -> None:
    rig = make_feetech(name)
    rig.bus.devices[0] = FeetechDevice(name, parameters=joint_at_horn(MODELS[name], COUPLING))
    rig.device.write(40, b"\x80")  # its middle is here: the set-points stay within its single turn
    found = identified(with_cell(rig, rig.open()), Quantity.POSITION, 0.8, "joint", tmp_path / "run.h5")
    assert found["Kc"] == pytest.approx(KC * SHARE, rel=0.01)
    assert found["Bc"] == pytest.approx(BC * SHARE**2, rel=0.03)


def test_a_chirp_of_currents_through_an_hls_gives_stiffness_and_damping_back(
    make_feetech: Callable[..., Any], tmp_path: Path
) -> None:
    """Without a cell, on a joint that is stiff enough for counts of 8 mN m; the servo's torque constant is given."""
    stiff = CouplingParameters(stiffness=1.0, damping=20e-3, coulomb_friction=0.0)
    rig = make_feetech("hls3930m")
    rig.bus.devices[0] = FeetechDevice("hls3930m", parameters=joint_at_horn(MODELS["hls3930m"], stiff))
    servo = rig.open(torque_constant=3.43 / 2.8)
    found = identified(servo, Quantity.TORQUE, 0.35, "motor", tmp_path / "run.h5", duration=3.0)
    share = FixtureParameters().stiffness / (FixtureParameters().stiffness + 1.0)
    assert found["Kc"] == pytest.approx(1.0 * share, rel=0.01)
    assert found["Bc"] == pytest.approx(20e-3 * share**2, rel=0.03)
