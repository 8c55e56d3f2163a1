"""The whole way: record a chirp through the emulated servo in device timing, and find the coupling's Kc and Bc."""

from __future__ import annotations

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
from sim_backend.parameters import CouplingParameters
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.tables import MODELS
from sim_backend.wire.packets.regulator import COUNT, joint_at_horn

STAND = """
[stand]
gear_ratio = 1.0
motor_inertia = 3.2e-6
motor_damping = 1.6e-6
torque_source = "motor"
[limits]
torque = 0.03
deflection = 1.5
velocity = 60.0
temperature = 65.0
"""
KC, BC = 17.75e-3, 0.19e-3
RATE, DURATION, AMPLITUDE = 500.0, 4.0, 0.01


@pytest.mark.parametrize(("model", "kt"), [("xl330-m288", 0.52 / 1.47), ("xl330-m077", 0.215 / 1.47)])
def test_a_chirp_through_the_wire_gives_stiffness_and_damping_back(
    make_rig: Callable[..., Any], tmp_path: Path, model: str, kt: float
) -> None:
    coupling = CouplingParameters(stiffness=KC, damping=BC, coulomb_friction=0.0)
    rig = make_rig(model)
    rig.bus.devices[0] = DynamixelDevice(model, parameters=joint_at_horn(MODELS[model], coupling))
    stand = parse(STAND)
    profile = excitation.make(
        "chirp",
        Quantity.TORQUE,
        amplitude=AMPLITUDE,
        default_amplitude=AMPLITUDE,
        duration=DURATION,
        band=(0.1, 10.0),
        rate=RATE,
        seed=0,
    )
    path = tmp_path / "run.h5"
    servo = rig.open(torque_constant=kt)
    part = RecordingWriter(path, Header(profile=profile.attributes()), tick_count(profile, RATE))
    outcome = Recorder(stand, servo, profile, RATE, part).run(StopRequest())
    servo.close()
    part.finish(outcome.end_reason)
    part.close()
    assert (outcome.end_reason, outcome.lost, outcome.late) == ("done", 0, 0)
    with Recording(path) as recording:
        signals = prepare(recording, stand.stand)
    design = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    (kc, bc), *_ = np.linalg.lstsq(design, signals.coupling_torque, rcond=None)
    # Theory. A torque is off by up to half a count of current, a deflection by half a count of position, which Kc turns
    # into torque: whatever their signs, least squares passes on no more than the sum of its weights' magnitudes. And a
    # set-point is held for a whole period: the reading may show its beginning or its end, half a period of skew at the
    # most, which a model without skew puts into Bc as Kc times the skew (first order; nothing goes into Kc).
    half_a_count = 0.5 * (kt * 1e-3 + KC * COUNT)
    worst = half_a_count * np.abs(np.linalg.pinv(design)).sum(axis=1)
    assert worst[0] < 0.03 * KC
    assert kc == pytest.approx(KC, abs=worst[0])
    assert bc == pytest.approx(BC, abs=worst[1] + KC * 0.5 / RATE)
    assert bc == pytest.approx(BC, rel=0.2)
