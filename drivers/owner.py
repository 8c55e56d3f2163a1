"""One owner of a link: a lock that the kernel frees when the owning process ends, and the id of that process.

A serial port is locked with flock, as pyserial does. A bus that is no file is locked by a socket's name, which only one
socket can have (abstract sockets of Linux, unix(7)). Neither lock leaves a file on the disk, and both exclude other
users' processes too.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import sys
from io import FileIO
from pathlib import Path

from drivers.servo import DriverError

if sys.platform != "win32":
    import fcntl

_COMMAND = 100  # characters of another program's command in a message


class Claim:
    """The lock of a link, held until `release`. Raises DriverError, which names the process that holds it already.

    link: name of the link in messages. device: path of its serial port, None if the link is no file; `link` is then the
    name that is locked. A missing device is not locked; the later attempt to open it reports the error.
    """

    def __init__(self, link: str, device: Path | None = None) -> None:
        self._held: socket.socket | FileIO | None = None
        if device is not None and sys.platform != "win32":
            self._lock(link, device)
        elif device is None and sys.platform == "linux":
            self._bind(link)

    @property
    def descriptor(self) -> int:
        """The descriptor of the lock, -1 without one. A process that inherits it keeps the lock."""
        return -1 if self._held is None else self._held.fileno()

    def release(self) -> None:
        """Free the lock. Harmless if it is free already."""
        held, self._held = self._held, None
        if held is not None:
            held.close()

    def _lock(self, link: str, device: Path) -> None:
        try:
            file = FileIO(os.open(device, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK))
        except OSError:
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            file.close()
            if isinstance(error, BlockingIOError):
                raise in_use(link, holder(device)) from None
            return
        self._held = file

    def _bind(self, link: str) -> None:
        address = b"\0hil: " + link.encode("utf-8", "surrogateescape")[:100]
        bound = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            bound.bind(address)
            bound.listen(socket.SOMAXCONN)  # each question who it is stays in this queue
        except OSError as error:
            bound.close()
            if error.errno == errno.EADDRINUSE:
                raise in_use(link, _listener(address)) from None
            return
        self._held = bound


def holder(device: Path) -> int:
    """Return the id of the process that has locked `device` with flock, 0 if /proc/locks does not show it."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        seen = device.stat()
        wanted = f"{os.major(seen.st_dev):02x}:{os.minor(seen.st_dev):02x}:{seen.st_ino}"
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()
            if words[1] == "FLOCK" and words[5] == wanted:
                return int(words[4])
    return 0


def in_use(link: str, pid: int) -> DriverError:
    """Return the error for a link that process `pid` holds; 0: a process that is not known."""
    if pid == os.getpid():
        return DriverError(f"{link} is open in this program already: close it there first")
    means = "two programs on one link garble each other's frames, and one switches the other's torque off"
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode("utf-8", "replace").split("\0")
    except OSError:
        return DriverError(f"{link} is in use: {means}; another program has it open: close that first")
    if "-c" in words[:-2]:  # the program's words name it better than its code
        words[1 : words.index("-c") + 2] = []
    words[:2] = [word.rpartition("/")[2] for word in words[:2]]  # the interpreter and the program
    command = "".join(one if one.isprintable() else "?" for one in " ".join(words).strip()[:_COMMAND])
    return DriverError(
        f"{link} is in use by process {pid} ({command}): {means}. Wait until it has ended, or end it with kill {pid}"
    )


def _listener(address: bytes) -> int:
    """Return the id of the process whose socket has the name `address`, 0 if the process has ended meanwhile."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        asking.connect(address)
        pid, _, _ = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        return int(pid)
    return 0
