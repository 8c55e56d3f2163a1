"""A part of benchmarks/faults.py: faults that take recorder, disk or torque-off away in the middle of a run."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from hil.acquisition.phases import Phase

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "faults.py"
NAMES = ("dynamixel", "moteus", "cia402", "commander")


@pytest.fixture(scope="module")
def faults() -> ModuleType:
    spec = importlib.util.spec_from_file_location("benchmark_faults", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def middle(faults: ModuleType) -> dict[str, float]:
    """A time in the middle of a run, s, by adapter."""
    return {name: faults.moments(faults.ADAPTERS[name])[Phase.RUN] for name in NAMES}


@pytest.mark.parametrize("kind", ["ignored-off", "kill", "disk-full", "disk-frozen"])
@pytest.mark.parametrize("name", NAMES)
def test_no_torque_stays_on_without_the_alarm(
    faults: ModuleType, middle: dict[str, float], name: str, kind: str
) -> None:
    cell = faults.judged(faults.ADAPTERS[name], kind, middle[name], Phase.RUN)
    assert cell.ended
    if kind == "ignored-off":
        assert cell.alarm or not cell.on
    else:
        assert not cell.on
        assert cell.off < (0.5 * faults.HELD if kind == "disk-frozen" else 0.0) + 0.02
