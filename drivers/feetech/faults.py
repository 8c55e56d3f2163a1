"""The errors that a Feetech servo reports in every reply, each with its remedy. Source: memory tables, "Servo status"
(65).
"""

from __future__ import annotations

from drivers.servo import DeviceFault
from drivers.tables import texts_of

ALERTS = 0x7F
"""The error bits of the error byte. All of them are errors of the servo; none says that the request was wrong."""
RESTARTED = 0x100
"""Fault code of this project: the torque is off although the servo reports no error, so the servo has restarted. It is
above every value of the status byte.
"""

_STATUS = {
    0x01: "its supply voltage is outside its limits: check the supply and the cable",
    0x02: "its encoder failed: it must be repaired",
    0x04: "it is too hot: let it cool down, then lower the torque",
    0x08: "its current was too high for too long: lower the torque or remove what blocks it",
    0x10: "its angle is outside its limits: turn it back",
    0x20: "its load was too high for too long: lower the torque or remove what blocks it",
}


def reported(bits: int) -> DeviceFault:
    """Return the error for the value `bits` of the servo's status byte."""
    return DeviceFault(
        bits, f"the servo reports error {bits}: {texts_of(bits, _STATUS)}; then switch its power off and on"
    )


def restarted() -> DeviceFault:
    """Return the error for an armed servo that reports its torque as off: it has restarted."""
    return DeviceFault(
        RESTARTED, "the servo's torque went off by itself: it has restarted; check its supply and its plug"
    )
