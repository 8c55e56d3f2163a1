"""What a servo can have latched, in words, with the remedy.

Source: e-manual, "Hardware Error Status(70)", "Shutdown(63)" and "Bus Watchdog(98)" of the models' pages.
"""

from __future__ import annotations

from drivers.servo import DeviceFault

WATCHDOG = 0x100
"""Our code for a tripped bus watchdog: above every value of Hardware Error Status(70)."""
RESTARTED = 0x101
"""Our code for a servo whose torque went off by itself and left no error: it was restarted."""

_HARDWARE = {
    0x01: "its supply voltage is outside its limits: check the supply and the cable",
    0x04: "it is too hot: let it cool down, then lower the torque",
    0x08: "its encoder failed: it has to be repaired",
    0x10: "its motor gets too little power or had an electrical shock: check the supply, then the servo",
    0x20: "its load was too high for too long: lower the torque or look for what blocks it",
}


def latched(bits: int) -> DeviceFault:
    """The fault for a Hardware Error Status(70) of `bits`; it holds until the servo is rebooted."""
    words = [text for bit, text in _HARDWARE.items() if bits & bit]
    unknown = bits & ~sum(_HARDWARE)
    if unknown:
        words.append(f"unknown error bits 0x{unknown:02x}: see its manual")
    return DeviceFault(bits, f"the servo latched hardware error {bits}: {'; '.join(words)}; then cut its power once")


def shut_down(bits: int) -> DeviceFault:
    """The fault for a servo with protocol 1.0 whose replies carry the error `bits` (0: it has shut down before)."""
    words = [text for bit, text in _HARDWARE.items() if bits & bit] or ["it has shut down"]
    return DeviceFault(bits, f"the servo reports error {bits}: {'; '.join(words)}; then cut its power once")


def watchdog(period: float) -> DeviceFault:
    """The fault for a bus watchdog that has stopped the servo after `period` s of silence."""
    return DeviceFault(
        WATCHDOG,
        f"the servo heard nothing for {period:.3g} s and stopped by itself (bus watchdog): look for what held the "
        "computer or the link up; a slow recording needs a longer dynamixel.watchdog",
    )


def reboot() -> DeviceFault:
    """The fault for a servo whose torque is off while it should be on."""
    return DeviceFault(
        RESTARTED, "the servo's torque went off by itself: it was restarted; check its supply and its plug"
    )
