"""Tests of the torque-off of a drive, at zero torque: on request, and by the drive's watchdog when no request
arrives.
"""

from __future__ import annotations

import math

from drivers.overload import HasOverload
from drivers.retry import retry
from drivers.servo import BadReply, Command, DeviceFault, Limits, NoReply, Quantity, Sample, Servo, UnsafeCommand
from drivers.torque_off import confirm_torque_off
from hil.doctor.checks import CheckList, Verdict
from hil.stand.opening import innermost

_STILL_COUNTS = 5.0  # that a drive armed at zero torque may be off from where it was
_BEYOND = 0.1  # s of silence beyond the drive's watchdog
_TRIES = 5


def answered(servo: Servo) -> Sample:
    """Read the servo without a set-point; if a reply is lost, ask again. Raises DriverError."""
    for _ in range(_TRIES - 1):
        try:
            return servo.exchange(Command.rest())
        except (NoReply, BadReply):
            continue
    return servo.exchange(Command.rest())


def check_overload(checks: CheckList, servo: Servo, limits: Limits) -> None:
    """Warn if the drive protects itself from a load that the limits of the stand allow. Raises DriverError."""
    inner = innermost(servo)
    overload = retry(lambda: inner.overload(limits)) if isinstance(inner, HasOverload) else None
    if overload is not None and limits.torque > overload.torque:
        message = (
            f"limits.torque lets the motor make {limits.torque:.3g} N m, and {overload.torque:.3g} N m is an overload: "
            f"{overload.acts}. A slow or long excitation so large would end the run, or make Kc wrong: keep "
            f"--amplitude below it, or {overload.remedy}"
        )
        checks.add("overload", Verdict.WARNING, message)


def check_stop(checks: CheckList, servo: Servo, limits: Limits, mode: Quantity) -> None:
    """Arm the drive without a set-point, switch the torque off, and check that the drive refuses a set-point
    afterwards.

    Raises DeviceFault, DriverError.
    """
    before = answered(servo).motor_position
    servo.arm(limits)
    for _ in range(_TRIES):
        answered(servo)
    _switch_off(checks, servo)
    low, high = limits.position
    # a drive that accepts this is broken: as little as possible
    least = 1e-3 * limits.torque if mode is Quantity.TORQUE else 0.5 * (low + high)
    try:
        servo.exchange(Command(mode, least))
    except UnsafeCommand:
        off = abs(answered(servo).motor_position - before)
        lsb = servo.info.position_lsb
        if off > _STILL_COUNTS * (lsb if math.isfinite(lsb) else 1e-3):
            message = f"it moved by {off:.3g} rad while armed at zero torque: check whether the joint is loose"
            checks.add("stop", Verdict.WARNING, message)
        else:
            checks.passed("stop", "armed at zero torque, then torque off; a set-point is refused after it")
    else:
        checks.failed("stop", "a set-point was accepted after torque-off: do not record with this drive")


def check_watchdog(checks: CheckList, servo: Servo, limits: Limits) -> None:
    """Arm the drive, send nothing for longer than the time of its watchdog, and check that the drive has stopped.

    Raises DeviceFault, DriverError.
    """
    period = servo.info.watchdog
    if not period:
        remedy = servo.info.watchdog_remedy or "keep a switch for its power at hand"
        message = f"none is set: the motor keeps its torque when this computer stops; {remedy}"
        checks.add("watchdog", Verdict.WARNING, message)
        return
    servo.arm(limits)
    answered(servo)
    servo.clock.sleep_until(servo.clock.now() + period + _BEYOND)
    try:
        answered(servo)
    except DeviceFault:
        checks.passed("watchdog", f"the drive stopped by itself after {period:g} s of silence")
    else:
        silence = f"{period + _BEYOND:g} s of silence"
        checks.failed("watchdog", f"the drive was still armed after {silence}: keep a switch for its power at hand")
    _switch_off(checks, servo)


def _switch_off(checks: CheckList, servo: Servo) -> None:
    """Switch the torque off. If the drive does not confirm it, give the alarm and raise the error."""
    result = confirm_torque_off(servo, alarm=checks.alarm)
    if result.error is not None:
        raise result.error
