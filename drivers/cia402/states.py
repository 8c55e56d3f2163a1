"""The states of a CiA 402 drive: how a statusword encodes them, and which controlwords lead to ENABLED."""

from __future__ import annotations

from enum import Enum

SHUTDOWN, SWITCH_ON, ENABLE = 0x06, 0x07, 0x0F
DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET = 0x00, 0x02, 0x80
LIMITING = 0x0800
"""Bit of the statusword: an internal limit of the drive limits the torque."""


class DriveState(Enum):
    """The states of a drive in CiA 402."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    REACTING = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


_PATTERNS = (
    (0x4F, 0x00, DriveState.NOT_READY),
    (0x4F, 0x40, DriveState.DISABLED),
    (0x6F, 0x21, DriveState.READY),
    (0x6F, 0x23, DriveState.ON),
    (0x6F, 0x27, DriveState.ENABLED),
    (0x6F, 0x07, DriveState.QUICK_STOP),
    (0x4F, 0x0F, DriveState.REACTING),
    (0x4F, 0x08, DriveState.FAULT),
)

NEXT = {DriveState.DISABLED: SHUTDOWN, DriveState.READY: SWITCH_ON, DriveState.ON: ENABLE, DriveState.ENABLED: ENABLE}
"""The controlword that leads from a state towards ENABLED. A state that is missing here has no such controlword, or
ends by itself.
"""


def state_of(statusword: int) -> DriveState:
    """Return the state that a statusword encodes."""
    return next((state for mask, value, state in _PATTERNS if statusword & mask == value), DriveState.UNKNOWN)
