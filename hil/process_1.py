"""Process 1 of a container: the kernel kills all other processes of the container with it, the guardian among them."""

from __future__ import annotations

import os
import signal
from contextlib import suppress

from hil.acquisition.interrupt import ending


def leave_process_1() -> int | None:
    """If this is process 1, continue in a child process, so that the guardian outlives the process that records.

    Return None in the process that continues. Process 1 itself passes signals on and waits until every other process of
    the container has ended, the guardian and the writer of the rows included. Then return the exit status with which
    process 1 must end: that of the child, 128 + n if the signal n ended the child.
    """
    if os.getpid() != 1:
        return None
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where it is ignored, the kernel keeps no exit status
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD, *ending()})
    child = os.fork()
    if child:
        return _outlive(child)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return None


def _outlive(child: int) -> int:
    """Pass signals on to `child`, after its end to all other processes, until none is left. Return the child's exit
    status.
    """
    status, receiver = 0, child
    while True:
        signalled = signal.sigwaitinfo({signal.SIGCHLD, *ending()})
        if signalled.si_signo != signal.SIGCHLD:
            if signalled.si_code <= 0:  # what the kernel sends, such as Ctrl-C of a terminal, the child gets as well
                with suppress(ProcessLookupError):
                    os.kill(receiver, signalled.si_signo)
            continue
        with suppress(ChildProcessError):  # no other process is left
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                if ended[0] == child:
                    code = os.waitstatus_to_exitcode(ended[1])
                    status, receiver = code if code >= 0 else 128 - code, -1
            continue
        return status
