"""The whole way on CAN: record a chirp through an emulated drive in device timing, and find its coupling again."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.servo import Quantity
from hil.acquisition import excitation
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.recorder import Recorder, tick_count
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.signals.prepare import prepare
from hil.stand.file import parse
from sim_backend.parameters import FixtureParameters
from sim_backend.wire.canbus.impedance import scaled_joint
from sim_backend.wire.cia402 import tables
from sim_backend.wire.mit.tables import MODELS
from sim_backend.wire.moteus import device as moteus
from sim_backend.wire.moteus.command import TORQUE_CONSTANT
from sim_backend.wire.odrive import device as odrive

STAND = """
[stand]
torque_stays_on_if_host_dies = true
gear_ratio = 1.0
motor_inertia = {inertia}
motor_damping = {damping}
torque_source = "motor"
[limits]
torque = {limit}
deflection = 1.5
velocity = 60.0
temperature = 75.0
"""
KC, BC = 17.75e-3, 0.19e-3  # of the paper's joint; each drive's has every torque `scale` times as large
RATE, DURATION, AMPLITUDE = 500.0, 3.0, 0.01


def recorded(rig: Any, path: Path, scale: float, **config: Any) -> Any:
    """Time, torque, deflection and rate of a chirp at the joint."""
    stand = parse(STAND.format(inertia=3.2e-6 * scale, damping=1.6e-6 * scale, limit=0.03 * scale))
    profile = excitation.make(
        "chirp",
        Quantity.TORQUE,
        amplitude=AMPLITUDE * scale,
        default_amplitude=AMPLITUDE * scale,
        duration=DURATION,
        band=(0.1, 10.0),
        rate=RATE,
        seed=0,
    )
    servo = rig.open(**config)
    part = RecordingWriter(path, Header(profile=profile.attributes()), tick_count(profile, RATE))
    outcome = Recorder(stand, servo, profile, RATE, part).run(StopRequest())
    servo.close()
    part.finish(outcome.end_reason)
    part.close()
    assert (outcome.end_reason, outcome.lost, outcome.late) == ("done", 0, 0)
    with Recording(path) as recording:
        return prepare(recording, stand.stand)


def check(signals: Any, scale: float, torque_lsb: float, position_lsb: float) -> tuple[float, float]:
    """Hold what least squares finds against what the counts allow; what they allow, relative to Kc and Bc.

    Theory. A torque is off by up to half a count, a deflection by half a count, which Kc turns into torque: whatever
    their signs, least squares passes on no more than the sum of its weights' magnitudes. A set-point is held for a
    period, so torque and angle may be half of one apart, which a model without skew puts into Bc, mostly: how much is
    computed by shifting. And the joint is locked by a fixture that gives way, in series with the cable.
    """
    design = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    weights = np.linalg.pinv(design)
    truth = np.array([KC * scale, BC * scale])
    counts = 0.5 * (torque_lsb + truth[0] * position_lsb) * np.abs(weights).sum(axis=1)
    skew = np.zeros(2)
    for shift in (-0.5 / RATE, 0.5 / RATE):
        moved = [np.interp(signals.motion.time + shift, signals.motion.time, column) for column in design.T]
        skew = np.maximum(skew, np.abs(weights @ (np.column_stack(moved) - design) @ truth))
    series = truth / (1.0 + KC / FixtureParameters().stiffness)
    found = weights @ signals.coupling_torque
    assert counts[0] < 0.03 * truth[0]
    assert found[0] == pytest.approx(series[0], abs=counts[0] + skew[0])
    assert found[1] == pytest.approx(series[1], abs=counts[1] + skew[1])
    assert found[1] == pytest.approx(truth[1], rel=0.2)
    return float(counts[0] / truth[0]), float(counts[1] / truth[1])


@pytest.mark.parametrize("firmware", ["0.6.10"])
def test_a_chirp_through_an_odrive_gives_stiffness_and_damping_back(
    make_odrive: Callable[..., Any], tmp_path: Path, firmware: str
) -> None:
    scale = odrive.SCALE
    rig = make_odrive(firmware, parameters=scaled_joint(scale, odrive.TORQUE_CONSTANT, 0.06, friction=False))
    signals = recorded(rig, tmp_path / "run.h5", scale)
    lsb = odrive.CURRENT_LSB * odrive.TORQUE_CONSTANT
    check(signals, scale, lsb, 2.0 * math.pi / odrive.COUNTS)


@pytest.mark.parametrize("model", ["ak80-9", "dm-j4310"])
def test_a_chirp_through_mit_frames_gives_stiffness_and_damping_back(
    make_mit: Callable[..., Any], tmp_path: Path, model: str
) -> None:
    spec = MODELS[model]
    rig = make_mit(model, parameters=scaled_joint(spec.scale, spec.torque_constant, spec.resistance, friction=False))
    signals = recorded(rig, tmp_path / "run.h5", spec.scale)
    position, _, torque = spec.span
    # cut off, not rounded: a whole count of torque; of the angle half, since its zero is taken off
    check(signals, spec.scale, 4.0 * torque / 4095, 2.0 * position / 65535)


@pytest.mark.parametrize("model", ["epos4", "epos2"])
def test_a_chirp_through_a_cia_402_drive_gives_stiffness_and_damping_back(
    make_cia402: Callable[..., Any], tmp_path: Path, model: str
) -> None:
    scale, constant = tables.SCALE, tables.TORQUE_CONSTANT
    rig = make_cia402(model, parameters=scaled_joint(scale, constant, 0.6, friction=False))
    signals = recorded(rig, tmp_path / "run.h5", scale)
    # thousandths of the rated torque, for an EPOS2 milliamperes
    lsb = 1e-3 * constant * (1.0 if model == "epos2" else 1.5)
    check(signals, scale, lsb, 2.0 * math.pi / 4096)


def test_a_chirp_through_a_moteus_gives_stiffness_and_damping_back(
    make_moteus: Callable[..., Any], tmp_path: Path
) -> None:
    scale = moteus.SCALE
    rig = make_moteus(parameters=scaled_joint(scale, TORQUE_CONSTANT, 0.1, friction=False))
    signals = recorded(rig, tmp_path / "run.h5", scale)
    check(signals, scale, moteus.TORQUE_LSB, 2.0 * math.pi / moteus.COUNTS)
