"""hil as process 1 of a container, here of a namespace of processes: what records is another process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

CONTAINER = ("unshare", "--pid", "--fork", "--mount-proc")


@pytest.fixture(autouse=True)
def permitted() -> None:
    if subprocess.run([*CONTAINER, "true"], check=False, capture_output=True).returncode:
        pytest.skip("no namespace of processes is permitted here: run as root")


def started(program: str) -> subprocess.Popen[str]:
    code = "import os, signal; from hil.process_1 import leave_process_1; ended = leave_process_1()\n"
    code += f"if ended is not None: os._exit(ended)\n{program}"
    return subprocess.Popen([*CONTAINER, sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)


def test_what_a_killed_recorder_leaves_runs_to_its_end() -> None:
    guardian = "os.fork() or (os.close(kept), os.read(heard, 1), os.write(1, b'torque off'), os._exit(0))"
    program = f"heard, kept = os.pipe(); {guardian}; os.kill(os.getpid(), signal.SIGKILL)"
    with started(program) as container:
        assert container.communicate()[0] == "torque off"
    assert container.returncode == 128 + signal.SIGKILL


def test_a_signal_to_process_1_reaches_the_recorder() -> None:
    with started(
        "signal.pthread_sigmask(signal.SIG_BLOCK, {15}); print(os.getpid(), flush=True); "
        "signal.sigwait({15}); os._exit(7)"
    ) as container:
        assert container.stdout is not None
        assert int(container.stdout.readline()) > 1
        children = Path(f"/proc/{container.pid}/task/{container.pid}/children").read_text(encoding="ascii")
        os.kill(int(children), signal.SIGTERM)
        assert container.wait() == 7
