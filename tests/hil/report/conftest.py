"""What the tests of the report ask their different questions of: one identification of one recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil as api
from hil.identification.result import Identification
from hil.recording.writer import Header, write


def recording(path: Path, *, samples: int = 2000, gap: float = 0.0) -> Path:
    """A joint of 20 mN m/rad and 0.2 mN m s/rad with noise; gap: backlash, rad."""
    time, generator = np.arange(samples) / 500.0, np.random.default_rng(0)
    dtheta = 0.2 * np.sin(8.0 * time) + 0.1 * np.sin(45.0 * time)
    rate = 1.6 * np.cos(8.0 * time) + 4.5 * np.cos(45.0 * time)
    outside = np.abs(dtheta) > gap / 2.0
    pushed = np.sign(dtheta) * np.maximum(np.abs(dtheta) - gap / 2.0, 0.0)
    torque = 0.02 * pushed + 2e-4 * rate * outside + 2e-4 * generator.standard_normal(samples)
    write(path, Header(profile={"kind": "imported"}), {"time": time, "torque": torque, "dtheta": dtheta})
    return path


@pytest.fixture(scope="session")
def answer(tmp_path_factory: pytest.TempPathFactory) -> api.IdentificationResult:
    """The linear model of `recording`, by four trials."""
    return api.identify(recording(tmp_path_factory.mktemp("answer") / "a.h5"), "linear", trials=4)


@pytest.fixture(scope="session")
def found(answer: api.IdentificationResult) -> Identification:
    return answer.identification
