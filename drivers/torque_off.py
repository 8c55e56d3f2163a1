"""Torque-off until a servo confirms it, and whether what it reads afterwards bears that out."""

from __future__ import annotations

import math
from typing import NamedTuple

from drivers.servo import BadReply, Command, DriverError, Limits, NoReply, Sample, Servo, ServoInfo

_CALLS, _PAUSE = 20, 0.05
"""Calls of `disarm` in `confirm_torque_off`, and s between two of them."""
_PULLS, _COUNTS, _READINGS, _SETTLES = 0.1, 3.0, 6, 0.01
"""Share of the torque limit, and counts, that a motor without torque may report; readings, and s between two, that must
say more. As many replies may be lost meanwhile: one that a bad link loses must not hide a motor that pulls."""
_STAYS, _RETURNS, _ANGLE_COUNTS, _ANGLE = 0.5, 50, 5.0, 1e-3
"""Share of the angle under load that may be left after so many readings; counts, or rad where these are not known, that
this angle must have."""


class Driven(NamedTuple):
    """How a motor was driven before its torque-off: the limits, whose positions are as far on both sides of that at
    rest, and the last reading.
    """

    limits: Limits
    last: Sample

    @property
    def rest(self) -> float:
        """The motor's angle at rest, rad."""
        return 0.5 * sum(self.limits.position)

    @property
    def turned(self) -> float:
        """The angle by which its last torque had turned the motor, rad; NaN if that was less than a tenth of the
        limit, or of the angle's where it measures no torque.
        """
        turned = self.last.motor_position - self.rest
        share = self.last.motor_torque / self.limits.torque
        if not math.isfinite(share):
            share = turned / (self.limits.position[1] - self.rest)
        return turned if abs(share) >= _PULLS else math.nan


class TorqueOff(NamedTuple):
    """The result of `confirm_torque_off`.

    error: where it is not confirmed, the last error; where it is, an interrupt (such as KeyboardInterrupt) that arrived
    meanwhile and is still to be obeyed, else None.
    """

    confirmed: bool
    error: BaseException | None

    @property
    def alarm(self) -> str:
        """The message for people to read first; "" where the torque is off."""
        if self.confirmed:
            return ""
        reason = self.error.__cause__ if self.error is not None and self.error.__cause__ else self.error
        return f"CUT THE POWER: the torque-off is not confirmed ({reason})"


def confirm_torque_off(servo: Servo, driven: Driven | None = None) -> TorqueOff:
    """Call `disarm` until it succeeds, for about one second of the servo's clock. Never raises.

    driven: where the motor was driven: a drive that says that it is off and still reports a tenth of the torque's
    limit, in several readings, has not confirmed it, nor has one that measures no torque then and whose motor stays
    where its last torque had turned it. The torque-off is repeated once it was read. No interrupt ends this early: a
    live motor is worse than anything it could stand for.
    """
    last: BaseException | None = None
    for _ in range(_CALLS):
        try:
            servo.disarm()
        except BaseException as error:  # noqa: BLE001 - see above
            last = error
        else:
            interrupt = None if isinstance(last, Exception) else last
            return TorqueOff(True, interrupt) if driven is None else _once_more(servo, _read(servo, driven, interrupt))
        try:
            servo.clock.sleep_until(servo.clock.now() + _PAUSE)
        except BaseException as error:  # noqa: BLE001 - see above
            last = error
    return TorqueOff(False, last)


def _read(servo: Servo, driven: Driven, interrupt: BaseException | None) -> TorqueOff:
    """Return whether the motor's torque is gone, as far as the drive shows it.

    interrupt: one that arrived before and is still to be obeyed. Never raises.
    """
    pulls, readings, lost = "", 0, 0
    while True:
        try:
            sample = servo.exchange(Command.rest())
            measures = servo.info.measures_when_off and math.isfinite(sample.motor_torque)
            pulls = (_torque_left if measures else _angle_left)(servo.info, sample, driven)
            readings += 1
            if not pulls or readings >= (_READINGS if measures else _RETURNS):
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
    """Return what the motor's torque says against its torque-off, "" for nothing."""
    most = max(_PULLS * driven.limits.torque, _COUNTS * info.torque_lsb if math.isfinite(info.torque_lsb) else 0.0)
    torque = sample.motor_torque
    return f"the drive says that it is off and still reports {torque:.2g} N m" if abs(torque) > most else ""


def _angle_left(info: ServoInfo, sample: Sample, driven: Driven) -> str:
    """Return what the motor's angle says against its torque-off, "" for nothing."""
    least = _ANGLE_COUNTS * info.position_lsb if math.isfinite(info.position_lsb) else _ANGLE
    left = (sample.motor_position - driven.rest) / driven.turned if abs(driven.turned) > least else math.nan
    if not left > _STAYS:
        return ""
    return (
        f"the drive says that it is off, measures no torque then, and {left * 100.0:.0f} % of its last deflection "
        "stays: it still pulls, or friction keeps the cable under tension"
    )


def _once_more(servo: Servo, result: TorqueOff) -> TorqueOff:
    """Repeat the torque-off: an adapter may send a set-point where it should only read. Never raises."""
    try:
        servo.disarm()
    except Exception:  # noqa: BLE001 - it has confirmed the first one
        return result
    except BaseException as error:  # noqa: BLE001 - to be obeyed once the torque is off
        return result._replace(error=result.error or error)
    return result
