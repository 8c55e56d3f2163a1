"""The pseudo-terminal as a serial port: every speed, locks that end with their program, and no bytes from before."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from sim_backend.wire.catalogue import waking_in_time
from sim_backend.wire.uart.pty_line import PtyLine

TIOCGEXCL = 0x80045440
"""Linux: whether the terminal is locked, the lock that root opens in spite of."""


class Recorder:
    """A peer that keeps what it hears and at which speed, and says what it is given."""

    unplugged = False

    def __init__(self) -> None:
        self.heard = b""
        self.speed: int | None = None
        self.to_say: list[bytes] = []

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:
        self.heard += data
        self.speed = baudrate if data else self.speed
        said, self.to_say = self.to_say, []
        return [(now, part) for part in said]

    def advance(self, now: float) -> None:
        del now
        self.to_say = []

    def due(self) -> float:
        return 0.0 if self.to_say else float("inf")


@pytest.fixture
def peer() -> Recorder:
    return Recorder()


@pytest.fixture
def line(tmp_path: Path, peer: Recorder) -> Iterator[PtyLine]:
    with PtyLine(tmp_path / "tty", peer) as served:
        yield served


@contextmanager
def opened(line: PtyLine) -> Iterator[int]:
    """A client that, unlike pyserial, discards nothing when it opens the port."""
    descriptor = os.open(line.link, os.O_RDWR | os.O_NOCTTY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def eventually(holds: Callable[[], bool]) -> bool:
    end = time.monotonic() + 10.0
    while not holds() and time.monotonic() < end:
        time.sleep(1e-3)
    return holds()


@pytest.mark.parametrize("speed", [9600, 57600, 250_000, 1_000_000, 4_500_000, 123_456])
def test_any_speed_that_a_client_can_set_is_heard(line: PtyLine, peer: Recorder, speed: int) -> None:
    with serial.Serial(str(line.link), speed) as port:
        port.write(b"a")
        assert eventually(lambda: peer.heard == b"a")
    assert peer.speed == speed


def test_a_speed_set_in_the_way_of_rust_programs_is_heard(line: PtyLine, peer: Recorder) -> None:
    """TCSETS2 with BOTHER, also for a speed that has a name of its own."""
    layout = struct.Struct("=4I20s2I")
    with opened(line) as port:
        iflag, oflag, cflag, lflag, chars, _, _ = layout.unpack(fcntl.ioctl(port, 0x802C542A, bytes(44)))
        bother = cflag & ~0o10017 | 0o10000
        fcntl.ioctl(port, 0x402C542B, layout.pack(iflag, oflag, bother, lflag, chars, 57600, 57600))
        os.write(port, b"a")
        assert eventually(lambda: peer.heard == b"a")
    assert peer.speed == 57600


def asked(line: PtyLine, request: int) -> int:
    """Return the answer to an ioctl with a whole number as its answer."""
    with opened(line) as port:
        return int(struct.unpack("i", fcntl.ioctl(port, request, bytes(4)))[0])


def locked(line: PtyLine) -> bool:
    try:
        return asked(line, TIOCGEXCL) != 0
    except OSError as error:  # everyone but root is kept out
        return error.errno == errno.EBUSY


def test_the_lock_of_a_killed_program_ends_with_it(line: PtyLine) -> None:
    program = (
        "import fcntl, os, sys, termios\n"
        "fcntl.ioctl(os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY), termios.TIOCEXCL)\n"
        "print('locked', flush=True)\n"
        "sys.stdin.read()\n"
    )
    arguments = [sys.executable, "-c", program, str(line.link)]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        assert client.stdout.readline() == "locked\n"
        assert locked(line)
        client.kill()
    assert eventually(lambda: not locked(line))


def test_a_lock_outlives_the_close_of_another_program(line: PtyLine) -> None:
    with opened(line) as port:
        fcntl.ioctl(port, termios.TIOCEXCL)
        for _ in range(20):
            assert locked(line)
    assert eventually(lambda: not locked(line))


def test_a_lock_that_is_taken_just_as_the_line_is_found_unused_stays(tmp_path: Path) -> None:
    """One line in two was unlocked when this raced with the look for a session that has ended."""
    for number in range(20):
        with PtyLine(tmp_path / f"tty{number}", Recorder()) as line, opened(line) as port:
            fcntl.ioctl(port, termios.TIOCEXCL)
            assert all(locked(line) for _ in range(3))


def test_bytes_sent_while_nobody_listens_are_lost(line: PtyLine, peer: Recorder) -> None:
    peer.to_say = [b"before"]
    assert eventually(lambda: not peer.to_say)
    with opened(line) as port:
        os.write(port, b"a")
        assert eventually(lambda: peer.heard == b"a")
        peer.to_say = [b"now"]
        assert os.read(port, 100) == b"now"


def test_bytes_that_a_client_left_unread_do_not_reach_the_next(line: PtyLine, peer: Recorder) -> None:
    with opened(line) as port:
        os.write(port, b"a")
        assert eventually(lambda: peer.heard == b"a")  # what it says before it has seen the client is lost
        peer.to_say = [b"first"]
        assert eventually(lambda: select.select([port], [], [], 0.0)[0] != [])
    assert eventually(lambda: asked(line, termios.FIONREAD) == 0)


def test_what_a_client_sent_just_before_it_closed_is_heard(line: PtyLine, peer: Recorder) -> None:
    for _ in range(20):
        with serial.Serial(str(line.link)) as port:
            port.write(b"off")
    assert eventually(lambda: peer.heard == b"off" * 20)


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="Linux sets the scheduling of a thread")
def test_an_emulator_wakes_up_before_busy_programs_where_the_system_permits_it_and_only_while_it_serves() -> None:
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
        permitted = True
        os.sched_setscheduler(0, before, os.sched_param(0))
    except PermissionError:
        permitted = False
    with waking_in_time():
        assert os.sched_getscheduler(0) == (os.SCHED_RR if permitted else before)
    assert os.sched_getscheduler(0) == before
