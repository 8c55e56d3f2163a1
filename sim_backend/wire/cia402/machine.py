"""The state machine of an emulated CiA 402 drive: it takes controlwords and returns state and statusword.

Source: CiA 402-2, "Power drive system finite state automaton". Switching the power stage on takes `SWITCHING` s.
"""

from __future__ import annotations

import math
from enum import IntEnum

SWITCHING = 1e-3


class Cia402State(IntEnum):
    """The states of a CiA 402 drive. The values are the bits of the statusword that encode the state."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


VOLTAGE = 0x10
REMOTE = 0x200
"""Bits of the statusword: the power stage has voltage; the drive obeys commands from the bus."""
_LIMITING = 0x800
_WITH_VOLTAGE = {Cia402State.SWITCHED_ON, Cia402State.OPERATION_ENABLED, Cia402State.QUICK_STOP_ACTIVE}


class Cia402Machine:
    """The state of one drive. quick_stop_holds: whether the drive stays in QUICK_STOP_ACTIVE (option codes 5 to 8)."""

    def __init__(self) -> None:
        self.state = Cia402State.SWITCH_ON_DISABLED
        self.limiting = False
        self.quick_stop_holds = True
        self.ignores_controlword = False
        """Whether the drive ignores controlwords: a fault for tests."""
        self.can_reset = True
        self._controlword = 0
        self._switching = math.inf

    @property
    def statusword(self) -> int:
        """The statusword, object 0x6041."""
        word = int(self.state) | REMOTE
        if self.state in _WITH_VOLTAGE:
            word |= VOLTAGE
        return word | (_LIMITING if self.limiting else 0)

    def due(self) -> float:
        """Return the time at which the power stage will be on, s; infinity if it is not being switched on."""
        return self._switching

    def advance(self, now: float) -> None:
        """Complete the switching on of the power stage if its duration has passed."""
        if self._switching <= now:
            self._switching = math.inf
            self._follow(self._controlword, math.inf)

    def fail(self) -> None:
        """Enter the fault state."""
        self._switching = math.inf
        self.state = Cia402State.FAULT

    def quick_stop(self) -> None:
        """Make transition 11, and then transition 12 if the drive does not stay in QUICK_STOP_ACTIVE."""
        if self.state in {Cia402State.OPERATION_ENABLED, Cia402State.QUICK_STOP_ACTIVE}:
            self.state = Cia402State.QUICK_STOP_ACTIVE if self.quick_stop_holds else Cia402State.SWITCH_ON_DISABLED
        elif self.state in {Cia402State.READY_TO_SWITCH_ON, Cia402State.SWITCHED_ON}:
            self.state = Cia402State.SWITCH_ON_DISABLED
        self._switching = math.inf

    def disable_voltage(self) -> None:
        """Make the transition to SWITCH_ON_DISABLED: 7, 9, 10 or 12."""
        if self.state not in {Cia402State.FAULT, Cia402State.FAULT_REACTION, Cia402State.NOT_READY}:
            self.state = Cia402State.SWITCH_ON_DISABLED
        self._switching = math.inf

    def command(self, word: int, now: float) -> bool:
        """Obey a controlword. Return whether it was a fault reset that cleared the fault."""
        rising = word & ~self._controlword & 0x80
        self._controlword = word
        if self.ignores_controlword:
            return False
        if rising and self.state == Cia402State.FAULT:
            if self.can_reset:
                self.state = Cia402State.SWITCH_ON_DISABLED
            return self.can_reset
        self._follow(word, now)
        return False

    def _follow(self, word: int, now: float) -> None:
        """Obey the low bits of a controlword. now: s, or infinity when the power stage has just been switched on."""
        if self.state in {Cia402State.FAULT, Cia402State.FAULT_REACTION, Cia402State.NOT_READY}:
            return
        if not word & 0x02:
            self.disable_voltage()
        elif not word & 0x04:
            self.quick_stop()
        elif self.state == Cia402State.QUICK_STOP_ACTIVE:
            if word & 0x0F == 0x0F:
                self.state = Cia402State.OPERATION_ENABLED
        elif not word & 0x01:
            self.state = Cia402State.READY_TO_SWITCH_ON
            self._switching = math.inf
        elif self.state == Cia402State.READY_TO_SWITCH_ON and math.isfinite(now):
            self._switching = min(self._switching, now + SWITCHING)
        elif self.state in {Cia402State.READY_TO_SWITCH_ON, Cia402State.SWITCHED_ON, Cia402State.OPERATION_ENABLED}:
            self.state = Cia402State.OPERATION_ENABLED if word & 0x08 else Cia402State.SWITCHED_ON
