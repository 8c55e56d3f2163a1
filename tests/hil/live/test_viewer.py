"""The live view: what it says of the rows, how it fits its terminal, and that it is a process of its own."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.servo import Status
from hil.child import command
from hil.live.screen import axis, drawn, line
from hil.live.state import State
from hil.live.viewer import beside, opened
from hil.recording.channels import END_MARK, ROW, Row
from hil.recording.writer import Header, RecordingWriter

KC, BC = 0.02, 3e-4
LIMITS = {"torque": 0.03, "deflection": 1.0, "velocity": 100.0, "temperature": 80.0}


def rows(written: int, rate: float = 250.0) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """A joint with a known stiffness, damping and offset of its torque."""
    table = np.full(2000, np.array(Row(END_MARK), dtype=ROW))
    time = np.arange(written) / rate
    done = table[:written]
    done["seq"] = np.arange(written)
    done["time"] = time
    done["dtheta"] = 0.2 * np.sin(8.0 * time)
    done["dtheta_dot"] = 1.6 * np.cos(8.0 * time)
    done["torque"] = KC * done["dtheta"] + BC * done["dtheta_dot"] + 1e-3
    done["temperature"] = 40.0
    done["status"][3:5] = Status.NO_REPLY
    done["status"][6:9] = Status.MISSED | Status.LATE | Status.NO_REPLY  # which the drive was not asked for
    return table


def state(written: int, duration: float = 10.0, **changes: Any) -> State:
    found = State(rows(written, **changes), duration, LIMITS)
    found.update()
    return found


def test_the_estimates_are_those_of_least_squares_and_do_not_depend_on_how_the_rows_come() -> None:
    table = rows(0)
    whole = rows(1000)
    growing = State(table, 10.0, LIMITS)
    for count in (1, 90, 400, 1000):
        table[:count] = whole[:count]
        growing.update()
    for found in (growing.fit.estimate, state(1000).fit.estimate):
        assert found == pytest.approx((KC, BC), rel=1e-6)


def test_nothing_is_estimated_from_rows_that_do_not_determine_it() -> None:
    assert state(50).fit.estimate is None
    still = rows(1000)
    still["dtheta"], still["dtheta_dot"] = 0.1, 0.0
    found = State(still, 10.0, LIMITS)
    found.update()
    assert found.fit.estimate is None
    assert "cannot be estimated yet" in drawn(found, 80, 24)


def test_rate_jitter_losses_time_left_and_margins_are_those_of_the_rows() -> None:
    found = state(500)
    assert found.rate == pytest.approx(250.0)
    assert found.jitter == pytest.approx(0.0, abs=1e-9)
    assert found.left == pytest.approx(10.0 - 499 / 250.0)
    assert found.lost == 2
    used = {one.name: one.used for one in found.margins}
    assert used["deflection"] == pytest.approx(0.2, rel=1e-3)
    assert used["temperature"] == pytest.approx(0.5)
    assert set(used) == set(LIMITS)
    assert state(1000, duration=3.0).left == 0.0


@pytest.mark.parametrize("unicode", [True, False])
@pytest.mark.parametrize(
    ("width", "height"), [(80, 24), (200, 60), (60, 16), (59, 24), (80, 15), (40, 24), (20, 4), (1, 1)]
)
def test_the_view_fits_every_terminal(width: int, height: int, unicode: bool) -> None:
    text = drawn(state(1500), width, height, unicode=unicode, keys=True)
    assert max(map(len, text.splitlines())) <= width
    assert len(text.splitlines()) <= height
    assert "\x1b" not in text
    assert unicode or text.isascii()


def test_eighty_columns_show_traces_loop_margins_and_preliminary_estimates() -> None:
    text = drawn(state(1500), 80, 24, keys=True)
    for part in ("torque, mN m  ", "deflection, mrad", "torque, mN m over mrad", "2 lost"):
        assert part in text
    for part in ("deflection 20%", "of 1 rad", "preliminary: Kc 20 mN m/rad   Bc 0.3 mN m s/rad", "250 Hz, jitter"):
        assert part in text


@pytest.mark.parametrize(("cells", "apart"), [(3, 1), (6, 2), (40, 8), (57, 12)])
def test_the_ticks_of_an_axis_are_round_and_evenly_spaced(cells: int, apart: int) -> None:
    for low, width in product((-6.3, 16.51, 7.31, 0.0, -2e5), (0.0, 0.07, 12.6, 999.0)):
        found = axis(low, low + width, cells, apart)
        assert found is not None
        start, end = found.ends
        places = (np.array(found.ticks) - start) / (end - start) * (cells - 1)
        assert start - 1e-9 <= low <= low + width <= end + 1e-9
        assert places == pytest.approx(np.round(places), abs=1e-6)
        assert np.ptp(np.diff(places)) == pytest.approx(0.0, abs=1e-6)
        assert [float(text) for text in found.texts] == pytest.approx(found.ticks)
        assert len(set(found.texts)) > 1


@pytest.mark.parametrize("written", [0, 1])
def test_before_the_first_rows_the_view_is_starting(written: int) -> None:
    assert drawn(state(written), 80, 24) == line(state(written)) == "starting"


def test_a_lost_reply_and_a_drive_without_a_rate_do_not_stop_the_view() -> None:
    table = rows(1000)
    table["dtheta_dot"] = np.nan
    table[5:8]["torque"] = np.nan
    found = State(table, 10.0, {})
    found.update()
    assert found.fit.estimate == pytest.approx((KC, BC), rel=0.02)
    assert "limits: none known" in drawn(found, 80, 24) or "limits: deflection" in drawn(found, 80, 24)


def test_limits_and_duration_come_from_the_recording(tmp_path: Path) -> None:
    text = '[stand]\nbackend = "sim"\n[limits]\ntorque = "30 mN*m"\ndeflection = 1.0\nvelocity = 100.0\n'
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"duration": 4.0}, stand_toml=text), 10) as part:
        _, duration, limits = opened(part.path)
    assert duration == 4.0
    assert limits["torque"] == pytest.approx(0.03)


@pytest.mark.study
def test_the_viewer_has_a_session_of_its_own_so_that_ctrl_c_does_not_reach_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []
    popen = subprocess.Popen

    def start(*words: Any, **settings: Any) -> Any:
        viewer = popen(*words, **settings)
        started.append(os.getsid(viewer.pid))
        return viewer

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"duration": 4.0}), 10) as part:
        monkeypatch.setattr(subprocess, "Popen", start)
        with beside(part.path):
            assert len(started) == 1
    assert started[0] != os.getsid(0)


def test_a_run_does_without_a_viewer_that_cannot_be_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*words: Any, **settings: Any) -> Any:
        raise OSError(12, f"no memory for {len(words)} words and {len(settings)} settings")

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(subprocess, "Popen", fail)
    with beside(tmp_path / "a.h5.part"):
        pass


@pytest.mark.study
def test_the_viewer_ends_when_the_recorder_closes_it(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"duration": 4.0}), 10) as part:
        words = command("hil.live.viewer", str(part.path), "-1", "0", "utf-8", "")
        viewer = subprocess.run(words, check=False, input=b"", capture_output=True)
    assert viewer.returncode == 0


class Terminal:
    """A run of hil on a terminal of its own, and all that it wrote to it."""

    def __init__(self, words: list[str], folder: Path, **environment: str) -> None:
        master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self._master, self.settings, self._slave = master, termios.tcgetattr(slave), slave
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil", *words],
            cwd=folder, stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
            env=os.environ | {"TERM": "xterm", "COLUMNS": "80"} | environment,
        )  # fmt: skip
        self.text = ""

    def read_until(self, pattern: str, seconds: float = 60.0) -> None:
        os.set_blocking(self._master, False)
        deadline = time.monotonic() + seconds
        while not re.search(pattern, self.text):
            assert time.monotonic() < deadline, self.text[-2000:]
            try:
                self.text += os.read(self._master, 65536).decode(errors="replace")
            except BlockingIOError:
                time.sleep(0.02)

    def press(self, key: bytes) -> None:
        os.write(self._master, key)

    def close(self) -> int:
        try:
            while self.process.poll() is None:
                try:
                    self.text += os.read(self._master, 65536).decode(errors="replace")
                except BlockingIOError:
                    time.sleep(0.02)
            assert termios.tcgetattr(self._slave) == self.settings
            return self.process.wait()
        finally:
            self.process.kill()
            self.process.wait()
            os.close(self._master)
            os.close(self._slave)


RUN = ["record", "--backend", "sim", "--realtime", "--duration", "60", "--rate", "100", "--band", "0.5:5", "-o", "a.h5"]


@pytest.mark.study
def test_a_key_ends_the_run_softly_and_the_terminal_is_as_it_was(tmp_path: Path) -> None:
    terminal = Terminal(RUN, tmp_path)
    try:
        terminal.read_until("preliminary: Kc|late|hil:")
        terminal.press(b" ")
    finally:
        status = terminal.close()
    if "LimitReached" not in terminal.text and "a tick came" not in terminal.text:  # a busy machine ended it before
        assert status == 130
        assert "stopped on request" in terminal.text
    assert (tmp_path / "a.h5").exists()


@pytest.mark.study
def test_a_terminal_without_colours_and_unicode_gets_plain_ascii(tmp_path: Path) -> None:
    terminal = Terminal(RUN, tmp_path, NO_COLOR="1", PYTHONIOENCODING="ascii", LC_ALL="C")
    try:
        terminal.read_until("preliminary: Kc|a tick came")
        terminal.press(b"q")
    finally:
        status = terminal.close()
    assert status == 130 or "a tick came" in terminal.text
    assert terminal.text.isascii()
    assert "Traceback" not in terminal.text
    assert not re.search(r"\x1b\[3\dm", terminal.text)


@pytest.mark.study
def test_rerun_gets_the_run_and_the_recording_as_files(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="RERUN NOT TESTED: it is not installed")
    words = ["record", "--backend", "sim", "--duration", "2", "-o", "a.h5", "--rerun", "live.rrd"]
    for command_words in (words, ["view", "a.h5", "-o", "later.rrd"]):
        ended = subprocess.run(
            [sys.executable, "-m", "hil", *command_words], check=False, cwd=tmp_path, capture_output=True, text=True
        )
        assert (ended.returncode, ended.stderr) == (0, "") or "lost" in ended.stderr
    for name in ("live.rrd", "later.rrd"):
        assert (tmp_path / name).read_bytes()[:4] in {b"RRF2", b"RRIO"}
        assert (tmp_path / name).stat().st_size > 20_000
