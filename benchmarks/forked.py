"""Work in copies of this process, which has all modules imported: its limits, what it wrote, and how it ended."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

PATIENCE = 60.0  # s of wall time on a busy computer, after which a copy gets Ctrl-C
GRACE = 30.0  # s after that until it is killed
_POLL = 0.002


class Ended(NamedTuple):
    """How a copy ended: its exit status or minus a signal, what it wrote, s of processor time, and MiB at most.

    interrupted: it got Ctrl-C after `PATIENCE`.
    """

    status: int
    out: str
    err: str
    seconds: float
    memory: float
    interrupted: bool


def in_a_copy(
    work: Callable[[], int],
    *,
    processor: int = 60,
    memory: int = 1 << 29,
    patience: float = PATIENCE,
    encoding: str = "utf-8",
    closed_pipe: bool = False,
) -> Ended:
    """Return how a copy of this process ends that exits with the status of `work`.

    processor: s that it may take. memory: bytes that it may take beyond this process's. encoding: of its output.
    closed_pipe: whether its standard output is a pipe that nobody reads.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the copy uses none of theirs
            blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # until the copy ends by itself
            child = os.fork()
        if child == 0:
            _run(work, out.fileno(), err.fileno(), (processor, memory), encoding, closed_pipe=closed_pipe)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        status, used, interrupted = _wait(child, patience)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # what it has left behind
        out.seek(0)
        err.seek(0)
        text = [file.read().decode(encoding, "replace") for file in (out, err)]
        return Ended(status, *text, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, interrupted)


def _wait(child: int, patience: float) -> tuple[int, resource.struct_rusage, bool]:
    began, asked = time.monotonic(), False
    while True:
        pid, status, used = os.wait4(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status), used, asked
        waited = time.monotonic() - began
        if waited > patience + GRACE:
            os.kill(child, signal.SIGKILL)
        elif waited > patience and not asked:
            os.kill(child, signal.SIGINT)
            asked = True
        time.sleep(_POLL)


def _run(
    work: Callable[[], int], out: int, err: int, limits: tuple[int, int], encoding: str, *, closed_pipe: bool
) -> None:
    """Run `work` in the copy, and end it."""
    status = 70
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if closed_pipe:
            reading, out = os.pipe()
            os.close(reading)
        with Path(os.devnull).open("rb") as nothing:
            os.dup2(nothing.fileno(), 0)
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.stdin = open(0, encoding=encoding, closefd=False)  # noqa: SIM115 - as a new process has it
        sys.stdout = open(1, "w", encoding=encoding, errors="strict", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding=encoding, errors="backslashreplace", closefd=False)  # noqa: SIM115
        _limit(*limits)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        status = work()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(BrokenPipeError):
                stream.flush()
    finally:
        if sys.exc_info()[0] is not None:
            sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
            sys.stderr.flush()
        os._exit(status)


def _limit(processor: int, memory: int) -> None:
    used = resource.getrusage(resource.RUSAGE_SELF)
    spent = int(used.ru_utime + used.ru_stime)
    resource.setrlimit(resource.RLIMIT_CPU, (spent + processor, spent + processor + 5))
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + memory, size + memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
