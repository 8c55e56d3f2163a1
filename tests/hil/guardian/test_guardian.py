"""The guardian's process against a pipe in place of a drive: when it sends torque-off, and when it does not."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import pty
import signal
import socket
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.off_path import OffPath, OwnBus
from drivers.servo import Command, DriverError, Limits, Quantity, Sample, ServoInfo
from hil.guardian.handle import Guardian, GuardianFired, GuardianLost
from hil.guardian.process import Parent
from hil.guardian.servo import GuardedServo, Watch, guarded
from hil.stand.file import parse
from hil.stand.opening import open_servo

from ..conftest import copied, exit_status

OFF, RESTORE, RESYNC = b"off!", b"restore!", b"...."
LONG = 30.0  # s; never in a test


class Line:
    """A pipe: what the guardian sends can be read at its other end."""

    def __init__(self) -> None:
        self.end, self.descriptor = os.pipe()
        os.set_blocking(self.end, False)
        self.seen = b""

    def path(self, **changes: object) -> OffPath:
        fields: dict[str, object] = {"off": (OFF,), "restore": (RESTORE,), "resync": RESYNC}
        return OffPath(**(fields | {"descriptor": self.descriptor} | changes))  # type: ignore[arg-type]

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            self.seen += os.read(self.end, 1 << 16)
        return self.seen

    def close(self) -> None:
        os.close(self.end)
        os.close(self.descriptor)


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.close()


def until(done: Callable[[], bool]) -> bool:
    end = time.monotonic() + LONG
    while not done() and time.monotonic() < end:
        time.sleep(1e-3)
    return done()


def test_a_guardian_that_is_let_go_sends_nothing(line: Line) -> None:
    guardian = Guardian(line.path(), silence=LONG)
    guardian.beat()
    guardian.check()
    guardian.close()
    assert line.read() == b""


def test_without_a_sign_of_life_torque_off_is_sent_and_the_process_must_not_go_on(line: Line) -> None:
    guardian = Guardian(line.path(), silence=0.02)
    guardian.beat()
    assert until(lambda: guardian.fired)
    with pytest.raises(GuardianFired, match="gave no sign of life for 20 ms"):
        guardian.check()
    assert until(lambda: line.read().count(OFF) > 3)
    assert line.seen.startswith(RESYNC + OFF + RESYNC + OFF)
    guardian.close()
    assert RESTORE not in line.read()  # the process restores the settings when it closes the servo


def test_torque_off_is_sent_until_the_guardian_is_dismissed(line: Line) -> None:
    guardian = Guardian(line.path(), silence=0.02)
    guardian.beat()
    sending = 0.3 / OffPath(()).interval  # packets, in longer than the burst that follows the end of a process
    assert until(lambda: line.read().count(OFF) > sending)
    guardian.stand_down()
    count = line.read().count(OFF)
    time.sleep(0.05)
    assert line.read().count(OFF) == count
    guardian.close()


def test_while_a_slow_reply_is_awaited_no_sign_of_life_is_due(line: Line) -> None:
    guardian = Guardian(line.path(), silence=1e-3)
    guardian.beat(LONG)
    time.sleep(0.05)
    assert not guardian.fired
    guardian.close()


def test_while_the_torque_is_off_no_sign_of_life_is_due(line: Line) -> None:
    guardian = Guardian(line.path(), silence=1e-3)
    guardian.beat()
    guardian.expect(float("inf"))
    fired = guardian.fired
    time.sleep(0.05)
    assert guardian.fired == fired
    guardian.close()


def test_a_process_that_lives_longer_than_its_profile_is_switched_off_although_it_gives_signs_of_life(
    line: Line,
) -> None:
    guardian = Guardian(line.path(), silence=LONG)
    guardian.limit(0.05)
    while not guardian.fired:
        guardian.beat()
        time.sleep(1e-3)
    with pytest.raises(GuardianFired, match="longer than its profile"):
        guardian.check()
    guardian.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_guardian_that_is_gone_or_frozen_is_noticed(line: Line, number: int) -> None:
    guardian = Guardian(line.path(), silence=LONG)
    guardian.beat()
    guardian.check()
    os.kill(guardian._process.pid, number)

    def lost() -> bool:
        try:
            guardian.check()
        except GuardianLost:
            return True
        return False

    assert until(lost)
    guardian._process.kill()
    guardian.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_signals_of_a_terminal_do_not_end_it(line: Line, number: int) -> None:
    guardian = Guardian(line.path(), silence=LONG)
    assert os.getsid(guardian._process.pid) == guardian._process.pid
    os.kill(guardian._process.pid, number)
    guardian.beat()
    time.sleep(0.05)
    guardian.check()
    guardian.close()


def test_a_link_that_cannot_be_opened_a_second_time_is_refused_before_anything_is_driven(line: Line) -> None:
    path = line.path(descriptor=-1, bus=OwnBus("no_such_interface", "0", 1_000_000), name="no_such_interface 0")
    with pytest.raises(DriverError, match=r"the guardian cannot be started .*--no-guardian"):
        Guardian(path, silence=LONG)


@contextlib.contextmanager
def guarded_process(path: OffPath, folder: Path) -> Iterator[int]:
    """A process that has a guardian and gives no sign of life after the first."""

    def drive() -> None:
        faulthandler.disable()  # it would print where SIGSEGV came
        guardian = Guardian(path, silence=LONG)
        guardian.beat()
        (folder / "ready").touch()
        signal.pause()

    process = copied(drive)
    try:
        assert until((folder / "ready").exists)
        yield process
    finally:
        os.kill(process, signal.SIGKILL)
        exit_status(process)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP])
def test_a_process_that_dies_or_is_stopped_has_its_torque_switched_off(
    line: Line, number: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with guarded_process(line.path(), tmp_path) as process:
        os.kill(process, number)
        assert until(lambda: line.read().count(OFF) > 3)
        assert line.seen.startswith(RESYNC + OFF)
        if number == signal.SIGSTOP:
            assert RESTORE not in line.seen  # it may come back
            os.kill(process, signal.SIGKILL)
        assert until(lambda: line.read().endswith(RESTORE))
    said: list[str] = []

    def announced() -> bool:
        said.append(capfd.readouterr().err)
        return "".join(said).endswith("; if the motor still pulls, cut its power\n")

    assert until(announced)
    assert "hil: the process that drove the motor " in "".join(said)


def test_a_process_that_is_killed_has_its_torque_switched_off_by_datagrams(tmp_path: Path) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as there, socket.socket(type=socket.SOCK_DGRAM) as own:
        there.bind(("127.0.0.1", 0))
        there.settimeout(LONG)
        path = OffPath((OFF,), (RESTORE,), descriptor=own.fileno(), to=there.getsockname())
        with guarded_process(path, tmp_path) as process:
            os.kill(process, signal.SIGKILL)
            assert there.recv(100) == OFF
            while there.recv(100) != RESTORE:  # or it times out
                pass


def test_a_process_that_is_killed_has_its_torque_switched_off_on_a_bus_that_the_guardian_opens(tmp_path: Path) -> None:
    """A serial adapter, to which the guardian writes the frame 001 without data."""
    end, adapter = pty.openpty()
    tty.setraw(adapter)
    os.set_blocking(end, False)
    seen = bytearray()

    def heard(frame: bytes) -> bool:
        with contextlib.suppress(BlockingIOError):
            seen.extend(os.read(end, 1 << 16))
        return frame in seen

    bus = OwnBus("slcan", os.ttyname(adapter), 1_000_000)
    with guarded_process(OffPath((b"t0010\r",), (b"t0020\r",), bus=bus), tmp_path) as process:
        assert not heard(b"t0010")
        os.kill(process, signal.SIGKILL)
        assert until(lambda: heard(b"t0010\r"))
        assert until(lambda: heard(b"t0020\r"))
    os.close(end)
    os.close(adapter)


@pytest.mark.parametrize(
    ("state", "flags", "still", "ends"),
    [("T", 0, True, False), ("S", 0, False, False), ("R", 0x400004, False, True), ("t", 0x40, True, False)],
)
def test_the_state_of_a_process_is_read_behind_its_name(
    state: str, flags: int, still: bool, ends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard, commands = os.pipe()
    parent = Parent(os.getppid(), heard)
    monkeypatch.setattr(os, "pread", lambda *_: f"1 (a) T) {state} 1 2 3 0 -1 {flags} 7\n".encode())
    assert (parent.stands_still(), parent.ends()) == (still, ends)
    os.close(heard)
    os.close(commands)


def test_as_process_1_of_a_container_no_guardian_is_started(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getpid", lambda: 1)
    with pytest.raises(DriverError, match=r"process 1 of its container.*docker run --init.*nothing was driven"):
        Guardian(line.path(), silence=LONG)


# --- the servo under a guardian --------------------------------------------------------------------------------------


class Piped:
    """A servo whose link is a pipe."""

    def __init__(self, line: Line) -> None:
        self.clock: Clock = MonotonicClock()
        self.info = ServoInfo("pipe", "pipe")
        self.line = line
        self.done: list[str] = []
        self.unconfirmed = 0
        self.takes = 0.0
        self.restore: tuple[bytes, ...] = ()

    def off_path(self) -> OffPath:
        return self.line.path(restore=self.restore)

    def arm(self, limits: Limits) -> None:
        del limits
        self.done.append("arm")

    def exchange(self, command: Command) -> Sample:
        self.done.append(f"exchange {command.value:g}")
        time.sleep(self.takes)
        return Sample(self.clock.now(), self.clock.now())

    def disarm(self) -> None:
        self.done.append("disarm")
        if self.unconfirmed:
            self.unconfirmed -= 1
            raise DriverError("not confirmed")

    def close(self) -> None:
        self.done.append("close")


LIMITS = Limits(1.0, 1.0, 80.0, (-1.0, 1.0))
HALF = Command(Quantity.TORQUE, 0.5)


def test_a_whole_run_under_a_guardian_sends_no_torque_off_of_its_own(line: Line) -> None:
    inner = Piped(line)
    servo = guarded(inner, Watch(silence=LONG))
    servo.exchange(Command.rest())
    servo.arm(LIMITS)
    servo.clock.sleep_until(servo.clock.now() + 0.02)
    servo.exchange(HALF)
    servo.disarm()
    servo.close()
    servo.close()
    assert inner.done == ["exchange 0", "arm", "exchange 0.5", "disarm", "close", "close"]
    assert line.read() == b""


def test_a_setting_that_opening_has_changed_is_restored_where_the_process_dies_before_it_arms(line: Line) -> None:
    inner = Piped(line)
    inner.restore = (RESTORE,)

    def die() -> None:
        guarded(inner, Watch(silence=LONG))
        os.kill(os.getpid(), signal.SIGKILL)

    assert exit_status(copied(die)) == -signal.SIGKILL
    assert until(lambda: line.read().endswith(RESTORE))
    assert OFF in line.seen


@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)], ids=str)
def test_a_drive_is_released_although_standard_files_were_closed(
    line: Line, monkeypatch: pytest.MonkeyPatch, closed: tuple[int, ...]
) -> None:
    """The port would get the lowest of their numbers, and the guardian's pipe would replace it."""

    def opened(*_: object) -> Piped:
        line.descriptor = os.dup(line.descriptor)
        return Piped(line)

    stand = parse('[stand]\nbackend = "dynamixel"\n[dynamixel]\nport = "x"\nmodel = "xl330-m288"\n')

    def drive() -> None:
        for number in closed:
            os.close(number)
        servo, _ = open_servo(stand, watch=Watch(LONG))
        servo.arm(LIMITS)
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr("hil.stand.opening.open_backend", opened)
    assert exit_status(copied(drive)) == -signal.SIGKILL
    assert until(lambda: OFF in line.read())


def test_a_servo_whose_guardian_cannot_be_started_is_closed(line: Line) -> None:
    inner = Piped(line)
    gone = line.path(descriptor=-1, restore=(RESTORE,), bus=OwnBus("serial-nowhere", "none", 1))
    inner.off_path = lambda: gone  # type: ignore[method-assign]  # an adapter that cannot be opened a second time
    with pytest.raises(DriverError, match="the guardian cannot be started"):
        guarded(inner, Watch())
    assert inner.done == ["close"]


def test_no_set_point_is_sent_once_the_guardian_has_acted(line: Line) -> None:
    inner = Piped(line)
    servo = GuardedServo(inner, inner, Watch(silence=0.02))
    servo.arm(LIMITS)
    assert until(lambda: OFF in line.read())
    for _ in range(3):
        with pytest.raises(GuardianFired):
            servo.exchange(HALF)
        with pytest.raises(GuardianFired):  # a run that was stopped ends with this reason, not with a late tick
            servo.clock.sleep_until(servo.clock.now())
    servo.disarm()
    sent = len(line.read())
    with pytest.raises(GuardianFired):
        servo.arm(LIMITS)
    servo.close()
    assert inner.done == ["arm", "disarm", "close"]
    assert len(line.read()) == sent  # it was dismissed before the disarm


def test_a_wait_between_two_set_points_gives_signs_of_life(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = Piped(line)
    servo = GuardedServo(inner, inner, Watch(silence=LONG))
    servo.arm(LIMITS)
    beats: list[float] = []
    monkeypatch.setattr(Guardian, "beat", lambda _: beats.append(servo.clock.now()))
    servo.clock.sleep_until(servo.clock.now() + 0.1)
    assert len(beats) >= 3
    servo.close()


def test_a_line_that_is_always_slow_is_not_taken_for_silence(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next sign of life is due as much later as a reply at rest usually takes, but for 100 ms at most."""
    granted: list[float] = []
    monkeypatch.setattr(Guardian, "beat", lambda _, takes=0.0: granted.append(takes))
    for takes, least in ((0.02, 0.02), (0.15, 0.1)):
        inner = Piped(line)
        inner.takes = takes
        servo = GuardedServo(inner, inner, Watch(silence=LONG))
        for _ in range(3):
            servo.exchange(Command.rest())
        servo.arm(LIMITS)
        servo.exchange(HALF)
        servo.close()
        assert least <= granted[-1] <= 0.1


def test_a_torque_off_that_the_drive_does_not_confirm_is_sent_by_the_guardian_too(line: Line) -> None:
    inner = Piped(line)
    inner.unconfirmed = 5
    servo = GuardedServo(inner, inner, Watch(silence=LONG))
    servo.arm(LIMITS)
    with pytest.raises(DriverError, match="not confirmed"):
        servo.disarm()
    servo.close()
    assert until(lambda: OFF in line.read())


def test_a_servo_without_another_way_to_its_drive_is_left_as_it_is(line: Line) -> None:
    inner = Piped(line)
    inner.off_path = lambda: line.path(descriptor=-1)  # type: ignore[method-assign]  # simulated in this process
    assert guarded(inner, Watch()) is inner


def test_a_servo_in_virtual_time_is_left_as_it_is(line: Line) -> None:
    inner = Piped(line)
    inner.clock = VirtualClock()
    assert guarded(inner, Watch()) is inner
