"""A serial line that ends in an emulator: a pseudo-terminal behind a stable name.

A pty has no baud rate of its own; what the client set is read from it and handed on, so that a wrong one is not
understood. Linux and macOS only.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from sim_backend.wire.arrivals import Arrivals

if TYPE_CHECKING:
    from collections.abc import Sequence

_SPEEDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}
_IDLE = 0.05
"""s between two looks at the emulator while nothing is sent."""
_SPIN = 1.5e-4
"""s before a reply is due that are waited out awake: a sleeping process wakes up late by about as much."""


class SerialPeer(Protocol):
    """An emulator: bytes in, bytes out, with times in s."""

    @property
    def unplugged(self) -> bool:
        """Whether the cable has been pulled out."""
        ...

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:
        """Return what it sends, and when: unasked up to `now`, and in reply to `data`, sent at `now`."""
        ...

    def advance(self, now: float) -> None:
        """Carry it to `now`."""
        ...

    def due(self) -> float:
        """Return when it next sends something unasked; infinite where it does not."""
        ...


class PtyLine:
    """Serves `peer` at `link`, a symlink to the pty, in a thread, as long as the `with` lasts.

    any_baudrate: the peer understands whatever speed the client set. lock: held while the peer is at work; whoever
    looks at the peer takes it. Raises FileExistsError where `link` is something other than a symlink.
    """

    def __init__(self, link: Path, peer: SerialPeer, *, any_baudrate: bool = False) -> None:
        self.link = link
        self.lock = threading.Lock()
        self._peer = peer
        self._any_baudrate = any_baudrate
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._wake, self._waker = os.pipe()
        self._arrivals = Arrivals[bytes]()
        self._thread = threading.Thread(target=self.run, name=f"pty {link}")
        self._point()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._thread.join()
        self._close()

    def now(self) -> float:
        """The time on the peer's clock, s."""
        return time.monotonic()

    def stop(self) -> None:
        """Make `run` return."""
        with contextlib.suppress(OSError):
            os.write(self._waker, b"x")

    def run(self) -> None:
        """Serve until `stop` is called or the peer is unplugged."""
        while not self._peer.unplugged:
            next_ = min(self._arrivals.next() - _SPIN, self._peer.due())
            wait = max(0.0, min(_IDLE, next_ - self.now()))
            ready, _, _ = select.select([self._master, self._wake], [], [], wait)
            if self._wake in ready:
                return
            if self._master in ready:
                self._take(os.read(self._master, 4096))
            elif not self._arrivals:
                with self.lock:
                    self._peer.advance(self.now())
                self._take(b"")
            elif self._peer.due() <= self.now():
                self._take(b"")
            self._send()
        self._drop()

    def serve(self) -> None:
        """Serve in this thread until `stop` is called from another or from a signal, then clean up."""
        try:
            self.run()
        finally:
            self._close()

    def _take(self, data: bytes) -> None:
        speed = None if self._any_baudrate else _SPEEDS.get(termios.tcgetattr(self._master)[5], 0)
        with self.lock:
            self._arrivals.add(self._peer.receive(data, self.now(), speed))

    def _send(self) -> None:
        for reply in self._arrivals.until(self.now()):
            with contextlib.suppress(BlockingIOError):  # a client that never reads loses bytes, as on a real line
                os.write(self._master, reply)

    def _point(self) -> None:
        if self.link.exists() and not self.link.is_symlink():
            raise FileExistsError(f"{self.link} exists and is not a link: choose another name")
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.symlink_to(os.ttyname(self._slave))
        fresh.replace(self.link)

    def _drop(self) -> None:
        """Hang up, as a pulled cable does."""
        for descriptor in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(descriptor)
        self._master = self._slave = -1

    def _close(self) -> None:
        self._drop()
        os.close(self._wake)
        os.close(self._waker)
        if self.link.is_symlink():
            self.link.unlink()
