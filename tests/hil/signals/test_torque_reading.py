"""A torque that is read later than a model can correct is named with its delay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.identification.verdict.misfit import long_delay
from hil.recording.reader import Recording
from hil.recording.writer import Header, write
from hil.signals.prepare import prepare

STEP = 2e-3
FINE = 10  # points a sample
TIME = np.arange(45_000) * STEP / FINE
LONGEST = 0.02


@pytest.mark.study
@pytest.mark.parametrize(("delay", "said"), [(0.03, "and a model corrects at most 20 ms"), (9e-3, "")])
def test_a_delay_is_named_if_no_model_corrects_it(tmp_path: Path, delay: float, said: str) -> None:
    phases = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 30)
    speeds = 2.0 * np.pi * np.geomspace(0.2, 12.0, 30)
    angle = 0.02 * np.exp(1j * (np.outer(TIME, speeds) + phases)).real.sum(axis=1)
    torque = np.interp(TIME - delay, TIME, 0.3 * angle + 3e-3 * np.gradient(angle, TIME))[::FINE]
    torque = torque + 1e-3 * np.random.default_rng(3).standard_normal(len(torque))
    write(
        tmp_path / "a.h5",
        Header(profile={}, stand_toml=""),
        {"time": TIME[::FINE], "torque": torque, "dtheta": angle[::FINE]},
    )
    with Recording(tmp_path / "a.h5") as recording:
        found = long_delay(prepare(recording, None), LONGEST)
    assert said in found
    assert bool(said) == bool(found)
