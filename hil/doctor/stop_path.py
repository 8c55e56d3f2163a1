"""How a drive must stop, tried out at zero torque: torque-off on request, and by itself when nobody talks to it."""

from __future__ import annotations

import math

from drivers.servo import BadReply, Command, DeviceFault, Limits, NoReply, Quantity, Sample, Servo, UnsafeCommand
from hil.doctor.checks import Examination, Verdict

_STILL_COUNTS = 5.0  # that a drive armed at zero torque may be off from where it was
_BEYOND = 0.1  # s of silence beyond the drive's watchdog
_TRIES = 5


def answered(servo: Servo) -> Sample:
    """A round trip without a set-point; a lost reply is asked for again. Raises what `exchange` does."""
    for _ in range(_TRIES - 1):
        try:
            return servo.exchange(Command.rest())
        except (NoReply, BadReply):
            continue
    return servo.exchange(Command.rest())


def exercise_stop(found: Examination, servo: Servo, limits: Limits, quantity: Quantity) -> None:
    """Arm without a set-point, turn the torque off, and see that nothing is taken after it.

    Raises DeviceFault and DriverError as `arm` and `disarm` do.
    """
    before = answered(servo).motor_position
    servo.arm(limits)
    for _ in range(_TRIES):
        answered(servo)
    servo.disarm()
    low, high = limits.position
    # a drive that takes this is broken: as little as can be
    least = 1e-3 * limits.torque if quantity is Quantity.TORQUE else 0.5 * (low + high)
    try:
        servo.exchange(Command(quantity, least))
    except UnsafeCommand:
        off = abs(answered(servo).motor_position - before)
        lsb = servo.info.position_lsb
        if off > _STILL_COUNTS * (lsb if math.isfinite(lsb) else 1e-3):
            said = f"it moved by {off:.3g} rad while armed at zero torque: is the joint loose?"
            found.add("stop", Verdict.NOTE, said)
        else:
            found.add("stop", Verdict.OK, "armed at zero torque, then torque off; a set-point is refused after it")
    else:
        found.add("stop", Verdict.PROBLEM, "a set-point was taken after torque-off: do not record with this drive")


def fall_silent(found: Examination, servo: Servo, limits: Limits, period: float) -> None:
    """Arm, say nothing for longer than the drive's watchdog of `period` s (0: none), and see whether it stopped.

    Raises as `exercise_stop`.
    """
    if not period:
        found.add("watchdog", Verdict.NOTE, "none is set: the motor stays live when this computer dies")
        return
    servo.arm(limits)
    answered(servo)
    servo.clock.sleep_until(servo.clock.now() + period + _BEYOND)
    try:
        answered(servo)
    except DeviceFault:
        found.add("watchdog", Verdict.OK, f"the drive stopped by itself after {period:g} s of silence")
    else:
        said = f"the drive was still armed after {period + _BEYOND:g} s of silence: keep a switch for its power at hand"
        found.add("watchdog", Verdict.PROBLEM, said)
    servo.disarm()
