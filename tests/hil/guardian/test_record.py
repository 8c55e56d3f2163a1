"""`hil record` with and without its guardian, against an emulated drive, in real time."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.cli.app import run
from hil.errors import Untrustworthy, WrongUse
from hil.recording.reader import Recording
from sim_backend.wire.dynamixel.emulator import serve

pytestmark = pytest.mark.usefixtures("busy_machine")

STAND = """
[stand]
backend = "dynamixel"
motor_inertia = 3.2e-6
[limits]
torque = 0.03
deflection = 3.0
velocity = 100.0
temperature = 65.0
[dynamixel]
port = "{port}"
model = "xl330-m288"
watchdog = 1.0
reply_timeout = 0.3
"""
SINE = ["--profile", "sine", "--band", "2", "--fade", "0.1", "--rate", "50", "--amplitude", "0.01"]


@pytest.fixture
def record(tmp_path: Path) -> Callable[..., int]:
    """Record into a.h5 from an emulated servo; the torque is off after it."""
    path = tmp_path / "stand.toml"
    path.write_text(STAND.format(port=tmp_path / "tty"))

    def call(*words: str) -> int:
        with serve(tmp_path / "tty", "xl330-m288") as line:
            status = run(["record", "--stand", str(path), *SINE, "-o", str(tmp_path / "a.h5"), *words])
            with line.lock:
                assert not line._peer.devices[0].motor.enabled  # type: ignore[attr-defined]
        return status

    return call


def guardians() -> list[int]:
    """The guardians that this process has started."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            ours = parent == os.getpid() and b"hil.guardian.process" in (folder / "cmdline").read_bytes()
        except OSError:
            continue
        found += [int(folder.name)] if ours else []
    return found


def rows_in(path: Path) -> int:
    """The rows that the recorder has written so far."""
    with contextlib.suppress(WrongUse, Untrustworthy), Recording(path) as recording:
        return len(recording)
    return 0


def test_a_run_whose_guardian_is_killed_ends_with_the_torque_off_and_its_rows(
    record: Callable[..., int], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    over = threading.Event()

    def kill() -> None:
        while not rows_in(tmp_path / "a.h5.part") and not over.wait(0.05):
            pass
        for guardian in guardians():
            os.kill(guardian, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    status = record("--duration", "30")
    over.set()
    killer.join()
    assert status == 3
    assert "hil: the guardian process ended with status -9: nothing would switch" in capfd.readouterr().err
    with Recording(tmp_path / "a.h5") as recording:
        assert 0 < len(recording) < 1400


def test_a_run_that_ends_normally_leaves_no_guardian(record: Callable[..., int]) -> None:
    assert record("--duration", "0.5") == 0
    assert guardians() == []


def test_without_a_guardian_none_is_started_and_the_loss_is_said(
    record: Callable[..., int], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hil.guardian.servo.Guardian", None)
    assert record("--duration", "0.5", "--no-guardian") == 0
    assert "only the drive's own watchdog switches the torque off" in " ".join(capfd.readouterr().err.split())
