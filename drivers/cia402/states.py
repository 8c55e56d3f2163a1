"""The state machine of CiA 402-2 as the master sees it: statusword to state, and the controlword that leads on."""

from __future__ import annotations

from enum import Enum

SHUTDOWN, SWITCH_ON, ENABLE = 0x06, 0x07, 0x0F
DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET = 0x00, 0x02, 0x80
LIMITING = 0x0800
"""Bit of the statusword: an internal limit is acting."""


class State(Enum):
    """The states of the power drive system."""

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
    (0x4F, 0x00, State.NOT_READY),
    (0x4F, 0x40, State.DISABLED),
    (0x6F, 0x21, State.READY),
    (0x6F, 0x23, State.ON),
    (0x6F, 0x27, State.ENABLED),
    (0x6F, 0x07, State.QUICK_STOP),
    (0x4F, 0x0F, State.REACTING),
    (0x4F, 0x08, State.FAULT),
)

NEXT = {State.DISABLED: SHUTDOWN, State.READY: SWITCH_ON, State.ON: ENABLE, State.ENABLED: ENABLE}
"""The controlword that leads towards ENABLED; a state that is missing has none, or only time."""

WITHOUT_TORQUE = frozenset({State.NOT_READY, State.DISABLED, State.READY, State.FAULT})
"""The power stage is off."""


def state_of(statusword: int) -> State:
    """The state that a statusword says."""
    return next((state for mask, value, state in _PATTERNS if statusword & mask == value), State.UNKNOWN)
