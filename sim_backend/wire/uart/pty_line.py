"""A serial line to an emulator: a pseudo-terminal (pty) that clients open through a symlink with a fixed name. Linux
and macOS only.

A pty has no baud rate of its own. The rate that the client set is read from the pty and passed to the emulator, so that
a wrong rate has its real effect. As on a serial port, a client's exclusive lock ends when the last client closes the
port or dies, and bytes that are sent while no client has the port open are lost.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import select
import struct
import termios
import threading
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from sim_backend.wire.arrivals import Arrivals
from sim_backend.wire.uart.openings import Openings

if TYPE_CHECKING:
    from collections.abc import Sequence

_SPEEDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}
_TCGETS2 = 0x802C542A
_TIOCGEXCL = 0x80045440
_TERMIOS2 = struct.Struct("=4I20s2I")
"""Layout of Linux's termios2: flags, characters, input and output speed in bit/s. It holds every speed; `tcgetattr`
knows only the speeds of the table above.
"""
_STEP, _LONGEST_STEP = 0.05, 0.25
"""s by which the emulator is simulated at a time while nothing is sent: at first, and after a longer silence."""
_LOOK = 2e-3
"""s between two checks for a client, on a system (macOS) where no event tells that a client opened the port."""
_SPIN = 1.5e-4
"""s before a reply is to be sent during which the thread does not sleep, because a sleeping process wakes up about that
much too late.
"""


class SerialPeer(Protocol):
    """The interface of an emulator on a serial line: bytes in, bytes out, with times in s."""

    @property
    def unplugged(self) -> bool:
        """Return whether the cable has been pulled out."""

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:
        """Receive `data` at `now`, s. Return what the emulator sends, with times: in reply to `data`, and without a
        request up to `now`.

        baudrate: bit/s that the client has set; None: the right one.
        """

    def advance(self, now: float) -> None:
        """Simulate the emulator up to `now`, s, while no client has the port open. What it sends without a request may
        be lost.
        """

    def due(self) -> float:
        """Return the time at which the emulator next sends something without a request, s; infinity if it never
        does.
        """


class PtyLine:
    """Serves the emulator `peer` on a pty. `link` is a symlink to the pty. A thread serves inside the `with` block.

    any_baudrate: whether the emulator accepts every baud rate that the client sets. lock: a lock held while the
    emulator is simulated; whoever reads the emulator's state must take it. Raises FileExistsError if `link` exists and
    is no symlink.
    """

    def __init__(self, link: Path, peer: SerialPeer, *, any_baudrate: bool = False) -> None:
        self.link = link
        self.lock = threading.Lock()
        self._peer = peer
        self._any_baudrate = any_baudrate
        self._master = -1
        self._name = ""
        self._present = False
        """Whether a client has the port open."""
        self._left_locked = False
        """Whether the port was found locked. If the next check finds no client, the lock is left from a client that is
        gone.
        """
        self._asked = -math.inf
        """Time at which a client last sent something, s."""
        self._unsure = True
        """Whether a client may have opened the port without an event that reports it."""
        self._open()
        self._wake, self._waker = os.pipe()
        self._arrivals = Arrivals[bytes]()
        self._thread = threading.Thread(target=self.run, name=f"pty {link}")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._thread.join()
        self._close()

    def now(self) -> float:
        """The time on the emulator's clock, s."""
        return time.monotonic()

    def stop(self) -> None:
        """Make `run` return."""
        with contextlib.suppress(OSError):
            os.write(self._waker, b"x")

    def run(self) -> None:
        """Serve until `stop` is called or the peer is unplugged."""
        step, advanced = _STEP, self.now()
        while not self._peer.unplugged:
            if self._wait(advanced + step):
                return
            data = self._read()
            self._asked = self.now() if data else self._asked
            idle = self.now() >= advanced + step
            if idle:
                advanced = self.now()
            if idle and not self._present:
                self._pass(advanced)
            step = _STEP if data else min(2.0 * step, _LONGEST_STEP) if idle else step
            if data or (self._present and (idle or self._peer.due() <= self.now())):
                self._take(data)
            self._send()
        self._drop()

    def _wait(self, until: float) -> bool:
        """Wait until a client opens the port or sends bytes, or there is something to send, but no longer than `until`,
        s. Return whether `stop` was called.
        """
        if self._present:
            spin = _SPIN if self.now() < self._asked + _STEP else 0.0
            until = min(until, self._arrivals.next() - spin, self._peer.due())
        elif self._unsure or not self._openings.files:
            until = min(until, self.now() + _LOOK)
        files = [self._wake, *([self._master] if self._present else self._openings.files)]
        ready, _, _ = select.select(files, [], [], max(0.0, until - self.now()))
        return self._wake in ready

    def serve(self) -> None:
        """Serve in this thread until `stop` is called from another thread or from a signal, then remove the symlink."""
        try:
            self.run()
        finally:
            self._close()

    def _read(self) -> bytes:
        """Return what a client has sent. Without a client the read fails (Linux) or returns nothing (macOS)."""
        touched, self._unsure = not self._present and self._openings.seen(), False
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            self._present, self._left_locked = True, False
            return b""
        except OSError:
            data = b""
        was, self._present = self._present, bool(data)
        if data:
            self._left_locked = False
        elif self._left_locked:
            self._unlock()
        elif was or touched:
            self._end_session()
        return data

    def _pass(self, now: float) -> None:
        """Simulate the emulator up to `now` for a time in which no client had the port open."""
        with self.lock:
            self._peer.advance(now)
        self._end_session()  # one so short that it was not seen may have locked the port

    def _take(self, data: bytes) -> None:
        speed = None if self._any_baudrate else _speed(self._master)
        with self.lock:
            self._arrivals.add(self._peer.receive(data, self.now(), speed))

    def _end_session(self) -> None:
        """After the last client closed the port: discard unread bytes, as a serial port does, and check whether the
        port is locked.

        A new client may have opened and locked the port meanwhile. The next check finds out.
        """
        try:
            slave = os.open(self._name, os.O_RDWR | os.O_NOCTTY)
        except OSError:  # the lock keeps out whoever is not root
            self._left_locked = self._unsure = True
            return
        termios.tcflush(slave, termios.TCIFLUSH)
        self._left_locked = _locked(slave)
        os.close(slave)
        self._forget_own()

    def _unlock(self) -> None:
        """Remove the exclusive lock that a client left, as the last close of a serial port does."""
        self._left_locked = False
        try:
            slave = os.open(self._name, os.O_RDWR | os.O_NOCTTY)
        except OSError:  # the lock keeps out whoever is not root
            os.close(self._master)
            self._openings.close()
            self._open()
            self._unsure = True
            return
        fcntl.ioctl(slave, termios.TIOCNXCL)
        os.close(slave)
        self._forget_own()

    def _forget_own(self) -> None:
        """Discard the events that this program's own opening of the port caused. A client may have opened the port at
        the same time, so check once more.
        """
        self._openings.seen()
        self._unsure = True

    def _send(self) -> None:
        for reply in self._arrivals.until(self.now()):
            if not self._present:
                continue
            with contextlib.suppress(BlockingIOError):  # a client that never reads loses bytes, as on a real line
                os.write(self._master, reply)

    def _open(self) -> None:
        """Make a pty and point the symlink to it. This program closes the client's end, so that it notices when the
        last client closes.
        """
        if self.link.exists() and not self.link.is_symlink():
            raise FileExistsError(f"{self.link} exists and is not a link: choose another name")
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._openings = Openings(self._name)
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.symlink_to(self._name)
        fresh.replace(self.link)

    def _drop(self) -> None:
        """Close the pty, which a client sees as an unplugged cable."""
        with contextlib.suppress(OSError):
            os.close(self._master)
        self._master = -1

    def _close(self) -> None:
        self._drop()
        self._openings.close()
        os.close(self._wake)
        os.close(self._waker)
        with contextlib.suppress(OSError):  # it is gone, or leads to another emulator by now
            if self.link.readlink() == Path(self._name):
                self.link.unlink()


def _speed(descriptor: int) -> int:
    """Return the baud rate that the client set, bit/s; 0 if it is not known."""
    with contextlib.suppress(OSError):
        return int(_TERMIOS2.unpack(fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size)))[-1])
    return _SPEEDS.get(termios.tcgetattr(descriptor)[5], 0)


def _locked(descriptor: int) -> bool:
    """Return whether a client has locked the port. macOS does not report this; True is returned then."""
    try:
        return fcntl.ioctl(descriptor, _TIOCGEXCL, bytes(4)) != bytes(4)
    except OSError:
        return True
