"""Run the control loop on time: in the real-time scheduling class, with locked memory, if the system permits it."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.clock import Clock, MonotonicClock, VirtualClock
from ga.collector import uncollected

_PRIORITY = 50  # of 1 to 99; the kernel's own interrupt threads have 50, and what is above is for them
_SWITCH = 1e-4  # s after which a thread that waits for the interpreter gets it; the default of 5 ms is five ticks
_SET_TIMER_SLACK, _GET_TIMER_SLACK = 29, 30  # prctl
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # mlockall
PERMISSION = (
    "write the two lines `@hil - rtprio 60` and `@hil - memlock unlimited` into /etc/security/limits.d/hil.conf, join "
    "the group with `sudo groupadd -f hil && sudo usermod -aG hil $USER`, then log out and in"
)
"""The instruction how to give a user the permission for the real-time class and locked memory."""


@contextmanager
def real_time(clock: Clock) -> Iterator[None]:
    """Run the enclosed block, which drives a motor, in the real-time class and with locked memory as far as permitted.

    With a virtual clock nothing is changed. Child processes inherit neither the real-time class nor the locked memory.
    """
    with uncollected():  # a full collection can stop the loop for 100 ms
        if not isinstance(clock, MonotonicClock):
            yield
            return
        gc.collect()
        gc.freeze()
        try:
            with _urgent():
                yield
        finally:
            gc.unfreeze()


@contextmanager
def connecting(backend: object) -> Iterator[None]:
    """Run the enclosed block, which opens a drive of a backend, in the real-time class: otherwise the waits of a busy
    computer are taken for those of its adapter.
    """
    with real_time(VirtualClock() if backend == "sim" else MonotonicClock()):
        yield


@contextmanager
def _urgent() -> Iterator[None]:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH)
    slack = _prctl(_GET_TIMER_SLACK)
    _prctl(_SET_TIMER_SLACK, 1)
    locked, urgent = _lock_memory(), _be_urgent()
    try:
        yield
    finally:
        if urgent:
            _schedule(os.SCHED_OTHER, 0)
        if locked:
            _call("munlockall")
        if slack > 0:
            _prctl(_SET_TIMER_SLACK, slack)
        sys.setswitchinterval(interval)


def missing_permissions() -> list[str]:
    """Return what the system does not permit to this user: "the real-time class", "locked memory" or both. Changes
    nothing.
    """
    missing = []
    if not _tried(_be_urgent, lambda: _schedule(os.SCHED_OTHER, 0)):
        missing.append("the real-time class")
    if not _tried(_lock_memory, lambda: _call("munlockall")):
        missing.append("locked memory")
    return missing


def _tried(begin: Callable[[], bool], end: Callable[[], object]) -> bool:
    permitted = begin()
    if permitted:
        end()
    return permitted


def _be_urgent() -> bool:
    """Enter the real-time class, which child processes do not inherit; return whether the system permitted that."""
    return _schedule(getattr(os, "SCHED_FIFO", 0), _PRIORITY)


def _schedule(policy: int, priority: int) -> bool:
    if not hasattr(os, "SCHED_RESET_ON_FORK"):  # not Linux
        return False
    try:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError:
        return False
    return True


def _lock_memory() -> bool:
    """Lock all memory in use, so that none is swapped out; return whether the system permits that without a size limit.

    With a size limit, a later allocation beyond the limit would fail.
    """
    if sys.platform != "linux":
        return False
    import resource

    unbounded = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    return (unbounded or os.geteuid() == 0) and _call("mlockall", _CURRENT | _FUTURE | _ON_FAULT) == 0


def _prctl(option: int, value: int = 0) -> int:
    return _call("prctl", option, ctypes.c_ulong(value), ctypes.c_ulong(0), ctypes.c_ulong(0), ctypes.c_ulong(0))


def _call(name: str, *values: object) -> int:
    """Call the C library's function `name`; return its result, -1 if the system has no such function."""
    if sys.platform != "linux":
        return -1
    return int(getattr(ctypes.CDLL(None), name)(*values))
