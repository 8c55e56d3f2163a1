"""The errors that a DYNAMIXEL servo latches, each with its remedy.

Source: e-manual, "Hardware Error Status(70)", "Shutdown(63)" and "Bus Watchdog(98)" of the models' pages.
"""

from __future__ import annotations

from drivers.servo import DeviceFault
from drivers.tables import texts_of

WATCHDOG = 0x100
"""Fault code of this project: the bus watchdog tripped. It is above every value of Hardware Error Status(70)."""
RESTARTED = 0x101
"""Fault code of this project: the torque is off although the servo latched no error, so the servo has restarted."""

_HARDWARE = {
    0x01: "its supply voltage is outside its limits: check the supply and the cable",
    0x04: "it is too hot: let it cool down, then lower the torque",
    0x08: "its encoder failed: it must be repaired",
    0x10: "its motor gets too little power or had an electrical shock: check the supply, then the servo",
    0x20: "its load was too high for too long: lower the torque or remove what blocks it",
}


def latched(bits: int) -> DeviceFault:
    """Return the error for the value `bits` of Hardware Error Status(70). The servo keeps this error until it is
    rebooted.
    """
    return DeviceFault(
        bits, f"the servo latched hardware error {bits}: {texts_of(bits, _HARDWARE)}; then switch its power off and on"
    )


def shut_down(bits: int) -> DeviceFault:
    """Return the error for a servo with protocol 1.0 that has shut down. bits: the error bits in its replies; 0: the
    shutdown was earlier.
    """
    texts = texts_of(bits, _HARDWARE) or "it has shut down"
    return DeviceFault(bits, f"the servo reports error {bits}: {texts}; then switch its power off and on")


def watchdog(period: float) -> DeviceFault:
    """Return the error for a bus watchdog that stopped the servo after `period` s without a request."""
    return DeviceFault(
        WATCHDOG,
        f"the servo received nothing for {period:.3g} s and stopped by itself (bus watchdog): find out what delayed "
        "the computer or the link; a slow recording needs a longer dynamixel.watchdog",
    )


def reboot() -> DeviceFault:
    """Return the error for an armed servo that reports its torque as off: it has restarted."""
    return DeviceFault(
        RESTARTED, "the servo's torque went off by itself: it has restarted; check its supply and its plug"
    )
