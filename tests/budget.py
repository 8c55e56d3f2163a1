"""Fails a run in which a quick test takes too much processor time: `HIL_TEST_BUDGET=5 pytest`, in seconds.

The time is that of the test and of the programs it waited for, without the clock, over how slow this machine is in the
same run; 1.0 is a Xeon at 2.5 GHz.
"""

from __future__ import annotations

import os
import time
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest

_BUDGET = float(os.environ.get("HIL_TEST_BUDGET", "0"))
_REFERENCE = 1.02
"""s of the work below on the Xeon."""
_begun = pytest.StashKey[float]()
_slowest: list[tuple[float, str]] = []


def _spent() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class _Machine:
    """How slow it is: measured once in each process, beside the work of the others."""

    factor = 0.0

    @classmethod
    def slowness(cls) -> float:
        if not cls.factor:
            a, b, y = np.random.default_rng(0).standard_normal((3, 2500))
            start = time.process_time()
            for _ in range(50_000):
                np.abs(y - 17.0 * a - 0.2 * b).mean()
            sum(number for number in range(5_000_000))
            cls.factor = (time.process_time() - start) / _REFERENCE
        return cls.factor


def pytest_runtest_setup(item: pytest.Item) -> None:
    if _BUDGET and item.get_closest_marker("study") is None:
        _Machine.slowness()
        item.stash[_begun] = _spent()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if call.when == "teardown" and _begun in item.stash:
        report.user_properties.append(("processor time", (_spent() - item.stash[_begun]) / _Machine.slowness()))
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    times = [float(str(value)) for name, value in report.user_properties if name == "processor time"]
    _slowest.extend((time, report.nodeid) for time in times if report.when == "teardown")


def pytest_terminal_summary(terminalreporter: Any) -> None:
    if _BUDGET:
        terminalreporter.section(f"processor time, bar {_BUDGET:g} s a test")
        for seconds, name in sorted(_slowest)[-10:]:
            terminalreporter.line(f"{seconds:6.2f} s {name}{'  TOO LONG' if seconds > _BUDGET else ''}")


def pytest_sessionfinish(session: pytest.Session) -> None:
    if _BUDGET and session.exitstatus == pytest.ExitCode.OK and max(_slowest, default=(0.0, ""))[0] > _BUDGET:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
