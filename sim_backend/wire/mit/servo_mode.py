"""Servo mode of a CubeMars AK: its commands and reports are frames with identifiers of 29 bits. No I/O.

Source: CubeMars AK Series Driver Manual, section "Servo mode". The manual does not state the following, which is
assumed here. A duty is a fraction of the speed range. A brake reaches its current at the end of the speed range. The
motor has 21 pole pairs. Limits of acceleration have no effect.
"""

from __future__ import annotations

import math
import struct

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canbus.impedance import CanMotor, Impedance
from sim_backend.wire.mit.tables import MitModel

UPLOAD = 0.02
"""s between two reports, 50 a second as delivered."""
DUTY, CURRENT, BRAKE, SPEED, POSITION, ORIGIN, POSITION_SPEED = range(7)
"""Kinds of commands, the high digits of the identifier."""
REPORT = 0x29
_POLE_PAIRS = 21
_POSITION_GAIN = 50.0


def law(kind: int, data: bytes, model: MitModel, zero: float, damping: float) -> Impedance | None:
    """Return the demand law of a command; None if the command is too short or unknown. zero: the motor's angle at zero,
    rad. damping: of the speed loop, N m s/rad.
    """
    _, fastest, most = model.span
    if len(data) < (8 if kind == POSITION_SPEED else 4) or kind not in set(range(7)) - {ORIGIN}:
        return None
    value = struct.unpack_from(">i", data)[0]
    speed = _rate(value, model)
    if kind == DUTY:
        return Impedance(kd=damping, velocity=value * 1e-5 * fastest, ceiling=most)
    if kind == CURRENT:
        return Impedance(value * 1e-3 * model.torque_constant, ceiling=most)
    if kind == BRAKE:
        return Impedance(kd=abs(value) * 1e-3 * model.torque_constant / fastest, ceiling=most)
    if kind == SPEED:
        return Impedance(kd=damping, velocity=speed, ceiling=most)
    limit = _rate(10 * struct.unpack_from(">h", data, 4)[0], model) if kind == POSITION_SPEED else fastest
    target = math.radians(value * 1e-4) + zero
    return Impedance(0.0, _POSITION_GAIN * damping, damping, target, ceiling=most, fastest=abs(limit))


def report(ident: int, motor: CanMotor, model: MitModel, zero: float, error: int) -> CanFrame:
    """Return the cyclic report: angle in 0.1 deg, speed in 10 electrical turns a minute, current in 10 mA, temperature
    in degC, and error code.
    """
    angle = _short(math.degrees(motor.position - zero) * 10.0)
    speed = _short(motor.velocity / _rate(10, model))
    current = _short(motor.torque / model.torque_constant * 100.0)
    warmth = max(-20, min(127, int(motor.temperature)))
    return CanFrame(REPORT << 8 | ident, struct.pack(">hhhbB", angle, speed, current, warmth, error), extended=True)


def _rate(electrical: int, model: MitModel) -> float:
    """Return the speed of the output, rad/s, at `electrical` electrical turns a minute."""
    return electrical / _POLE_PAIRS / model.gear * math.tau / 60.0


def _short(value: float) -> int:
    return max(-32000, min(32000, int(value)))
