"""The real-time class: only where time is real and only while the motor is driven; no child process has it."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers.clock import MonotonicClock, VirtualClock
from drivers.servo import DriverError, Quantity
from hil.acquisition import real_time as module
from hil.acquisition.excitation import make
from hil.acquisition.real_time import missing_permissions, real_time
from hil.acquisition.run import run
from hil.doctor.checks import CheckList, Verdict
from hil.doctor.examine import examine
from hil.guardian import words
from hil.stand.file import SIMULATED, parse

LOCKED = "VmLck:"


def locked_memory() -> str:
    return next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(LOCKED))


def state() -> tuple[int, float, int, str]:
    slack = ctypes.CDLL(None).prctl(30, 0, 0, 0, 0)
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return policy, sys.getswitchinterval(), slack, locked_memory()


def policy_of_a_child() -> int:
    code = "import os; print(os.sched_getscheduler(0))"
    return int(subprocess.run([sys.executable, "-S", "-c", code], check=True, capture_output=True).stdout)


def test_the_clock_returns_when_it_is_due_and_never_before() -> None:
    clock = MonotonicClock()
    for ahead in (0.0, 20e-6, 2e-3):
        due = clock.now() + ahead
        clock.sleep_until(due)
        assert clock.now() >= due


@pytest.mark.skipif(not hasattr(time, "CLOCK_BOOTTIME"), reason="the system tells nothing of its sleep")
def test_a_computer_that_was_suspended_finds_that_time_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a run would go on as if nothing had been, while its drive has kept the last torque for an hour."""
    clock, awake = MonotonicClock(), time.clock_gettime
    began, guardian_began = clock.now(), words.now()
    monkeypatch.setattr(time, "clock_gettime", lambda which: awake(which) + 3600.0 * (which == time.CLOCK_BOOTTIME))
    assert clock.now() - began >= 3600.0
    assert words.now() - guardian_began >= 3600e9


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has these")
def test_what_is_permitted_holds_in_the_block_only_and_no_child_has_it() -> None:
    before, missing = state(), missing_permissions()
    assert state() == before
    with real_time(MonotonicClock()):
        policy, interval, slack, locked = state()
        assert (policy == os.SCHED_FIFO) == ("the real-time class" not in missing)
        assert (locked != before[-1]) == ("locked memory" not in missing)
        assert interval == pytest.approx(1e-4)
        assert slack <= 1  # 0 in the real-time class, whatever was asked for
        assert policy_of_a_child() == os.SCHED_OTHER
    assert state() == before


def test_in_virtual_time_nothing_is_changed() -> None:
    before = state()
    with real_time(VirtualClock()):
        assert state() == before


@pytest.mark.parametrize("backend", ["sim", "dynamixel"])
def test_a_real_drive_is_opened_in_the_real_time_class(
    tmp_path: Path, backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    is_urgent = backend != "sim" and "the real-time class" not in missing_permissions()
    policies = list[int]()

    def opened(*_: object, **__: object) -> object:
        policies.append(state()[0])
        raise DriverError("no drive")

    monkeypatch.setattr("hil.doctor.examine.open_servo", opened)
    monkeypatch.setattr("hil.acquisition.run.open_servo", opened)
    text = SIMULATED.replace('backend = "sim"', f'backend = "{backend}"')
    stand = parse(text + '\n[dynamixel]\nport = "/dev/null"\nmodel = "xl330-m288"\n' if backend != "sim" else text)
    examine(CheckList(), stand, Quantity.TORQUE, rate=100.0, move=False, search=lambda *_: [])
    profile = make("ramp", Quantity.TORQUE, amplitude=0.01, default_amplitude=1.0, duration=1.0, band=None, rate=100.0)
    with pytest.raises(DriverError):
        run(stand, profile, rate=100.0, seed=0)
    assert policies == 2 * [os.SCHED_FIFO if is_urgent else os.SCHED_OTHER]


def test_what_is_not_permitted_is_done_without(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with real_time(MonotonicClock()):
        assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
    assert "the real-time class" in missing_permissions()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has these")
def test_the_doctor_says_how_to_permit_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for missing in ([], ["the real-time class"]):
        monkeypatch.setattr("hil.doctor.examine.missing_permissions", lambda missing=missing: missing)
        checks = CheckList()
        examine(checks, parse(SIMULATED), Quantity.TORQUE, rate=100.0, move=False)
        (check,) = [check for check in checks.checks if check.name == "real time"]
        assert (check.verdict is Verdict.WARNING) == bool(missing)
        assert (module.PERMISSION in check.message) == bool(missing)
        assert checks.ok
