"""The whole way of every drive: a chirp through its emulated wire in device timing, and Kc and Bc of the recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.servo import Quantity
from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse as model
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.recording.reader import Recording
from hil.signals.prepare import prepare
from hil.stand.file import parse
from sim_backend.wire.loadcell.emulator import SETTLING, LoadCellBoard

from .conftest import benchmark

CHIRPS = benchmark("chirps")
BENCHES = {bench.name: bench for bench in CHIRPS.benches() if not bench.name.startswith("sim")}
PERIOD = 1.0 / CHIRPS.RATE
FAMILIES = (
    "dynamixel xl330-m288",
    "feetech sts3215, 1 kHz cell",
    "odrive 0.6.10",
    "mit dm-j4310",
    "robstride rs00",
    "moteus",
    "cia402 epos4",
    "commander",
)
QUICK = ("feetech sts3215, 1 kHz cell", "cia402 epos4")
"""One of each kind of wire; what the others make of torque and angle is held to SI by the contract of every servo."""


def recorded(bench: Any, path: Path, duration: float = 1.5, quantity: Quantity | None = None) -> None:
    usual = Quantity.POSITION if bench.cell else Quantity.TORQUE
    CHIRPS.recorded(bench, quantity or usual, path / "run.h5", duration=duration)


def fitted(bench: Any, path: Path) -> tuple[float, float, float]:
    """Return what least squares finds: Kc and Bc relative to the truth, and s by which the torque is late."""
    with Recording(path / "run.h5") as recording:
        signals = prepare(recording, parse(recording.stand_toml).stand)
    motion = signals.motion
    kc, bc = bench.truth
    shifted = kc * motion.dtheta_dot + bc * np.gradient(motion.dtheta_dot, motion.time)
    design = np.column_stack([motion.dtheta, motion.dtheta_dot, np.ones_like(shifted), shifted])
    found, *_ = np.linalg.lstsq(design, signals.coupling_torque, rcond=None)
    return float(found[0] / kc), float(found[1] / bc), float(found[3])


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.study) for name in BENCHES]
)
def test_a_chirp_through_the_wire_gives_stiffness_and_damping_back(tmp_path: Path, name: str) -> None:
    """A set-point is held for a tick: torque and angle may be half a tick apart, and a cell's reading comes later."""
    bench = BENCHES[name]
    recorded(bench, tmp_path, 1.5 if name in FAMILIES else 3.0)  # a few of the others have 1024 counts in 300 degrees
    kc, bc, late = fitted(bench, tmp_path)
    assert kc == pytest.approx(1.0, abs=0.002)
    assert bc == pytest.approx(1.0, abs=0.1)
    assert abs(late) <= 0.55 * PERIOD + bench.cell * 1e-3


@pytest.mark.study
def test_a_slow_torque_cell_gives_the_stiffness_back_and_no_damping(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """80 readings a second, each the mean over 50 ms: of a sine at 1 Hz sinc(0.05) is left, 0.4 % too little."""
    highest, board = 1.0, LoadCellBoard()
    monkeypatch.setattr(CHIRPS, "BAND", (0.1, highest))
    monkeypatch.setattr(CHIRPS, "BOARD", board)
    bench = CHIRPS.replace(BENCHES["commander"], cell=True)
    recorded(bench, tmp_path, 4.0, Quantity.TORQUE)
    kc, _, _ = fitted(bench, tmp_path)
    missing = 1.0 - float(np.sinc(highest * SETTLING / board.rate))
    assert 1.0 - missing - 0.001 < kc < 1.001


@pytest.mark.study
@pytest.mark.parametrize("name", ["commander", "feetech sts3215, 1 kHz cell"])
def test_the_search_finds_stiffness_and_damping_of_the_chirp(tmp_path: Path, name: str) -> None:
    recorded(BENCHES[name], tmp_path, 4.0)
    search = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})
    found = identify([tmp_path / "run.h5"], model("linear+offset+skew"), search)
    kc, bc, _ = CHIRPS.errors(found, BENCHES[name])
    assert abs(kc) < 0.003
    assert abs(bc) < 0.03
