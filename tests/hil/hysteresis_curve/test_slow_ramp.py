"""A slow ramp that no model explains is refused before the search; what identify can identify is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import Untrustworthy
from hil.hysteresis_curve.slow_ramp import refuse_slow_ramp
from hil.recording.writer import Header, write
from hil.signals.prepare import Signals, prepare
from hil.signals.source import open_sources


def ramp(path: Path, friction: float, growing: float, seconds: float) -> Signals:
    """A triangle on a spring of 500 N m/rad whose friction is a constant, N m, and grows with the load."""
    rows = int(100 * seconds)
    rng, time = np.random.default_rng(1), np.arange(rows) / 100.0
    torque = 25.0 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * time / seconds))
    elastic, angle = 0.0, []
    for one in torque:
        held = friction + growing * abs(elastic)
        if abs(one - elastic) > held:
            sign = 1.0 if one > elastic else -1.0
            pushed = one - sign * friction
            elastic = pushed / (1.0 + growing * sign * np.sign(pushed))
        angle.append(elastic / 500.0)
    read = {"torque": torque + rng.normal(0.0, 0.1, rows), "dtheta": np.array(angle) + rng.normal(0.0, 1e-6, rows)}
    write(path, Header(profile={"kind": "imported"}), {"time": time, **read})
    with open_sources([path]) as (source,):
        return prepare(source.recording, source.table)


def test_friction_that_grows_with_the_load_in_one_slow_ramp_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Untrustworthy, match=r"stiffer when it is unloaded .* with hil hysteresis"):
        refuse_slow_ramp(ramp(tmp_path / "a.h5", 0.5, 0.55, 20.0))


@pytest.mark.study
@pytest.mark.parametrize(("friction", "growing", "seconds"), [(5.0, 0.0, 20.0)])
def test_a_ramp_with_friction_that_is_constant_or_a_fast_ramp_is_not(
    tmp_path: Path, friction: float, growing: float, seconds: float
) -> None:
    refuse_slow_ramp(ramp(tmp_path / "a.h5", friction, growing, seconds))
