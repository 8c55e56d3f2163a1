"""The errors that a servo reports in every reply, with the remedy. Source: memory tables, "Servo status" (65)."""

from __future__ import annotations

from drivers.servo import DeviceFault
from drivers.tables import texts_of

ALERTS = 0x7F
"""The bits of the error byte: all are errors of the servo, none is about the request."""
RESTARTED = 0x100
"""Our code for a servo whose torque went off by itself and left no error: above every value of the status."""

_STATUS = {
    0x01: "its supply voltage is outside its limits: check the supply and the cable",
    0x02: "its encoder failed: it must be repaired",
    0x04: "it is too hot: let it cool down, then lower the torque",
    0x08: "its current was too high for too long: lower the torque or remove what blocks it",
    0x10: "its angle is outside its limits: turn it back",
    0x20: "its load was too high for too long: lower the torque or remove what blocks it",
}


def reported(bits: int) -> DeviceFault:
    """Return the error for a status of `bits`."""
    return DeviceFault(
        bits, f"the servo reports error {bits}: {texts_of(bits, _STATUS)}; then switch its power off and on"
    )


def restarted() -> DeviceFault:
    """Return the error for an armed servo whose torque is off."""
    return DeviceFault(
        RESTARTED, "the servo's torque went off by itself: it was restarted; check its supply and its plug"
    )
