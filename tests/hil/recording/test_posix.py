"""The copy of a process in which a file is read."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

PARENT = """
import os, sys, time
from pathlib import Path
from hil.recording.posix import in_child

def work():
    Path(sys.argv[1]).write_text(str(os.getpid()))
    begun = os.getppid()
    while os.getppid() == begun:
        time.sleep(0.01)
    Path(sys.argv[2]).write_text("orphaned")
    return bytes(1 << 22)  # more than a pipe holds

in_child(work, processor=20, memory=1 << 28)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no copy of a process")
def test_a_copy_whose_process_is_killed_keeps_nobody_waiting_and_ends(tmp_path: Path) -> None:
    """As a preview of the page is, where the person has typed on."""
    begun, orphaned = tmp_path / "pid", tmp_path / "orphaned"
    words = [sys.executable, "-c", PARENT, str(begun), str(orphaned)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        until(lambda: begun.exists() and begun.read_text() != "")
        process.kill()
        process.communicate(timeout=30.0)  # its output ends with it
    until(orphaned.exists)
    until(lambda: not Path(f"/proc/{begun.read_text()}").exists())


def until(holds: Callable[[], bool], patience: float = 30.0) -> None:
    end = time.monotonic() + patience
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)
