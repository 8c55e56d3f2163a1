"""A part of benchmarks/faults.py: faults that take recorder, disk or torque-off away in the middle of a run."""

from __future__ import annotations

from typing import Any

import pytest

from hil.acquisition.phases import Phase

from .conftest import benchmark

NAMES = ("dynamixel", "moteus", "cia402", "commander", "robstride")
KINDS = ("ignored-off", "kill", "disk-full", "disk-frozen")
CELLS = [("dynamixel", kind) for kind in KINDS] + [(name, kind) for name in NAMES[1:] for kind in KINDS[:2]]
DISKS = [(name, kind) for name in NAMES[1:] for kind in KINDS[2:]]


@pytest.fixture(scope="module")
def faults() -> Any:
    return benchmark("faults")


@pytest.fixture(scope="module")
def middle(faults: Any) -> dict[str, float]:
    """A time in the middle of a run, s, by adapter."""
    return {name: faults.moments(faults.ADAPTERS[name])[Phase.RUN] for name in NAMES}


@pytest.mark.parametrize(("name", "kind"), [*CELLS, *(pytest.param(*cell, marks=pytest.mark.study) for cell in DISKS)])
def test_no_torque_stays_on_without_the_alarm(faults: Any, middle: dict[str, float], name: str, kind: str) -> None:
    cell = faults.judged(faults.ADAPTERS[name], kind, middle[name], Phase.RUN)
    assert cell.ended
    if kind == "ignored-off":
        assert cell.alarm or not cell.on
    else:
        assert not cell.on
        assert cell.off < (0.5 * faults.HELD if kind == "disk-frozen" else 0.0) + 0.02
