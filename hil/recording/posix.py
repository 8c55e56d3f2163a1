"""File operations that only POSIX systems have, each with a replacement for other systems."""

from __future__ import annotations

import errno
import faulthandler
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from hil.errors import Untrustworthy, WrongUse

Answer = TypeVar("Answer")

_DURABLE = 0.25  # s between two requests that the disk keep what it was given

if sys.platform == "win32":
    import msvcrt

    _FAR = 1 << 62  # a byte that no file has: locking it keeps nobody from reading

    def write_at(file: int, data: bytes, offset: int) -> int:
        """Write `data` at `offset` of an open file; the number of bytes written. One writer only."""
        os.lseek(file, offset, os.SEEK_SET)
        return os.write(file, data)

    def lock(file: int, *, shared: bool) -> None:
        """Lock an open file until it is closed. Raises BlockingIOError if somebody else has locked it."""
        del shared  # there is one kind of lock only
        os.lseek(file, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None

    def remove(file: int, path: Path) -> None:
        """Close the open file at `path` and remove it."""
        os.close(file)
        path.unlink()

    def take_name(file: int, source: Path, path: Path, *, replace: bool) -> int:
        """Rename the open file `source` and return it. Raises FileExistsError if the new name is taken."""
        os.close(file)  # an open file keeps its name here
        source.replace(path) if replace else source.rename(path)
        file = os.open(path, os.O_RDWR | os.O_BINARY)
        with suppress(OSError):
            lock(file, shared=True)
        return file

    def sync_folder(folder: Path) -> None:
        """Make a new name in `folder` durable: the system does so by itself."""

    def in_child(work: Callable[[], Answer], *, processor: int, memory: int) -> Answer | None:
        """Return the result of `work`; this system has no limits for it."""
        del processor, memory
        return work()

else:
    import fcntl
    import pickle
    import resource
    import select

    _PATIENCE = 60  # s of wall time for one s of processor time, on a computer that is busy with other things

    def write_at(file: int, data: bytes, offset: int) -> int:
        """Write `data` at `offset` of an open file; the number of bytes written."""
        return os.pwrite(file, data, offset)

    def lock(file: int, *, shared: bool) -> None:
        """Lock an open file until it is closed, shared with HDF5's readers or for oneself alone.

        Raises BlockingIOError if somebody else has a lock that does not allow it.
        """
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)

    def remove(file: int, path: Path) -> None:
        """Close the open file at `path` and remove it; no other process can open it in between."""
        try:
            path.unlink()
        finally:
            os.close(file)

    def take_name(file: int, source: Path, path: Path, *, replace: bool) -> int:
        """Rename the open file `source` and return it. Raises FileExistsError if the new name is taken."""
        if replace:
            source.replace(path)
        else:
            _rename_new(source, path)
        return file

    def _rename_new(source: Path, path: Path) -> None:
        try:
            os.link(source, path)
        except FileExistsError:
            raise
        except OSError:  # a filesystem without hard links
            if os.path.lexists(path):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from None
            source.rename(path)
        else:
            source.unlink()

    def sync_folder(folder: Path) -> None:
        """Make a new name in `folder` durable."""
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)

    def in_child(work: Callable[[], Answer], *, processor: int, memory: int) -> Answer | None:
        """Return the result of `work`, which runs in a copy of this process. The result must not be None and must be
        picklable.

        The copy ends after `processor` s of processor time, and has `memory` bytes more than this process. Raises the
        WrongUse or Untrustworthy of `work`. Return None after any other error, after a crash, and if a limit is
        exceeded.
        """
        reading, writing = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the copy uses none of theirs
            child = os.fork()
        if child == 0:
            try:
                os.close(reading)  # or nobody would hang up where this process is killed, and the copy would wait
                _limit(processor, memory)
                _send(work, writing)
            finally:
                os._exit(0)
        os.close(writing)
        try:
            with os.fdopen(reading, "rb") as answers:
                if not select.select([reading], [], [], _PATIENCE * processor)[0]:
                    return None
                answer, refusal = pickle.load(answers)  # noqa: S301 - from our own copy
        except (EOFError, pickle.UnpicklingError):  # it ended before it had answered
            return None
        finally:
            with suppress(ProcessLookupError, ChildProcessError):  # where SIGCHLD is ignored it leaves no zombie
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
        if refusal is not None:
            raise refusal
        return answer  # type: ignore[no-any-return]

    def _send(work: Callable[[], Answer], pipe: int) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in {1, 2} - {pipe}:  # what a crashing library prints helps nobody, and a reader waits for both ends
            os.dup2(nowhere, stream)
        answer: tuple[Answer | None, Exception | None]
        try:
            answer = work(), None
        except (WrongUse, Untrustworthy) as error:
            answer = None, error
        with os.fdopen(pipe, "wb") as answers:
            pickle.dump(answer, answers, protocol=5)

    def _limit(processor: int, memory: int) -> None:
        faulthandler.disable()
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        used = resource.getrusage(resource.RUSAGE_SELF)
        spent = int(used.ru_utime + used.ru_stime)
        resource.setrlimit(resource.RLIMIT_CPU, (spent + processor, spent + processor + 1))
        with suppress(OSError, ValueError):  # where there is no /proc, or the limit is lower already
            size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
            resource.setrlimit(resource.RLIMIT_AS, (size + memory, size + memory))


def keep_durable(file: int, ended: threading.Event) -> OSError | None:
    """Flush an open file to the disk four times a second until `ended` is set; return the error that occurred, if
    any.
    """
    while not ended.wait(_DURABLE):
        try:
            os.fsync(file)
        except OSError as error:
            return error
    return None


def process_mark(process: int) -> str:
    """Return a text that no other process has had or will have: when the computer and the process started.

    "" if there is no such process, or if the system does not tell, as on macOS.
    """
    try:
        stat = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
        return f"{since_boot()[0]} {stat.rpartition(')')[2].split()[19]}"
    except (OSError, IndexError):
        return ""


def is_at(file: int, path: Path) -> bool:
    """Return whether `path` is still the name of the open file."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(file), path.stat())
    return False


def open_binary(path: Path, flags: int) -> int:
    """Open a file for bytes, without any conversion of line ends; return its descriptor."""
    return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)


def since_boot() -> tuple[str, float]:
    """Return an identifier of the computer's last start, and the time since then, s. Setting the clock does not change
    this time.

    The identifier is "" if the system provides no identifier or no such time.
    """
    try:
        name = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return name, time.clock_gettime(time.CLOCK_BOOTTIME)
    except (OSError, ValueError, AttributeError):
        return "", 0.0
