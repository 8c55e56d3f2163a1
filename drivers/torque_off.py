"""Request torque-off until a servo confirms it, then check by torque or angle that the motor has stopped pulling."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from contextlib import suppress
from threading import Thread
from typing import NamedTuple

from drivers.clock import waits_end_by
from drivers.gate import CONFIRMS
from drivers.servo import BadReply, Command, DriverError, Limits, NoReply, Sample, Servo, ServoInfo

_TRIES, _PAUSE = 5.0, 0.05
"""s for which `confirm_torque_off` requests torque-off, and s between two calls of `disarm`."""
_SAYS = 0.05
"""s that giving the alarm may delay the next request: a terminal that was stopped must not hold it back."""
_PULLS, _COUNTS, _READINGS, _SETTLES = 0.1, 3.0, 6, 0.01
"""A motor whose torque is off may report this share of the torque limit, or this number of counts. The torque counts as
on only if so many readings in a row are larger; the last number is the s between two readings. As many replies may
be lost: one lost reply must not hide a motor that pulls.
"""
_STAYS, _RETURNS, _ANGLE_COUNTS, _ANGLE = 0.5, 50, 5.0, 1e-3
"""For a drive that cannot measure torque while off: the share of the angle under load that may remain after so many
readings. The check needs an angle under load of so many counts, or so many rad if the count is not known.
"""


class Driven(NamedTuple):
    """How a motor was driven before its torque-off. limits: the limits, whose position range is centred on the angle at
    rest. last: the last reading.
    """

    limits: Limits
    last: Sample

    @property
    def rest(self) -> float:
        """The motor's angle at rest, rad."""
        return 0.5 * sum(self.limits.position)

    @property
    def turned(self) -> float:
        """The angle by which the last torque had turned the motor from rest, rad.

        NaN if the last torque was less than a tenth of its limit; if no torque is measured, NaN if the angle was less
        than a tenth of its limit.
        """
        turned = self.last.motor_position - self.rest
        share = self.last.motor_torque / self.limits.torque
        if not math.isfinite(share):
            share = turned / (self.limits.position[1] - self.rest)
        return turned if abs(share) >= _PULLS else math.nan


class TorqueOff(NamedTuple):
    """The result of `confirm_torque_off`. confirmed: whether the torque is off.

    error: if the torque-off is not confirmed, the error before the alarm. If it is confirmed, an interrupt (such as
    KeyboardInterrupt) that arrived meanwhile and that the caller must raise, else None.
    """

    confirmed: bool
    error: BaseException | None

    @property
    def alarm(self) -> str:
        """The warning to show first; "" if the torque is off."""
        if self.confirmed:
            return ""
        reason = self.error.__cause__ if self.error is not None and self.error.__cause__ else self.error
        return f"CUT THE POWER: the torque-off is not confirmed ({reason})"


Alarm = Callable[[str], object]
"""A function that gets a sentence for the person at the motor: the alarm, or that the torque is off after an alarm."""


def log_alarm(sentence: str) -> None:
    """Log an alarm; a program without log handlers prints it to standard error."""
    logging.getLogger("hil").critical(sentence)


def confirm_torque_off(servo: Servo, driven: Driven | None = None, alarm: Alarm = log_alarm) -> TorqueOff:
    """Call `disarm` until it succeeds, for 5 s of the servo's clock. Never raises.

    alarm: called after `CONFIRMS` s without a confirmation, while the requests continue, and again if a later request
    is confirmed; called at once if the drive confirms but still pulls. No call of `disarm` waits for replies beyond
    these times, whatever the drive's own time limit is. driven: given if the motor was driven: then the drive's
    confirmation is checked. Torque-off is not confirmed if several readings still show more than a tenth of the torque
    limit. For a drive that measures no torque while off, it is not confirmed if the motor stays at the angle to which
    the last torque had turned it. No interrupt ends this function early: a motor under torque is worse than any delay.
    """
    clock, last = servo.clock, None
    failed: TorqueOff | None = None
    begun = clock.now()
    for _ in range(round(_TRIES / _PAUSE)):
        end = begun + (_TRIES if failed else CONFIRMS)
        try:
            with waits_end_by(end):
                servo.disarm()
        except BaseException as error:  # noqa: BLE001 - see above
            if last is None or not isinstance(error, Exception) or clock.now() < end:  # later, no reply was awaited
                last = error
        else:
            interrupt = None if isinstance(last, Exception) else last
            return _confirmed(servo, driven, interrupt, alarm, clock.now() - begun if failed else 0.0)
        try:
            clock.sleep_until(min(clock.now() + _PAUSE, end))
        except BaseException as error:  # noqa: BLE001 - see above
            last = error
        if failed is None and clock.now() >= end:
            failed = _sounded(last, alarm)
        elif clock.now() >= end:
            break
    return failed or _sounded(last, alarm)  # of a clock that stands still it is given here


def _sounded(error: BaseException | None, alarm: Alarm) -> TorqueOff:
    """Give the alarm for a torque-off that is not confirmed; return this result. error: the last error."""
    failed = TorqueOff(False, error)
    _say(alarm, failed.alarm)
    return failed


def _confirmed(
    servo: Servo, driven: Driven | None, interrupt: BaseException | None, alarm: Alarm, late: float
) -> TorqueOff:
    """Return the result for a drive that has confirmed its torque-off. Tell the person if the motor still pulls, or
    that the torque is off if an alarm was given before; late: s since the first request then, else 0.
    """
    result = TorqueOff(True, interrupt) if driven is None else _read(servo, driven, interrupt)
    if not result.confirmed:
        _say(alarm, result.alarm)
    elif late:
        _say(alarm, f"the torque is off: the drive confirmed it {late:.1f} s after the first request")
    return result


def _say(alarm: Alarm, sentence: str) -> None:
    """Call `alarm` in a thread, and wait for it only briefly. Never raises."""

    def say() -> None:
        with suppress(Exception):
            alarm(sentence)

    with suppress(BaseException):
        thread = Thread(target=say, daemon=True)
        thread.start()
        thread.join(_SAYS)


def _read(servo: Servo, driven: Driven, interrupt: BaseException | None) -> TorqueOff:
    """Read the servo until the motor's torque or angle shows that the torque is off. Never raises.

    interrupt: an interrupt that arrived earlier, stored in the result for the caller to raise.
    """
    pulls, readings, lost = "", 0, 0
    end = servo.clock.now() + CONFIRMS
    while True:
        try:
            sample = servo.exchange(Command.rest())
            measures = servo.info.measures_when_off and math.isfinite(sample.motor_torque)
            pulls = (_torque_left if measures else _angle_left)(servo.info, sample, driven)
            readings += 1
            if not pulls or readings >= (_READINGS if measures else _RETURNS) or servo.clock.now() > end:
                break
            servo.clock.sleep_until(servo.clock.now() + _SETTLES)
        except Exception as error:  # noqa: BLE001 - what it reports after its torque-off is a second opinion only
            lost += 1
            if lost > _READINGS or not isinstance(error, NoReply | BadReply):
                return TorqueOff(True, interrupt)
        except BaseException as error:  # noqa: BLE001 - to be obeyed once the torque is off
            interrupt = error
    return TorqueOff(False, DriverError(pulls)) if pulls else TorqueOff(True, interrupt)


def _torque_left(info: ServoInfo, sample: Sample, driven: Driven) -> str:
    """Return a message if the torque in `sample` shows that the torque is still on, else ""."""
    most = max(_PULLS * driven.limits.torque, _COUNTS * info.torque_lsb if math.isfinite(info.torque_lsb) else 0.0)
    torque = sample.motor_torque
    return f"the drive says that it is off and still reports {torque:.2g} N m" if abs(torque) > most else ""


def _angle_left(info: ServoInfo, sample: Sample, driven: Driven) -> str:
    """Return a message if the motor's angle in `sample` shows that the torque is still on, else ""."""
    least = _ANGLE_COUNTS * info.position_lsb if math.isfinite(info.position_lsb) else _ANGLE
    left = (sample.motor_position - driven.rest) / driven.turned if abs(driven.turned) > least else math.nan
    if not left > _STAYS:
        return ""
    return (
        f"the drive says that it is off, measures no torque then, and {left * 100.0:.0f} % of its last deflection "
        "stays: it still pulls, or friction keeps the cable under tension"
    )
