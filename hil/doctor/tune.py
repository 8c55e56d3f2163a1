"""`hil doctor --tune`: the highest rate at which a drive answers in time, and the settings for that rate.

The torque stays off. A reply is in time if it arrives before the next tick begins.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.ports import latency_timer, set_latency_timer
from drivers.servo import BadReply, Command, DriverError, NoReply, Quantity, Servo
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.real_time import PERMISSION, missing_permissions, real_time
from hil.doctor.checks import CheckList, Verdict
from hil.stand.file import Stand
from hil.stand.opening import open_servo

IN_TIME = 0.999
_TICKS, _FEW = 2000, 300  # of a run at a rate, so that 99.9 % of them leaves two; of the first look
_LONGEST = 10.0  # s for so many
_STEP = 0.93  # from one rate to the next lower one
_LEAST, _MOST = 20.0, 10_000.0  # Hz
_LATENCY = 1  # ms


@dataclass(frozen=True, slots=True)
class Setting:
    """A combination of settings that affect the rate.

    latency: latency timer of the USB adapter, ms, None if it has no timer. return_delay: return delay of the drive, s,
    None if it has no such setting. urgent: whether the control loop runs in the real-time class.
    """

    latency: int | None
    return_delay: float | None
    urgent: bool

    def named(self, backend: str) -> str:
        """Return the settings in words, for the drive `backend`."""
        words = [] if self.latency is None else [f"latency timer {self.latency} ms"]
        words += [] if self.return_delay is None else [f"{backend}.return_delay = {self.return_delay:g}"]
        return ", ".join([*words, "real-time class" if self.urgent else "default scheduling"])


class Reached(NamedTuple):
    """The highest rate that was reached.

    rate: Hz (0: no rate). share: the fraction of the replies that were in time at this rate. replies: number of
    replies.
    """

    rate: float
    share: float
    replies: int


def tune(checks: CheckList, stand: Stand, mode: Quantity, stop: StopRequest) -> None:
    """Measure the rate with each possible setting, and add a check that names the best setting."""
    found: list[tuple[Setting, Reached]] = []
    port = _adapter(stand)
    for setting in _settings(stand, port):
        try:
            with (
                _applied(stand, port, setting) as changed,
                _at_rest(changed, mode) as servo,
                real_time(servo.clock) if setting.urgent else nullcontext(),
            ):
                found.append((setting, highest_rate(servo, stop)))
        except DriverError as error:
            checks.failed("tune", str(error))
            return
        if stop.count:
            return
    _report(checks, str(stand.stand.backend), found)


def highest_rate(servo: Servo, stop: StopRequest) -> Reached:
    """Return the highest rate, Hz, at which 99.9 % of the replies of a drive at rest are in time."""
    usual = float(np.median(_trips(servo, stop) or [math.inf]))
    rate = 1.0 / usual if usual > 0.0 else _MOST
    while (rate := float(math.floor(rate))) >= _LEAST and not stop.count:
        share, replies = _paced(servo, rate, stop)
        if share >= IN_TIME and not stop.count:
            return Reached(rate, share, replies)
        rate *= _STEP
    return Reached(0.0, 0.0, 0)


def _trips(servo: Servo, stop: StopRequest) -> list[float]:
    """Return the times of round trips, s, made as fast as possible; a lost reply has an infinite time."""
    clock, trips = servo.clock, list[float]()
    end = clock.now() + _LONGEST / 4.0
    while len(trips) < _FEW and clock.now() < end and not stop.count:
        before = clock.now()
        heard = _answered(servo)
        trips.append(clock.now() - before if heard else math.inf)
    return trips


def _paced(servo: Servo, rate: float, stop: StopRequest) -> tuple[float, int]:
    """Return the fraction of replies that come before the next tick at `rate` Hz, and the number of ticks.

    The measurement ends as soon as too many replies are late.
    """
    clock = servo.clock
    ticks = max(10, min(_TICKS, int(rate * _LONGEST)))
    start, late = clock.now(), 0
    for tick in range(ticks):
        if stop.count or late > (1.0 - IN_TIME) * ticks:
            return 1.0 - late / max(tick, 1), tick
        clock.sleep_until(start + tick / rate)
        late += not _answered(servo) or clock.now() > start + (tick + 1) / rate
    return 1.0 - late / ticks, ticks


def _answered(servo: Servo) -> bool:
    try:
        servo.exchange(Command.rest())
    except (NoReply, BadReply):
        return False
    return True


def _adapter(stand: Stand) -> str:
    """Return the name of the serial adapter in /sys, "" if the stand has no serial port."""
    table = stand.devices.get(str(stand.stand.backend))
    serial = getattr(table, "interface", None) in {"slcan", "damiao", "robstride"}
    port = getattr(table, "channel" if serial else "port", None)
    return Path(port).resolve().name if isinstance(port, str) else ""


def _settings(stand: Stand, port: str) -> Iterator[Setting]:
    """Yield settings, from the stand's own to the fastest; each differs from the previous one by one change."""
    table: Any = stand.devices.get(str(stand.stand.backend))
    setting = Setting(latency_timer(port), getattr(table, "return_delay", None), urgent=False)
    yield setting
    if setting.return_delay:
        setting = dataclasses.replace(setting, return_delay=0.0)
        yield setting
    if setting.latency is not None and setting.latency > _LATENCY:
        setting = dataclasses.replace(setting, latency=_LATENCY)
        yield setting
    if "the real-time class" not in missing_permissions():
        yield dataclasses.replace(setting, urgent=True)


@contextmanager
def _applied(stand: Stand, port: str, setting: Setting) -> Iterator[Stand]:
    """Apply a setting and yield the stand with it; afterwards restore the adapter's previous setting."""
    backend = str(stand.stand.backend)
    table: Any = stand.devices.get(backend)
    if setting.return_delay is not None:
        table = dataclasses.replace(table, return_delay=setting.return_delay)
        stand = dataclasses.replace(stand, devices={**stand.devices, backend: table})
    before = latency_timer(port)
    if setting.latency is not None and setting.latency != before and not set_latency_timer(port, setting.latency):
        raise DriverError(
            f"the latency timer of {port} is {before} ms, and this user may not set it: "
            f"echo {_LATENCY} | sudo tee /sys/bus/usb-serial/devices/{port}/latency_timer, then tune again"
        )
    try:
        yield stand
    finally:
        if before is not None and before != setting.latency:
            set_latency_timer(port, before)


@contextmanager
def _at_rest(stand: Stand, mode: Quantity) -> Iterator[Servo]:
    servo, _ = open_servo(stand, quantity=mode)
    try:
        yield servo
    finally:
        servo.close()


def _report(checks: CheckList, backend: str, found: list[tuple[Setting, Reached]]) -> None:
    setting, best = max(found, key=lambda one: one[1].rate)
    own, now = found[0]
    if not best.rate:
        checks.failed("tune", f"not even at {_LEAST:g} Hz are 99.9 % of the replies in time: check cable and baud rate")
        return
    message = (
        f"{best.rate:g} Hz is the highest rate at which {IN_TIME:.1%} of the replies are in time ({best.share:.2%} of "
        f"{best.replies}), with {setting.named(backend)}"
    )
    if setting != own:
        message += f"; with {own.named(backend)}, as it is now, {now.rate:g} Hz"
    if not setting.urgent and "the real-time class" in missing_permissions():
        message += f"; the real-time class may get more: {PERMISSION}"
    changed = list[str]()
    if setting.return_delay != own.return_delay:
        changed.append(f"set {backend}.return_delay = {setting.return_delay:g}")
    if setting.latency != own.latency:
        changed.append(f"set the latency timer to {setting.latency} ms")
    todo = " and ".join(changed)
    checks.add("tune", Verdict.OK if not todo else Verdict.WARNING, f"{message}{f': {todo}' if todo else ''}")
