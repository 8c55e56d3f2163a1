"""The gate without a device: how often torque-off is requested, what is raised, and what ends nothing early."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import pytest

from drivers.clock import VirtualClock
from drivers.gate import Gate, to_counts, watchdog_problem
from drivers.servo import (
    BadReply,
    Command,
    DriverError,
    Limits,
    LinkLost,
    NoReply,
    Quantity,
    Sample,
    ServoInfo,
    UnsafeCommand,
)
from drivers.torque_off import Driven, confirm_torque_off

LIMITS = Limits(torque=0.1, velocity=10.0, temperature=60.0, position=(-1.0, 1.0))
PUSH = Command(Quantity.TORQUE, 0.05)


class Device:
    """A protocol that counts requests. fails: raised by the next requests, one each."""

    def __init__(self, *fails: BaseException) -> None:
        self.fails = list(fails)
        self.requests: list[int] = []
        self.released = 0
        self.gate = Gate("the line", frozenset({Quantity.TORQUE}), torque_off=self.off, release=self.release)
        self.clock = VirtualClock()

    def off(self, request: int) -> None:
        self.requests.append(request)
        if self.fails:
            raise self.fails.pop(0)

    def release(self) -> None:
        self.released += 1

    def disarm(self) -> None:
        self.gate.disarm()


class Interrupting(VirtualClock):
    """Every pause is interrupted."""

    def sleep_until(self, t: float) -> None:  # noqa: ARG002 - the interface's
        raise KeyboardInterrupt


def armed(*fails: BaseException) -> Device:
    device = Device(*fails)
    with device.gate.arming(LIMITS):
        pass
    return device


def test_torque_off_is_requested_until_it_is_confirmed_and_then_no_more() -> None:
    device = armed(NoReply("lost"), NoReply("lost"))
    device.gate.disarm()
    device.gate.disarm()
    assert device.requests == [0, 1, 2]


@pytest.mark.parametrize(("fail", "kind"), [(NoReply, DriverError), (LinkLost, LinkLost)])
def test_an_unconfirmed_torque_off_is_raised_with_its_cause_and_may_be_requested_again(
    fail: Callable[[str], DriverError], kind: type[DriverError]
) -> None:
    device = armed(*[fail("no answer") for _ in range(3)])
    with pytest.raises(kind, match=r"not confirmed \(no answer\).*cut the drive's power"):
        device.gate.disarm()
    assert device.gate.live
    with pytest.raises(UnsafeCommand):
        device.gate.admit(PUSH)
    device.gate.disarm()
    assert not device.gate.live


@pytest.mark.parametrize("error", [DriverError("refused"), KeyboardInterrupt(), ValueError("a bug")])
def test_a_failed_arming_leaves_the_servo_disarmed_with_torque_off_requested(error: BaseException) -> None:
    device = Device()
    device.gate.live = False
    with pytest.raises(type(error)), device.gate.arming(LIMITS):
        raise error
    assert device.requests == [0]
    assert not device.gate.armed


def test_arming_again_that_fails_does_not_leave_the_old_limits() -> None:
    device = armed()
    with pytest.raises(DriverError), device.gate.arming(LIMITS):
        raise DriverError("refused")
    with pytest.raises(UnsafeCommand):
        device.gate.admit(PUSH)


@pytest.mark.parametrize("stops", [True, False])
def test_a_servo_that_cannot_be_opened_is_stopped_unconfirmed_and_its_link_closed(stops: bool) -> None:
    device = Device()
    calls: list[str] = []

    def stop() -> None:
        calls.append("stop")
        if not stops:
            raise LinkLost("gone")

    with pytest.raises(NoReply), device.gate.opening(stop):
        raise NoReply("nobody")
    assert calls == ["stop"]
    assert device.released == 1
    with pytest.raises(LinkLost):
        device.gate.require_open()


def test_closing_restores_and_releases_once_though_torque_off_and_restoring_fail() -> None:
    device = armed(*[LinkLost("gone") for _ in range(3)])
    restored: list[bool] = []

    def restore() -> None:
        restored.append(True)
        raise LinkLost("gone")

    device.gate.close(restore)
    device.gate.close(restore)
    assert (device.released, restored) == (1, [True])


def test_the_link_is_closed_though_an_interrupt_ends_the_torque_off() -> None:
    device = armed(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        device.gate.close()
    assert device.released == 1


def test_a_command_is_clamped_to_the_limits_that_were_armed() -> None:
    device = armed()
    assert device.gate.admit(PUSH) == (PUSH, False)
    admitted = device.gate.admit(Command(Quantity.TORQUE, -1.0))
    assert admitted == (Command(Quantity.TORQUE, -0.1), True)


def test_confirming_outlasts_errors_and_interrupts_and_reports_the_interrupt() -> None:
    device = armed(KeyboardInterrupt(), ValueError("a bug"), NoReply("lost"))
    device.fails += [NoReply("lost"), NoReply("lost"), KeyboardInterrupt()]
    result = confirm_torque_off(device)  # type: ignore[arg-type]  # only what it calls
    assert (result.confirmed, result.alarm) == (True, "")
    assert isinstance(result.error, KeyboardInterrupt)


def test_the_alarm_comes_after_0_7_s_and_the_requests_go_on_until_5_s_though_it_blocks() -> None:
    device = armed(*[NoReply("lost") for _ in range(1000)])
    terminal, alarms = threading.Event(), list[tuple[float, str]]()
    before = set(threading.enumerate())

    def stopped(text: str) -> None:
        alarms.append((device.clock.now(), text))
        terminal.wait(5.0)

    result = confirm_torque_off(device, alarm=stopped)  # type: ignore[arg-type]  # only what it calls
    terminal.set()
    for saying in set(threading.enumerate()) - before:
        saying.join()
    assert not result.confirmed
    ((after, text),) = alarms
    assert text == result.alarm == "CUT THE POWER: the torque-off is not confirmed (lost)"
    assert after == pytest.approx(0.7)
    assert device.clock.now() == pytest.approx(5.0)


def test_confirming_survives_interrupts_of_its_pauses() -> None:
    device = armed(*[NoReply("lost") for _ in range(30)])
    device.clock = Interrupting()
    result = confirm_torque_off(device)  # type: ignore[arg-type]  # only what it calls
    assert result.confirmed
    assert isinstance(result.error, KeyboardInterrupt)


class Pulling(Device):
    """A device that confirms every torque-off and reports these torques after it, N m."""

    info = ServoInfo("test", "pulling", torque_lsb=1e-3)

    def __init__(self, *torques: float) -> None:
        super().__init__()
        self._torques = list(torques)

    def exchange(self, command: Command) -> Sample:
        assert command == Command.rest()
        return Sample(0.0, 0.0, motor_torque=self._torques.pop(0) if len(self._torques) > 1 else self._torques[0])


def driven(limit: float = 0.1, torque: float = 0.08, angle: float = 0.5) -> Driven:
    """A motor that a torque had turned to an angle, within 1 rad of its rest at 2 rad."""
    limits = Limits(torque=limit, velocity=10.0, temperature=60.0, position=(1.0, 3.0))
    return Driven(limits, Sample(0.0, 0.0, motor_torque=torque, motor_position=2.0 + angle))


@pytest.mark.parametrize(
    ("torques", "how", "off"),
    [
        ((0.02,), driven(), False),
        ((-0.02,), driven(), False),
        ((0.09, 0.05, 0.02, 0.009), driven(), True),
        ((0.002,), driven(0.01), True),
        ((math.nan,), driven(), True),
        ((0.02,), None, True),
    ],
    ids=["pulls", "pulls the other way", "current decays", "within three counts", "not measured", "never driven"],
)
def test_a_device_that_confirms_and_still_reports_torque_has_not_confirmed(
    torques: tuple[float, ...], how: Driven | None, off: bool
) -> None:
    alarms: list[str] = []
    result = confirm_torque_off(Pulling(*torques), how, alarms.append)  # type: ignore[arg-type]  # only what it calls
    assert result.confirmed == off
    assert alarms == [result.alarm] * (not off)
    assert ("CUT THE POWER" in result.alarm) != off


class Unreliable(Pulling):
    """A device that reports the same torque after every torque-off, in a fraction of the replies: the others fail."""

    def __init__(self, error: Exception, lost: int) -> None:
        super().__init__(0.02)
        self._error, self._lost = error, lost

    def exchange(self, command: Command) -> Sample:
        self._lost -= 1
        if self._lost >= 0:
            raise self._error
        return super().exchange(command)


@pytest.mark.parametrize(
    ("error", "lost", "off"),
    [
        (NoReply("lost"), 1, False),
        (BadReply("cut"), 3, False),
        (NoReply("lost"), 100, True),
        (LinkLost("gone"), 1, True),
    ],
    ids=["one lost", "some damaged", "silent", "no link"],
)
def test_a_reply_that_is_lost_hides_no_torque(error: Exception, lost: int, *, off: bool) -> None:
    result = confirm_torque_off(Unreliable(error, lost), driven())  # type: ignore[arg-type]  # only what it calls
    assert result.confirmed == off


class Staying(Pulling):
    """A device that confirms every torque-off, measures no torque then, and reports these angles after it, rad."""

    info = ServoInfo("test", "staying", position_lsb=1e-3, measures_when_off=False)

    def exchange(self, command: Command) -> Sample:
        return Sample(0.0, 0.0, motor_torque=0.0, motor_position=super().exchange(command).motor_torque)


@pytest.mark.parametrize(
    ("angles", "how", "off"),
    [
        ((2.49,), driven(), False),
        ((1.51,), driven(angle=-0.5, torque=-0.08), False),
        ((2.3,), driven(torque=math.nan), False),
        ((2.49, 2.4, 2.2), driven(), True),
        ((2.5,), driven(torque=0.009), True),
        ((2.05,), driven(torque=math.nan, angle=0.05), True),
        ((2.004,), driven(angle=0.004), True),
        ((1.5,), driven(), True),
        ((math.nan,), driven(), True),
    ],
    ids=[
        "stays",
        "stays on the other side",
        "never measures torque",
        "returns",
        "hardly loaded",
        "hardly turned",
        "within five counts",
        "swings beyond",
        "no angle",
    ],
)
def test_a_motor_that_measures_no_torque_when_off_must_return_from_where_its_torque_had_turned_it(
    angles: tuple[float, ...], how: Driven, off: bool
) -> None:
    result = confirm_torque_off(Staying(*angles), how)  # type: ignore[arg-type]  # only what it calls
    assert result.confirmed == off
    assert ("friction" in result.alarm) != off


@pytest.mark.parametrize(("value", "lsb"), [(math.nan, 1.0), (math.inf, 1.0), (1e300, 1e-300)])
def test_what_cannot_be_encoded_is_refused(value: float, lsb: float) -> None:
    with pytest.raises(UnsafeCommand):
        to_counts(value, lsb)


@pytest.mark.parametrize(("watchdog", "fits"), [(0.0, True), (0.015, False), (0.016, True)])
def test_a_watchdog_outlasts_one_lost_reply(watchdog: float, fits: Any) -> None:
    assert (watchdog_problem("mit", watchdog, 0.008) == "") == fits
